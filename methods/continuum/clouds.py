"""Distances between clouds of points and the skin of a body: from points to planes through neighbours, smooth while both move.

Chen and Medioni (1992): a point's distance from the tangent plane of what is nearest to it does not change while it slides along, other
than its distance from the nearest point. What is nearest is looked up anew whenever a distance is asked for. Beyond the rim, where the
plane ends, the way to the rim counts as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...datasets.scenario import Observed

__all__ = ["Cover", "Patches", "covers", "evenly", "roughness"]

NEAR = 8  # neighbours that tell a plane
GRAIN = 1.5  # of a patch's radius, within which a point is beside it and not beyond the rim


@dataclass(frozen=True, eq=False)
class Patches:
    """The skin of a body: ``rows`` (S,) of the structure's points, and the ``neighbours`` (S, k) of each among them in frame 0."""

    rows: np.ndarray
    neighbours: np.ndarray

    @classmethod
    def of(cls, recording: Observed) -> Patches:
        """Of the known tracked and surface points. Raises ValueError where they are too few for planes."""
        tracked, surface, _ = recording.counts
        rows = np.flatnonzero(recording.known[: tracked + surface])
        if len(rows) < NEAR:
            raise ValueError(f"a skin must have at least {NEAR} points in frame 0, got {len(rows)} (scenario {recording.name})")
        return cls(rows, _neighbours(recording.structure[rows], recording.structure[rows]))

    def distances(self, cloud, structure) -> np.ndarray:
        """(K,) m, from the points of a ``cloud`` (K, 3) to the skin while the structure is at ``structure`` (M, 3)."""
        from scipy.spatial import cKDTree

        if not len(cloud):
            return np.zeros(0)
        skin = structure[self.rows]
        nearest = cKDTree(skin).query(cloud)[1]
        return _off(cloud, skin[nearest], skin[self.neighbours[nearest]])


@dataclass(frozen=True, eq=False)
class Cover:
    """A cloud that shows all of a body: its points (K, 3) m, the ``neighbours`` (K, k, 3) of each, and the ``rows`` of the skin."""

    points: np.ndarray
    neighbours: np.ndarray
    rows: np.ndarray

    def distances(self, structure) -> np.ndarray:
        """(n,) m, from the skin's points to the cloud."""
        from scipy.spatial import cKDTree

        skin = structure[self.rows]
        nearest = cKDTree(self.points).query(skin)[1]
        return _off(skin, self.points[nearest], self.neighbours[nearest])


def covers(cloud, rows) -> Cover:
    """The ``cloud`` (K, 3) as what the structure's points ``rows`` ought to lie on."""
    return Cover(cloud, cloud[_neighbours(cloud, cloud)], np.asarray(rows))


def evenly(points, apart: float) -> np.ndarray:
    """Indices of ``points`` (K, 3) that are at least ``apart`` [m] from each other, as many as can be added; always the same."""
    from scipy.spatial import cKDTree

    free, kept = np.ones(len(points), bool), []
    tree: Any = cKDTree(points) if len(points) else None
    for k in np.random.default_rng(0).permutation(len(points)):
        if free[k]:
            kept.append(k)
            free[tree.query_ball_point(points[k], apart)] = False
    return np.sort(np.array(kept, int))


def roughness(few, cloud) -> float:
    """m, how far the points of a ``cloud`` (K, 3) are off planes through their neighbours, RMS in the median over the places ``few``."""
    beside = cloud[_neighbours(few, cloud)]
    off = beside - beside.mean(1, keepdims=True)
    least = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", off, off))[:, 0] / max(beside.shape[1] - 3, 1)  # a plane takes three
    return float(np.sqrt(np.median(np.maximum(least, 0))))


def _neighbours(places, points):
    """(n, k) of ``points`` (K, 3) that are nearest to ``places`` (n, 3)."""
    from scipy.spatial import cKDTree

    return cKDTree(points).query(places, k=range(1, min(NEAR, len(points)) + 1))[1]


def _off(points, nearest, beside):
    """(n,) m, from ``points`` (n, 3) to the patches of ``beside`` (n, k, 3), of which ``nearest`` (n, 3) are the points next to them."""
    middle = beside.mean(1)
    arms = beside - middle[:, None]
    normal = np.linalg.eigh(np.einsum("nki,nkj->nij", arms, arms))[1][:, :, 0]
    above = np.einsum("ni,ni->n", points - middle, normal)
    way = points - nearest
    along = np.linalg.norm(way - np.einsum("ni,ni->n", way, normal)[:, None] * normal, axis=1)
    radius = np.sqrt((arms**2).sum(2).mean(1))
    return np.hypot(above, np.maximum(along - GRAIN * radius, 0.0))
