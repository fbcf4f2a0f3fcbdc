"""A sheet's points made into a mesh: nodes spread evenly over it, triangles between them, and where in them each point lies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .outline import BAY, Domain, areas, even, radii, sides

__all__ = ["Strip", "located", "meshed", "smoothed"]

THIN = 0.05  # least height over the longest side
NEAREST = 0.6  # of the nodes' distance: no node of a row, of the outline or of a first guess is nearer to one before it
OUTSIDE = 0.4  # likewise: a place of a row that is not farther outside than that goes to the outline
FINE = 6  # places along a nodes' distance by which areas are told
ROUNDS = 30  # of Lloyd's: nodes move by a hundredth of their distance then
PATCH = 1.2  # of the nodes' distance: width of the weights by which a node's place is told by the points around it
AROUND = 12  # nodes that tell how a triangle is bent
UNCLEAR = 30.0  # condition of them as a measure of that, beyond which it is taken for flat
CUBIC = 12  # points that tell a curved patch; fewer tell a plane


@dataclass(frozen=True, eq=False)
class Strip:
    """What a bar holds of a sheet that is laid out flat: from ``start`` to ``end`` (2,) [m], and ``half`` [m] to either side.

    Where a sheet begins to bend beside a bar tells all of its motion, and in a mesh that lies across the strip it hangs on how triangles
    happen to lie.
    """

    start: np.ndarray
    end: np.ndarray
    half: float

    @classmethod
    def of(cls, places) -> Strip:
        """Of ``places`` (n, 2) along it: their middle line, and their RMS distance from it."""
        middle = places.mean(0)
        way = np.linalg.svd(places - middle)[2][0]
        along = (places - middle) @ way
        off = places - middle - along[:, None] * way
        return cls(middle + along.min() * way, middle + along.max() * way, float(np.sqrt((off**2).sum(1).mean())))

    def rows(self, pitch: float, towards) -> np.ndarray:
        """(k, 2) places about ``pitch`` apart in rows: along both edges, or the middle of a narrow one, and one more ``towards``."""
        length = np.linalg.norm(self.end - self.start)
        way = (self.end - self.start) / length
        side = np.array([-way[1], way[0]])
        side = side if side @ (towards - self.start) > 0 else -side
        count = max(1, round(length / pitch))
        edges = [-self.half, self.half] if 2 * self.half > NEAREST * pitch else [0.0]
        found = []
        for k, off in enumerate([*edges, edges[-1] + np.sqrt(0.75) * pitch]):
            share = np.arange(count + 1) / count if k % 2 == 0 else (np.arange(count) + 0.5) / count
            found.append(self.start + share[:, None] * length * way + off * side)
        return np.concatenate(found)


def meshed(flat, count: int, strips: Sequence[Strip] = ()) -> tuple[np.ndarray, np.ndarray, float]:
    """(about ``count`` nodes (n, 2) m, triangles (F, 3) between them, the nodes' distance [m]) of a sheet that points ``flat`` (N, 2) tell.

    Nodes are first those of the rows along ``strips``; then the outline's, evenly from corner to corner; then as many inside as are left,
    each in the middle of what is nearest to it (Lloyd 1982), so that triangles are nearly equilateral. Raises ValueError for
    points in a row.
    """
    from scipy.spatial import Delaunay, cKDTree

    flat = np.asarray(flat, float)
    if len(flat) < 4 or np.linalg.svd(flat - flat.mean(0), compute_uv=False)[1] < 1e-6:
        raise ValueError(f"the points of a sheet must fill an area, got {len(flat)} in a row")
    count = min(count, len(flat))
    domain = Domain.of(flat, count)
    pitch = domain.pitch(count)
    outline = domain.outline(pitch / FINE)
    along = np.concatenate(outline)
    wanted = [domain.kept(place, along, OUTSIDE * pitch) for strip in strips for place in strip.rows(pitch, flat.mean(0))]
    fixed = np.zeros((0, 2))
    for place in (*(place for place in wanted if place is not None), *(place for loop in outline for place in even(loop, pitch))):
        if np.linalg.norm(fixed - place, axis=1).min(initial=np.inf) > NEAREST * pitch:
            fixed = np.concatenate([fixed, place[None]])
    grid = domain.filled(pitch / FINE)
    nodes, apart = fixed, cKDTree(fixed).query(grid)[0]
    while len(nodes) < count and apart.max() > NEAREST * pitch:
        nodes = np.concatenate([nodes, grid[None, apart.argmax()]])
        apart = np.minimum(apart, np.linalg.norm(grid - nodes[-1], axis=1))
    for _ in range(ROUNDS):
        own = cKDTree(nodes).query(grid)[1]
        held = np.maximum(np.bincount(own, minlength=len(nodes)), 1)
        middle = np.stack([np.bincount(own, g, len(nodes)) / held for g in grid.T], 1)
        nodes = np.concatenate([fixed, middle[len(fixed) :]])
    triangles = Delaunay(nodes).simplices
    corners = nodes[triangles]
    fat = (radii(corners) < BAY * pitch) & (2 * areas(corners) > THIN * sides(corners).max(1) ** 2)
    triangles = triangles[fat & domain.holds(corners.mean(1))]
    used = np.unique(triangles)
    if not len(used):
        raise ValueError("the points of a sheet must fill an area, got no triangle between them")
    place = np.full(len(nodes), -1)
    place[used] = np.arange(len(used))
    return nodes[used], place[triangles], pitch


def located(flat, nodes, triangles) -> tuple[np.ndarray, np.ndarray]:
    """(corners (M, K), weights (M, K) that sum to 1) of points ``flat`` (M, 2): of which nodes (N, 2) each is a mixture, and which.

    In the triangle around it, or the nearest one, on its rim at most, a point is where linear interpolation has it, and off that by what
    the sheet bends: -1/2 sum_{i<j} l_i l_j e_ij' H e_ij of barycentric coordinates l, sides e and the second derivatives H that a quadratic
    through the nodes around tells by least squares. So quadratics are met exactly; of a mesh of 36 mm that is bent to a radius of 5 cm the
    middle of a side would be 3 mm off otherwise.
    """
    from scipy.spatial import cKDTree

    middle = nodes[triangles].mean(1)
    near = cKDTree(middle).query(flat, k=min(8, len(triangles)))[1].reshape(len(flat), -1)
    corners = nodes[triangles[near]]  # (M, k, 3, 2)
    edges = np.swapaxes(corners[:, :, 1:] - corners[:, :, :1], 2, 3)
    share = np.linalg.solve(edges, (flat[:, None] - corners[:, :, 0])[..., None])[..., 0]
    weights = np.concatenate([1 - share.sum(2, keepdims=True), share], 2)
    best = weights.min(2).argmax(1)
    chosen = weights[np.arange(len(flat)), best]
    chosen = np.maximum(chosen, 0.0)
    chosen /= chosen.sum(1, keepdims=True)
    own = near[np.arange(len(flat)), best]
    patch, bends = _bends(nodes, triangles)
    ways = nodes[triangles[own]][:, [1, 2, 0]] - nodes[triangles[own]]
    both = chosen * chosen[:, [1, 2, 0]]
    squares = np.stack([ways[..., 0] ** 2, ways[..., 1] ** 2, 2 * ways[..., 0] * ways[..., 1]], 2)
    bulge = -np.einsum("ms,msc,mck->mk", both, squares, bends[own]) / 2
    return np.concatenate([triangles[own], patch[own]], 1), np.concatenate([chosen, bulge], 1)


def _bends(nodes, triangles):
    """((F, K) nodes around each triangle, (F, 3, K) 1/m^2 by which they tell second derivatives (11, 22, 12); 0 where they cannot)."""
    beside: list[set[int]] = [set() for _ in nodes]
    for t in triangles.tolist():
        for i in t:
            beside[i].update(t)
    patch, found = np.repeat(triangles[:, :1], AROUND, 1), np.zeros((len(triangles), 3, AROUND))
    for f, t in enumerate(triangles):
        around = np.array(sorted(set.union(*(beside[i] for i in t))))
        off = nodes[around] - nodes[t].mean(0)
        nearest = np.argsort((off**2).sum(1), kind="stable")[:AROUND]
        patch[f, : len(nearest)] = around[nearest]
        size = np.sqrt((off[nearest] ** 2).sum(1).mean())
        x, y = off[nearest].T / size
        terms = np.stack([np.ones_like(x), x, y, x * x / 2, y * y / 2, x * y], 1)
        if len(nearest) > 6 and np.linalg.cond(terms) < UNCLEAR:
            found[f, :, : len(nearest)] = np.linalg.pinv(terms)[3:] / size**2
    return patch, found


def smoothed(flat, points, at, pitch: float) -> np.ndarray:
    """(n, 3) m, where the sheet is at ``at`` (n, 2), by ``points`` (N, 3) that lie at ``flat`` (N, 2): a quadratic through those nearby.

    Moving least squares (Lancaster and Salkauskas 1981): noise of single points is no strain of the sheet.
    """
    from scipy.spatial import cKDTree

    tree, found = cKDTree(flat), np.zeros((len(at), 3))
    for n, place in enumerate(at):
        near = tree.query_ball_point(place, 2 * PATCH * pitch)
        if len(near) < 4:
            near = tree.query(place, k=min(4, len(flat)))[1]
        near = np.asarray(near)
        x, y = ((flat[near] - place) / pitch).T
        terms = [np.ones_like(x), x, y] + ([x * x, x * y, y * y] if len(near) >= CUBIC else [])
        weight = np.exp(-(x * x + y * y) / (2 * PATCH**2) * 2)[:, None]
        found[n] = np.linalg.lstsq(np.stack(terms, 1) * weight, points[near] * weight, rcond=1e-6)[0][0]
    return found
