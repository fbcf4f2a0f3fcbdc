"""A sheet's points made into a mesh: nodes spread evenly over it, triangles between them, and where in them each point lies."""

from __future__ import annotations

import numpy as np

from ...datasets.spacing import spacing

__all__ = ["located", "meshed", "smoothed"]

WIDE = 1.3  # of the nodes' distance: radius of the largest circle around a triangle; larger ones are bays of the outline
THIN = 0.05  # least height over the longest side
PATCH = 1.2  # of the nodes' distance: width of the weights by which a node's place is told by the points around it
CUBIC = 12  # points that tell a curved patch; fewer tell a plane


def meshed(flat, count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """(which of the points ``flat`` (N, 2) [m] are nodes, triangles (F, 3) between those, the nodes' distance [m]).

    Each node is the point that is farthest from those before it, the first the one farthest from the middle; triangles are Delaunay's
    without the bays of the outline. Raises ValueError for points in a row.
    """
    from scipy.spatial import Delaunay

    flat = np.asarray(flat, float)
    nodes = [int(np.linalg.norm(flat - flat.mean(0), axis=1).argmax())]
    apart = np.linalg.norm(flat - flat[nodes[0]], axis=1)
    while len(nodes) < min(count, len(flat)) and apart.max() > 0:
        nodes.append(int(apart.argmax()))
        apart = np.minimum(apart, np.linalg.norm(flat - flat[nodes[-1]], axis=1))
    nodes = np.array(nodes)
    if len(nodes) < 4 or np.linalg.svd(flat[nodes] - flat[nodes].mean(0), compute_uv=False)[1] < 1e-6:
        raise ValueError(f"the points of a sheet must fill an area, got {len(nodes)} in a row")
    pitch = spacing(flat[nodes])
    triangles = Delaunay(flat[nodes]).simplices
    corners = flat[nodes][triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = _areas(corners)
    kept = (sides.prod(1) / np.maximum(4 * area, 1e-15) < WIDE * pitch) & (2 * area > THIN * sides.max(1) ** 2)
    used = np.unique(triangles[kept])
    if not len(used):
        raise ValueError("the points of a sheet must fill an area, got no triangle between them")
    place = np.full(len(nodes), -1)
    place[used] = np.arange(len(used))
    return nodes[used], place[triangles[kept]], pitch


def located(flat, nodes, triangles) -> tuple[np.ndarray, np.ndarray]:
    """(corners (M, 3), weights (M, 3)) of points ``flat`` (M, 2) in the triangle around them, or the nearest one, on its rim at most."""
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
    return triangles[near[np.arange(len(flat)), best]], chosen / chosen.sum(1, keepdims=True)


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


def _areas(corners):
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
