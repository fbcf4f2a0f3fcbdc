"""The paths that hands may take: quadratic B-splines, slow enough and inside the workspace at all times."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...datasets.scenario import Observed
from ...methods.continuum.hands import labels_of
from .config import PlanConfig

__all__ = ["Controls", "axes_of", "spline"]


def axes_of(gravity) -> np.ndarray:
    """(3, 3) two horizontal axes and the upward one, a row each; without gravity the third axis is up."""
    gravity = np.asarray(gravity, float)
    size = np.linalg.norm(gravity)
    up = -gravity / size if size else np.array([0.0, 0.0, 1.0])
    first = np.eye(3)[np.argmin(np.abs(up))]
    first = first - up * (first @ up)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first), up])


def spline(segments: int, moving: int, resting: int) -> np.ndarray:
    """(frames, segments) weights of way points in a path that leaves 0 at rest, is guided by them, and rests in the last.

    A uniform quadratic B-spline with the control points 0, 0, P1, ..., PK, PK (de Boor 1978): a path lies in the convex hull of three
    of them, and its velocity between two of their differences over the time of a segment, so that what bounds these bounds the path.
    """
    at = np.linspace(0, segments + 1, moving)
    piece = np.minimum(at.astype(int), segments)
    u = (at - piece)[:, None]
    basis = np.concatenate([(1 - u) ** 2, 1 + 2 * u - 2 * u**2, u**2], 1) / 2
    point = np.clip(piece[:, None] + np.arange(3) - 2, -1, segments - 1)  # -1: the start, which is 0
    weights = np.zeros((moving, segments))
    for k in range(3):
        rows = np.flatnonzero(point[:, k] >= 0)
        np.add.at(weights, (rows, point[rows, k]), basis[rows, k])
    return np.concatenate([weights, np.repeat(weights[-1:], resting, 0)])


@dataclass(frozen=True, eq=False)
class Controls:
    """What hands can do from a start. Way points (B, K, H, 3) [m] of hands are told from their places there, along ``axes``.

    controllers  (C, 3) m in frame 0, and the ``hand`` (C,) that each is of, 0 to H - 1
    low, high    (3,) m, the box in which way points lie
    """

    controllers: np.ndarray
    hand: np.ndarray
    axes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    fps: float
    config: PlanConfig

    @classmethod
    def of(cls, start: Observed, config: PlanConfig) -> Controls:
        """Those of the hands in frame 0 of a recording, which stay above its ground. Raises ValueError where there is no hand."""
        if not start.controllers.shape[1]:
            raise ValueError(f"a plan needs hands, but the recording has no controllers (scenario {start.name})")
        first, axes = start.controllers[0], axes_of(start.gravity)
        label = labels_of(start.controllers[:1])
        order = {one: k for k, one in enumerate(dict.fromkeys(label.tolist()))}
        below = config.aside if start.ground is None else float(np.clip(start.ground.height(first).min(), 0, config.aside))
        low, high = np.array([-config.aside, -config.aside, -below]), np.array([config.aside, config.aside, config.above])
        return cls(first, np.array([order[one] for one in label.tolist()]), axes, low, high, start.fps, config)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of way points: (segments, hands, 3)."""
        return self.config.segments, int(self.hand.max()) + 1, 3

    @property
    def step(self) -> float:
        """m between way points, at most."""
        return self.config.speed * (self.config.moving - 1) / (self.config.segments + 1) / self.fps

    @cached_property
    def weights(self) -> np.ndarray:
        return spline(self.config.segments, self.config.moving, self.config.resting)

    def feasible(self, ways: np.ndarray) -> np.ndarray:
        """``ways`` with each point brought into the box, then along the way from the one before as far as a hand gets.

        Both sets are convex, so that a mean of feasible paths is feasible.
        """
        found, before = np.empty_like(ways), np.zeros_like(ways[:, 0])
        for k in range(ways.shape[1]):
            way = np.clip(ways[:, k], self.low, self.high) - before
            far = np.linalg.norm(way, axis=-1, keepdims=True)
            before = before + way * np.minimum(1, self.step / np.maximum(far, 1e-12))
            found[:, k] = before
        return found

    def moved(self, ways: np.ndarray) -> np.ndarray:
        """(B, T, H, 3) m, how far each hand is from its start in every frame, along the room's axes."""
        return np.einsum("tk,bkhi,ij->bthj", self.weights, ways, self.axes)

    def paths(self, ways: np.ndarray) -> np.ndarray:
        """(B, T, C, 3) m, the controllers."""
        return self.controllers + self.moved(ways)[:, :, self.hand]
