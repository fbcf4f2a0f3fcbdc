"""The inside of a body that is known by points on its skin and perhaps within: what a ball cannot reach from outside.

The Delaunay tetrahedra of the points are carved from outside: a tetrahedron goes where its circumsphere is larger than the ball, if the
ball gets there through triangles that are wide enough. This is the alpha shape (Edelsbrunner and Muecke 1994) with its voids filled, so
that a skin alone has an inside too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from .carving import FACES, Carving

__all__ = ["Inside", "inside_of"]

ASIDE = 1e-4  # of the ball's radius, by which points are moved, so that no five of them lie on a sphere
RADII = 1.15 ** np.arange(7)  # of the ball, tried in turn, in the points' spacings: larger ones fill the bays of a bent sheet
MARGIN = 1.2  # by which the ball is larger than the smallest one that leaves the body in one piece
DENSE = 20_000  # points on the skin to which depths are measured
DEPTHS = 4_000  # points inside at which the depth is measured


@dataclass(frozen=True, eq=False)
class Inside:
    """A body among ``points`` (M, 3) [m].

    mesh    their Delaunay triangulation, and ``kept`` (all,) bool which of its tetrahedra the body fills
    radius  m, of the ball that told them
    """

    points: np.ndarray
    mesh: Any  # scipy.spatial.Delaunay
    kept: np.ndarray
    radius: float

    @cached_property
    def tetrahedra(self) -> np.ndarray:
        """(E, 4) corners of what the body fills."""
        return self.mesh.simplices[self.kept]

    @cached_property
    def sizes(self) -> np.ndarray:
        """(E,) m^3, of the tetrahedra."""
        return np.abs(np.linalg.det(self.points[self.tetrahedra[:, 1:]] - self.points[self.tetrahedra[:, :1]])) / 6

    @property
    def volume(self) -> float:
        """m^3."""
        return float(self.sizes.sum())

    @cached_property
    def facets(self) -> np.ndarray:
        """(F, 3) the skin: triangles that belong to one tetrahedron only."""
        faces = np.sort(self.tetrahedra[:, FACES].reshape(-1, 3), axis=1)
        faces, times = np.unique(faces, axis=0, return_counts=True)
        return faces[times == 1]

    @cached_property
    def areas(self) -> np.ndarray:
        """(F,) m^2, of the facets."""
        a, b, c = np.moveaxis(self.points[self.facets], 1, 0)
        return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2

    @property
    def area(self) -> float:
        """m^2, of the skin."""
        return float(self.areas.sum())

    def scattered(self, count: int) -> np.ndarray:
        """(count, 3) m, random points inside, always the same, equally many in equal volumes."""
        return _mixed(self.points, self.tetrahedra, self.sizes, count)

    def skin(self, count: int) -> np.ndarray:
        """(count, 3) m, random points on the skin, always the same, equally many on equal areas."""
        return _mixed(self.points, self.facets, self.areas, count)

    @cached_property
    def thickness(self) -> float:
        """Median local thickness [m]: of the largest sphere inside that holds a point, the diameter (Hildebrand and Rueegsegger 1997)."""
        from scipy.spatial import cKDTree

        at = self.scattered(DEPTHS)
        depth = cKDTree(self.skin(DENSE)).query(at)[0]
        thick, free = np.zeros(len(at)), np.ones(len(at), bool)
        tree = cKDTree(at)
        for i in np.argsort(-depth):
            if not free.any():
                break
            near = np.asarray(tree.query_ball_point(at[i], depth[i]), int)
            near = near[free[near]]
            thick[near], free[near] = 2 * depth[i], False
        return float(np.median(thick))

    @property
    def corners(self) -> np.ndarray:
        """(C, 3) m, the points that the body reaches."""
        return self.points[np.unique(self.tetrahedra)]

    def lattice(self, step: float, axes=None) -> np.ndarray:
        """(P, 3) m, evenly spaced points inside, about ``step`` [m] apart along the rows of ``axes`` (3, 3), the room's unless given."""
        axes = np.eye(3) if axes is None else axes
        along = self.corners @ axes.T
        low, extent = along.min(0), np.ptp(along, axis=0)
        count = np.maximum(np.ceil(extent / step - 1e-3).astype(int), 1)
        ticks = [low[k] + (np.arange(count[k]) + 0.5) * extent[k] / count[k] for k in range(3)]
        at = np.stack(np.meshgrid(*ticks, indexing="ij"), -1).reshape(-1, 3) @ axes
        cell = self.mesh.find_simplex(at)
        return at[(cell >= 0) & self.kept[cell]]


def inside_of(points, spacing: float, *, radius: float | None = None) -> Inside:
    """What ``points`` (M, 3) [m], ``spacing`` [m] apart, enclose.

    radius [m] of the ball; unless given a fifth more than the smallest one that leaves nearly all points at one connected inside.
    What was told last is remembered: the cells of a search and of what follows it are cut from the same points.
    Raises ValueError where there are fewer than five points, or they lie in a plane or in a row.
    """
    points = np.ascontiguousarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"the points of a body must be finite and have shape (M, 3), got shape {points.shape}")
    if len(points) < 5:
        raise ValueError(f"a body must have at least 5 points to have an inside, got {len(points)}")
    if not spacing > 0:
        raise ValueError(f"the spacing of a body's points must be > 0 [m], got {spacing}")
    if np.linalg.svd(points - points.mean(0), compute_uv=False)[2] < ASIDE * spacing * np.sqrt(len(points)):
        raise ValueError(f"the {len(points)} points of the body lie in a plane, so that they have no inside")
    return _carved(points.tobytes(), float(spacing), radius)


@lru_cache(maxsize=4)
def _carved(content: bytes, spacing: float, radius: float | None) -> Inside:
    points = np.frombuffer(content).reshape(-1, 3)
    carving = Carving(points + np.random.default_rng(0).uniform(-ASIDE, ASIDE, points.shape) * spacing)
    if radius is None:
        radius = MARGIN * float(next((r for r in spacing * RADII if carving.whole(r)), spacing * RADII[-1]))
    kept = carving.kept(radius)
    if not kept.any():
        raise ValueError(f"the {len(points)} points of the body enclose nothing that a ball of {1e3 * radius:.1f} mm does not reach")
    return Inside(carving.points, carving.mesh, kept, float(radius))


def _mixed(points, elements, sizes, count):
    rng = np.random.default_rng(0)
    chosen = elements[np.searchsorted(np.cumsum(sizes), (np.arange(count) + 0.5) / count * sizes.sum())]
    return np.einsum("pk,pkd->pd", rng.dirichlet(np.ones(elements.shape[1]), count), points[chosen])
