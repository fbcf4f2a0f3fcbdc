"""Which particles are tied by springs: sparse neighbour searches in the published order."""

from __future__ import annotations

import numpy as np

__all__ = ["controller_springs", "object_springs"]


def object_springs(points, *, radius: float, max_neighbours: int) -> np.ndarray:
    """Springs (E, 2) int32 between ``points`` (M, 3) [m], each once, in PhysTwin's order, so that its checkpoints' stiffness fits.

    For i ascending: the neighbours of i within ``radius``, nearest first, at most ``max_neighbours`` counting i itself; the first hit (i)
    is dropped, (i, j) is added where the pair is new and longer than 1e-4 m. Positions count as float32, as published.
    """
    _positive("object_radius", radius)
    points = _points("points", points)
    if len(points) < 2 or max_neighbours < 2:
        return np.zeros((0, 2), np.int32)
    first, second, distance = _hits(points, points, radius, max_neighbours, drop_first=True)
    keep = distance > 1e-4
    first, second = first[keep], second[keep]
    pair = np.minimum(first, second) * len(points) + np.maximum(first, second)
    order = np.sort(np.unique(pair, return_index=True)[1])
    return np.stack([first[order], second[order]], 1).astype(np.int32)


def controller_springs(controllers, points, *, radius: float, max_neighbours: int) -> np.ndarray:
    """Springs (E, 2) int32 (controller, particle): each of ``controllers`` (C, 3) with its nearest ``points`` (M, 3) [m] within ``radius``.

    At most ``max_neighbours`` each; a controller with nobody in reach has none.
    """
    _positive("controller_radius", radius)
    controllers, points = _points("controllers", controllers), _points("points", points)
    if len(points) == 0 or len(controllers) == 0 or max_neighbours < 1:
        return np.zeros((0, 2), np.int32)
    first, second, _ = _hits(controllers, points, radius, max_neighbours)
    return np.stack([first, second], 1).astype(np.int32)


def _hits(queries, points, radius, count, *, drop_first=False):
    """(query, neighbour, distance) by query, then nearest first."""
    from scipy.spatial import cKDTree

    count = min(int(count), len(points))
    distance, index = cKDTree(points).query(queries, k=np.arange(1, count + 1), distance_upper_bound=radius)
    if drop_first:
        distance, index = distance[:, 1:], index[:, 1:]
    found = np.isfinite(distance)
    query = np.broadcast_to(np.arange(len(queries))[:, None], found.shape)
    return query[found].astype(np.int64), index[found].astype(np.int64), distance[found]


def _points(name, value):
    value = np.asarray(value, np.float32).astype(np.float64)
    if value.ndim != 2 or value.shape[1] != 3 or not np.isfinite(value).all():
        raise ValueError(f"{name} must be finite with shape (points, 3), got shape {value.shape}")
    return value


def _positive(name, value):
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name} must be > 0 [m], got {value}")
