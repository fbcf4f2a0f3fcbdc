"""A roll-out as something that is stepped: for films, where everything is known already."""

from __future__ import annotations

import numpy as np

from ...methods.base import Diverged, Trajectory
from .live import Live

__all__ = ["Replayed"]


class Replayed(Live):
    """``trajectory`` of a twin under the controllers ``path`` (T, C, 3) m. Where it ends or is nowhere, it diverges."""

    def __init__(self, trajectory: Trajectory, path, fps: float):
        self.trajectory, self.path, self.fps = trajectory, np.asarray(path, float), fps
        self.controllers, self.counts, self.positions = self.path[0], trajectory.counts, np.asarray(trajectory.positions[0], np.float32)

    def step(self, controllers):
        soon = self.frame + 1
        if soon >= len(self.trajectory.positions):
            raise Diverged(f"the roll-out has {soon} frames", soon)
        positions = np.asarray(self.trajectory.positions[soon], np.float32)
        if not np.isfinite(positions).all():
            raise Diverged(f"the roll-out blew up in frame {soon}", soon)
        self.positions, self.frame = positions, soon

    @property
    def state(self):
        return self.frame, self.positions

    @state.setter
    def state(self, value):
        self.frame, self.positions = value
