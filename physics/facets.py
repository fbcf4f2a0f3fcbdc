"""Facets: the triangles of a body's skin, found among particles, and how the kernels read them."""

from __future__ import annotations

import numpy as np

from .hinges import incidence

__all__ = ["assemble_facets", "enclosed", "sheet_facets", "solid_facets"]

LEVEL = 1e-4  # share of their distance by which particles are moved aside, so that no four of them lie on a circle
ROUND = 0.55  # of the longest spring, which is a diameter: radius of the largest circle around a facet
EMPTY = 0.9  # of a sphere's radius, within which there is nobody: on a curved sheet those on it are only nearly so
OVER = 0.5  # cosine of the angle between two facets at a side, from which on they lie over each other


def sheet_facets(points, springs) -> np.ndarray:
    """Facets (F, 3) between the particles of a sheet, curved or folded, in no particular sense.

    points   (M, 3) m, in the shape in which neighbours on the sheet are the nearest ones
    springs  (E, 2) whose ends may be corners of a facet together; those that lead to no particle do not count

    Three particles are a facet if there is none within the sphere around them that has its middle in their plane, as in the Delaunay
    triangulation of a plane; of those that would lie over each other, the one with the smallest sphere. None is larger than springs reach.
    """
    points, linked, reach = _neighbours(points, springs)
    triangles = [np.zeros((0, 3), np.int64)]
    for i in range(len(points) - 2):
        near = i + 1 + np.flatnonzero(linked[i, i + 1 :])
        j, k = np.nonzero(np.triu(linked[np.ix_(near, near)], 1))
        triangles.append(np.stack([np.full(len(j), i), near[j], near[k]], 1))
    triangles = np.concatenate(triangles)
    centre, radius = _circumcircles(points[triangles])
    fits = radius <= ROUND * reach
    triangles, centre, radius = triangles[fits], centre[fits], radius[fits]
    inner = np.linalg.norm(points[None] - centre[:, None], axis=2) < (EMPTY * radius)[:, None]
    empty = ~(inner & linked[triangles].any(1)).any(1)  # what no spring leads to is another layer
    order = np.flatnonzero(empty)[np.argsort(radius[empty], kind="stable")]
    return triangles[np.sort(_beside_each_other(triangles, points, order))]


def _beside_each_other(triangles, points, order):
    """Those of ``triangles`` (F, 3) that lie over none before them in ``order``: at each side two at most, and on two sides of it."""
    corners = points[triangles]
    along = np.roll(corners, -1, axis=1) - corners
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    inward = np.roll(corners, -2, axis=1) - corners
    inward -= (inward * along).sum(2, keepdims=True) * along
    inward /= np.linalg.norm(inward, axis=2, keepdims=True)
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], 2), axis=2)
    beside: dict[tuple[int, ...], list] = {}
    kept = []
    for f in order:
        there = [beside.setdefault(tuple(side), []) for side in sides[f].tolist()]
        if all(len(one) < 2 and not any(way @ mine > OVER for way in one) for one, mine in zip(there, inward[f], strict=True)):
            kept.append(f)
            for one, mine in zip(there, inward[f], strict=True):
                one.append(mine)
    return np.array(kept, int)


def solid_facets(points, *, radius: float) -> np.ndarray:
    """Facets (F, 3) of the closed skin around the particles of a solid, corners counted anticlockwise from outside.

    The skin bounds the tetrahedra of the Delaunay triangulation whose circumspheres are not larger than ``radius`` [m] (the alpha shape;
    Edelsbrunner and Muecke 1994), so hollows that are narrower than that count as filled. As a boundary it is closed: its area vectors
    sum to zero. Empty where no four particles are that close.
    """
    from scipy.spatial import Delaunay

    if not radius > 0:
        raise ValueError(f"radius must be > 0 [m], got {radius}")
    moved = _aside(points, radius)
    thickness = np.linalg.svd(points - np.mean(points, axis=0), compute_uv=False)[-1] if len(points) > 3 else 0.0
    if not thickness > LEVEL * radius:  # they are all in a plane
        return np.zeros((0, 3), np.int64)
    tetrahedra = Delaunay(moved).simplices
    edges = moved[tetrahedra[:, 1:]] - moved[tetrahedra[:, :1]]
    volume = np.linalg.det(edges)
    centre = np.linalg.solve(edges, (edges**2).sum(-1, keepdims=True) / 2)[..., 0]
    small = np.linalg.norm(centre, axis=1) <= radius
    tetrahedra = np.where((volume > 0)[:, None], tetrahedra, tetrahedra[:, [0, 1, 3, 2]])[small]
    # of a tetrahedron a, b, c, d with positive volume, from outside
    faces = tetrahedra[:, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(-1, 3)
    _, first, times = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[times == 1])].astype(np.int64)


def enclosed(points, facets) -> float:
    """The volume [m^3] inside ``facets`` (F, 3) among ``points`` (M, 3); 0 where they do not close, or are seen from inside."""
    facets = np.asarray(facets, int).reshape(-1, 3)
    if not len(facets):
        return 0.0
    sides = np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]])
    there, back = (sorted(map(tuple, s.tolist())) for s in (sides, sides[:, ::-1]))
    if there != back:
        return 0.0
    a, b, c = np.moveaxis(points[facets] - points[facets[0, 0]], 1, 0)
    return max(0.0, float((a * np.cross(b, c)).sum() / 6))


def assemble_facets(systems, starts, count) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """(constants, volume (B,) m^3) of all systems' facets side by side, as the kernels read them (``kernels.World``).

    ``starts`` is the first of each system's nodes, of which there are ``count``.
    """
    corner = np.concatenate([s.facets + first for s, first in zip(systems, starts, strict=False)])
    row, of = incidence(corner, count)
    first = np.concatenate([[0], np.cumsum([len(s.facets) for s in systems])])
    volume = np.array([enclosed(s.positions, s.facets) for s in systems])
    return dict(facet_start=first, corner=corner, facet_row=row, facet_of=of), volume


def _aside(points, distance):
    """``points`` (M, 3), each a trifle of ``distance`` aside, always the same."""
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (M, 3), got {points.shape}")
    return points + np.random.default_rng(0).uniform(-LEVEL, LEVEL, points.shape) * distance


def _neighbours(points, springs):
    """(M, 3) points, each a trifle aside, (M, M) whether a spring joins them, and the length of the longest [m]."""
    points, springs = np.asarray(points, float), np.asarray(springs, int).reshape(-1, 2)
    a, b = springs[(springs < len(points)).all(1) & (springs[:, 0] != springs[:, 1])].T
    linked = np.zeros((len(points),) * 2, bool)
    linked[a, b] = linked[b, a] = True
    length = np.linalg.norm(points[a] - points[b], axis=1)
    return _aside(points, length.min() if len(length) else 0.0), linked, length.max(initial=0.0)


def _circumcircles(triangles):
    """(F, 3) middles and (F,) radii of the circles around ``triangles`` (F, 3, 3); infinite where corners are in a row."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(a, b)
    twice = 2 * (normal**2).sum(1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (np.cross(normal, a) * (b**2).sum(1, keepdims=True) + np.cross(b, normal) * (a**2).sum(1, keepdims=True)) / twice
    radius = np.linalg.norm(way, axis=1)
    return triangles[:, 0] + way, np.where(np.isfinite(radius), radius, np.inf)
