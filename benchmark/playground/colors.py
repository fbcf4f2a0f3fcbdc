"""What a colour says of a particle: strain, stress, stiffness, mass, speed or error, from blue (least) to red (most)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .live import Live

__all__ = ["COLOURS", "Scale", "colours_of", "painted"]

COLOURS = ("own", "strain", "stress", "speed", "stiffness", "mass", "error")
NEIGHBOURS = 6  # that strain is read from where a body names no edges
STOPS = np.array([[49, 54, 149], [116, 173, 209], [254, 224, 144], [244, 109, 67], [165, 0, 38]], float)  # ColorBrewer's RdYlBu, reversed
GREY = np.array([150, 150, 150], np.uint8)
LEAST = {"strain": 0.02, "speed": 0.02, "error": 0.002}  # of the scale's upper end, so that a body at rest is not red with rounding
UNITS = {"strain": "-", "speed": "m/s", "mass": "kg", "error": "m"}


@dataclass
class Scale:
    """The range that colours span, which grows at once and shrinks slowly, so that they do not flicker."""

    high: float = 0.0
    low: float = 0.0

    def take(self, values, least: float = 0.0, *, fixed: bool = False) -> None:
        top = max(float(np.nanpercentile(values, 98)), least) if np.isfinite(values).any() else least
        self.high = top if fixed else max(top, 0.98 * self.high)
        self.low = float(np.nanmin(values)) if fixed and np.isfinite(values).any() else 0.0


def painted(values, low: float, high: float) -> np.ndarray:
    """(M, 3) uint8 of ``values`` (M,) between ``low`` and ``high``; grey where there is none."""
    values = np.asarray(values, float)
    share = np.clip((np.nan_to_num(values) - low) / max(high - low, 1e-12), 0, 1) * (len(STOPS) - 1)
    first = np.minimum(share.astype(int), len(STOPS) - 2)
    mixed = STOPS[first] + (share - first)[:, None] * (STOPS[first + 1] - STOPS[first])
    return np.where(np.isfinite(values)[:, None], mixed.astype(np.uint8), GREY)


class Strain:
    """How much longer or shorter a body's edges are than in its frame 0: the mean absolute strain of each particle's own."""

    def __init__(self, live: Live):
        from scipy.spatial import cKDTree

        pairs, points = live.edges.pairs, live.nodes
        self.own = len(pairs) > 0 and len(points) == len(live.positions)
        if not self.own:
            points = live.positions
            near = cKDTree(points).query(points, k=min(NEIGHBOURS + 1, len(points)))[1]
            pairs = np.stack([np.repeat(near[:, 0], near.shape[1] - 1), near[:, 1:].ravel()], 1)
        self.pairs, self.rest = pairs, np.maximum(self._lengths(points, pairs), 1e-9)
        self.count = np.maximum(np.bincount(pairs.ravel(), minlength=len(points)), 1)

    @staticmethod
    def _lengths(points, pairs):
        return np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)

    def of_edges(self, live: Live) -> np.ndarray:
        """(E,) signed strain of each edge."""
        return self._lengths(live.nodes if self.own else live.positions, self.pairs) / self.rest - 1

    def of_particles(self, live: Live) -> np.ndarray:
        """(M,)."""
        return np.bincount(self.pairs.ravel(), np.repeat(np.abs(self.of_edges(live)), 2), len(self.count)) / self.count


def colours_of(kind: str, live: Live, strain: Strain, before: np.ndarray | None, off) -> tuple[np.ndarray, str] | None:
    """((M,) values of ``kind``, their unit), None where there are none; ``before`` (M, 3) m a frame ago, ``off`` as ``Stage.residual``."""
    if kind == "strain":
        return strain.of_particles(live), UNITS[kind]
    if kind == "speed":
        moved = np.zeros(len(live.positions)) if before is None else np.linalg.norm(live.positions - before, axis=1)
        return moved * live.fps, UNITS[kind]
    if kind in ("stress", "stiffness"):
        return getattr(live, kind)
    if kind == "mass":
        return None if live.mass is None else (live.mass, UNITS[kind])
    if kind == "error" and off is not None:
        return off, UNITS[kind]
    return None
