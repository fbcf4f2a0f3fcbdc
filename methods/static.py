"""The body never moves: what every method must beat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..datasets.scenario import Observed
from . import saving
from .base import Method, Trajectory, Twin

__all__ = ["METHODS", "Static", "StaticTwin"]


@dataclass(frozen=True)
class StaticTwin(Twin):
    """Every frame is frame 0: ``structure`` (M, 3) metres in the order tracked | surface | interior, ``counts`` of each.

    ``grips`` (C,) is the tracked point that controller c is, or -1.
    """

    structure: np.ndarray
    counts: tuple[int, int, int]
    grips: np.ndarray

    @classmethod
    def of(cls, observed: Observed) -> StaticTwin:
        """The twin in frame 0 of a recording."""
        return cls(observed.structure, observed.counts, observed.grips)

    def rollout(self, controllers) -> Trajectory:
        positions = np.broadcast_to(self.structure.astype(np.float32), (len(controllers), *self.structure.shape))
        return Trajectory(positions, self.counts)

    def retarget(self, target: Observed) -> StaticTwin:
        return self.of(target)

    def save(self, folder: Path) -> None:
        saving.write(folder, dict(structure=self.structure, grips=self.grips), {"counts": self.counts})

    @classmethod
    def load(cls, folder: Path) -> StaticTwin:
        arrays, state = saving.read(folder)
        return cls(arrays["structure"], tuple(state["counts"]), arrays["grips"])


class Static(Method):
    """Holds frame 0."""

    name = "static"
    twin_class: type[StaticTwin] = StaticTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None) -> StaticTwin:
        return self.twin_class.of(observed[0])


METHODS = (Static,)
