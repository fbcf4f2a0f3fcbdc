"""Our engine: explicit steps in single precision, as long as the stiffest body of a batch allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...physics.system import System
from .comparison import FPS, FRAMES, Engine, Setting

__all__ = ["Ours"]


class Ours(Engine):
    """Of a ``system``, whose points are ``watched``. ``factors``: substeps that are tried, over the least that are stable.

    power  of a body's stiffness that its least substeps go with: 1 where damping asks for them, 1 / 2 where waves do
    """

    is_ours = True
    factors: tuple[float, ...] = (1.5, 1.25, 1.1)
    power = 1.0

    def __init__(self, device: str = "cpu", workers: int | None = None):
        self.device, self.workers = device, workers

    def system(self, body: Any, mesh) -> System:
        """With the hands of all ``FRAMES``."""
        raise NotImplementedError

    def watched(self, system: System, body: Any) -> tuple[np.ndarray, np.ndarray]:
        """((P, k) nodes, (P, k) weights) of which the body's points are means."""
        raise NotImplementedError

    def settings(self, body, mesh):
        from ...physics.stability import stable_step

        least = 1 / FPS / stable_step(self.system(body, mesh))
        return [Setting(tuple(mesh), int(np.ceil(factor * least))) for factor in self.factors]

    def steps(self, bodies: Sequence[Any], setting):
        if len(bodies) == 1:
            return setting
        stiffness = [b.stiffness for b in bodies]
        times = (max(stiffness) / float(np.median(stiffness))) ** self.power
        return replace(setting, substeps=int(np.ceil(setting.substeps * times)))

    def ready(self, bodies, setting):
        from ...physics.batch import Batch

        systems = [self.system(body, setting.mesh) for body in bodies]
        batch = Batch(systems, fps=FPS, substeps=setting.substeps, device=self.device, workers=self.workers)
        nodes, weights = self.watched(systems[0], bodies[0])

        def run():
            positions = batch.rollout(FRAMES).positions
            found = np.stack([p.cpu().numpy()[:, nodes].astype(float) for p in positions])
            return np.einsum("pk,btpki->btpi", weights, found)

        return run
