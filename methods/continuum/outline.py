"""The area that points of a sheet fill, and its outline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

__all__ = ["BAY", "Domain", "areas", "even", "radii", "sides", "squared"]

BAY = 1.3  # of the nodes' distance: radius of the largest circle around a triangle of the area; larger ones are bays of the outline
CORNER = np.radians(50)  # by which an outline turns within two nodes' distances at a corner


@dataclass(frozen=True, eq=False)
class Domain:
    """Those of Delaunay's triangles between points (N, 2) [m] that are the sheet's: ``inside`` (F,) bool."""

    points: np.ndarray
    delaunay: Any
    inside: np.ndarray

    @classmethod
    def of(cls, points, count: int) -> Domain:
        """Of a mesh of ``count`` nodes, which no finer bay than its triangles can follow."""
        from scipy.spatial import Delaunay

        delaunay = Delaunay(points)
        corners = points[delaunay.simplices]
        pitch = np.sqrt(2 / np.sqrt(3) * areas(corners).sum() / count)
        widest = max(BAY * pitch, 3 * float(np.median(sides(corners))))
        return cls(points, delaunay, radii(corners) < widest)

    def pitch(self, count: int) -> float:
        """m, between neighbours of ``count`` nodes of equilateral triangles: N = 2 A / (sqrt(3) p^2) + P / (2 p) + 1 of an area A whose
        outline is P long."""
        a = 2 / np.sqrt(3) * areas(self.points[self.delaunay.simplices[self.inside]]).sum()
        p = sum(np.linalg.norm(o - np.roll(o, 1, axis=0), axis=1).sum() for o in self._loops) / 2
        more = max(count, 4) - 1
        return float(2 * a / (np.sqrt(p * p + 4 * a * more) - p))

    def holds(self, at) -> np.ndarray:
        """(n,) whether places (n, 2) are inside."""
        which = self.delaunay.find_simplex(at)
        return (which >= 0) & self.inside[which]

    def kept(self, place, along, far: float) -> np.ndarray | None:
        """``place`` (2,), or the nearest of ``along`` (m, 2) where it is outside; None beyond ``far``."""
        if self.holds(place[None])[0]:
            return place
        apart = np.linalg.norm(along - place, axis=1)
        return along[apart.argmin()] if apart.min() <= far else None

    def filled(self, pitch: float) -> np.ndarray:
        """(n, 2) places all over it, ``pitch`` apart."""
        low, high = self.points.min(0), self.points.max(0)
        grid = np.stack(
            np.meshgrid(*[np.arange(a + pitch / 2, b, pitch) for a, b in zip(low, high, strict=True)], indexing="ij"), -1
        ).reshape(-1, 2)
        return grid[self.holds(grid)]

    def outline(self, step: float) -> list[np.ndarray]:
        """Its loops, each (m, 2) places as far apart along it, about ``step``."""
        return [_divided(np.concatenate([loop, loop[:1]]), step) for loop in self._loops]

    @cached_property
    def _loops(self) -> list[np.ndarray]:
        triangles = self.delaunay.simplices[self.inside]
        a, b, c = np.swapaxes(self.points[triangles], 0, 1)
        turned = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) < 0
        triangles = np.where(turned[:, None], triangles[:, ::-1], triangles)
        edges = {(int(t[k - 1]), int(t[k])) for t in triangles for k in range(3)}
        leaving: dict[int, list[int]] = {}
        for i, j in sorted(edges):
            if (j, i) not in edges:
                leaving.setdefault(i, []).append(j)
        loops = []
        while leaving:
            way = [next(iter(leaving))]
            while way[-1] in leaving:
                ends = leaving[way[-1]]
                way.append(ends.pop())
                if not ends:
                    del leaving[way[-2]]
                if way[-1] == way[0]:
                    break
            loops.append(self.points[way[:-1]])
        return [loop for loop in loops if len(loop) > 2]


def areas(corners) -> np.ndarray:
    """(F,) m^2 of triangles (F, 3, 2)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def sides(corners) -> np.ndarray:
    """(F, 3) m, of the same."""
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def radii(corners) -> np.ndarray:
    """(F,) m, of the circles around them."""
    return sides(corners).prod(1) / np.maximum(4 * areas(corners), 1e-15)


def even(loop, pitch: float) -> np.ndarray:
    """(n, 2) places about ``pitch`` apart along a ``loop`` (m, 2) of evenly spread places: its corners, and evenly between them."""
    step = np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1).mean()
    far = max(1, round(pitch / step))
    back, ahead = loop - np.roll(loop, far, axis=0), np.roll(loop, -far, axis=0) - loop
    turn = np.abs(np.arctan2(back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0], (back * ahead).sum(1)))
    corners: list[int] = []
    for k in np.argsort(-turn, kind="stable"):
        if turn[k] < CORNER:
            break
        if all(min((k - c) % len(loop), (c - k) % len(loop)) > far for c in corners):
            corners.append(int(k))
    corners = sorted(corners) or [0]
    found = []
    for start, end in zip(corners, [*corners[1:], corners[0] + len(loop)], strict=True):
        count = max(1, round((end - start) * step / pitch))
        found += [loop[round(start + (end - start) * k / count) % len(loop)] for k in range(count)]
    return np.array(found)


def _divided(way, step: float) -> np.ndarray:
    """(m, 2) places as far apart along a closed ``way`` (n, 2), which ends where it begins; that is given once."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    at = np.linspace(0, length[-1], max(4, round(length[-1] / step)) + 1)[:-1]
    return np.stack([np.interp(at, length, w) for w in way.T], 1)


def squared(points) -> np.ndarray:
    """``points`` (N, 2) [m] turned so that the smallest rectangle around them lies along the axes, its longer side along the first."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:
        return points
    ways = np.roll(hull, -1, axis=0) - hull
    ways = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    across = np.stack([-ways[:, 1], ways[:, 0]], 1)
    extent = np.stack([np.ptp(hull @ w.T, axis=0) for w in (ways, across)])
    least = int(extent.prod(0).argmin())
    axes = np.stack([ways[least], across[least]], 1)
    return points @ (axes if extent[0, least] >= extent[1, least] else np.stack([axes[:, 1], -axes[:, 0]], 1))
