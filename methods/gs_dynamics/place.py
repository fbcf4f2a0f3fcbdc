"""Where a body stands: its particles, what moves it, and which way is up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Observed
from ..farthest import farthest_points

__all__ = ["Place", "Upright", "cells", "tool_nodes"]


@dataclass(frozen=True)
class Upright:
    """World axes turned so that z is the height above ground: ``local = world @ rotation.T - [0, 0, offset]``, metres."""

    rotation: np.ndarray
    offset: float

    @classmethod
    def of(cls, observed: Observed) -> Upright:
        """Up is the ground's normal, else against gravity, else z. Without ground, heights count from the lowest particle of frame 0."""
        ground, strength = observed.ground, np.linalg.norm(observed.gravity)
        if ground is not None:
            up, offset = ground.normal, ground.offset
        else:
            up = -observed.gravity / strength if strength > 0 else np.array([0.0, 0.0, 1.0])
            offset = float((observed.structure @ up).min())
        across = np.eye(3)[np.abs(up).argmin()]
        across = across - (across @ up) * up
        across /= np.linalg.norm(across)
        return cls(np.stack([across, np.cross(up, across), up]), offset)

    def local(self, points):
        return np.asarray(points, float) @ self.rotation.T - [0.0, 0.0, self.offset]

    def world(self, points):
        return (points + [0.0, 0.0, self.offset]) @ self.rotation


@dataclass(frozen=True)
class Place:
    """Frame 0 of a recording.

    ``structure`` (M, 3) m with ``counts`` of its tracked, surface and interior particles, ``controllers`` (C, 3) m, ``grips`` (C,) as in
    :class:`~...datasets.scenario.Observed`.
    """

    structure: np.ndarray
    counts: tuple[int, int, int]
    controllers: np.ndarray
    grips: np.ndarray
    upright: Upright

    @classmethod
    def of(cls, observed: Observed) -> Place:
        return cls(observed.structure, observed.counts, observed.controllers[0], observed.grips, Upright.of(observed))


def cells(controllers, radius: float) -> np.ndarray:
    """(C,) the tool node of each of the ``controllers`` (C, 3) m: the nearest of farthest points that cover them to ``radius`` [m]."""
    centres = controllers[farthest_points(controllers, radius=radius)]
    return np.linalg.norm(controllers[:, None] - centres, axis=2).argmin(axis=1)


def tool_nodes(controllers, belongs) -> np.ndarray:
    """(T, K, 3) m mean of each cell's controllers (T, C, 3): the noise of single hand points averages out."""
    return np.stack([controllers[:, belongs == k].mean(axis=1) for k in range(belongs.max() + 1)], axis=1)
