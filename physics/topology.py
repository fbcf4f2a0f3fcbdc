"""Which particles are tied by springs (sparse neighbour searches in the published order), and which three in a row bend."""

from __future__ import annotations

import numpy as np

__all__ = ["Neighbours", "controller_springs", "object_springs", "rope_hinges", "sheet_hinges"]

SHORTEST = 1e-4  # m, published: a pair that is no farther apart gets no spring
CROWD = 10_000  # neighbours from which on starting threads is worth the while


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
    keep = distance > SHORTEST
    first, second = first[keep], second[keep]
    pair = np.minimum(first, second) * len(points) + np.maximum(first, second)
    order = np.sort(np.unique(pair, return_index=True)[1])
    return np.stack([first[order], second[order]], 1).astype(np.int32)


class Neighbours:
    """The springs of one body for many radii and numbers of neighbours, from one search: the same arrays as ``object_springs`` gives.

    points          (M, 3) m
    radius          [m] the largest that will be asked for
    max_neighbours  the most that will be asked for

    Where two neighbours of a point are equally far, the search tree alone says which comes first: such a point is looked up each time.
    """

    def __init__(self, points, *, radius: float, max_neighbours: int):
        _positive("object_radius", radius)
        self._points, self._radius, self._most = _points("points", points), radius, int(max_neighbours)
        count, width = len(self._points), max(min(int(max_neighbours), len(self._points)), 1)
        self._tree = _tree(self._points)
        distance, index = _nearest(self._tree, self._points, radius, width + 1)  # one more, which may tie with the last
        self._distance, self._index = distance[:, 1:width], index[:, 1:width]
        self._place = _places(self._index)
        tied = ((distance[:, :-1] == distance[:, 1:]) & np.isfinite(distance[:, 1:])).any(1)
        self._tied = np.flatnonzero(tied)
        self._doubtful = tied[:, None] | np.append(tied, False)[np.minimum(self._index, count)]

    def springs(self, *, radius: float, max_neighbours: int) -> np.ndarray:
        """What ``object_springs`` gives for these. Raises ValueError beyond what was prepared for."""
        _positive("object_radius", radius)
        if radius > self._radius or max_neighbours > self._most:
            known = f"within {self._radius} m, at most {self._most}"
            raise ValueError(f"neighbours are known {known}, got object_radius {radius} and max_neighbours {max_neighbours}")
        width = max(min(int(max_neighbours), len(self._points)) - 1, 0)
        distance, index, back = self._distance[:, :width], self._index[:, :width], self._place[:, :width] < width
        if len(self._tied) > len(index) // 4 or (np.abs(distance - radius) <= 1e-12 * radius).any():  # a square root may be rounded over it
            return object_springs(self._points, radius=radius, max_neighbours=max_neighbours)
        if len(self._tied) and width:
            distance, index, back = self._looked_up(radius, width, distance.copy(), index.copy(), back)
        here = np.arange(len(index))[:, None]
        # a pair counts where it comes up first: at its lower point, or at the other one where that is not among the lower one's neighbours
        kept = (distance < radius) & (distance > SHORTEST) & ((index > here) | ~back)
        return np.stack([np.broadcast_to(here, kept.shape)[kept], index[kept]], 1).astype(np.int32)

    def _looked_up(self, radius, width, distance, index, back):
        """The lists with those of tied points as the tree gives them, and whether each point is in the list of its neighbour."""
        found = _nearest(self._tree, self._points[self._tied], radius, width + 1)
        distance[self._tied], index[self._tied] = (array[:, 1:] for array in found)
        row, column = np.nonzero(self._doubtful[:, :width])
        other = np.minimum(index[row, column], len(index) - 1)
        back[row, column] = (index[other] == row[:, None]).any(1)
        return distance, index, back


def _places(index: np.ndarray) -> np.ndarray:
    """(M, K) at which place each point i stands in the list of its neighbour ``index[i, k]``; K where it is not in it."""
    count, width = index.shape
    here = np.broadcast_to(np.arange(count)[:, None], index.shape)
    known = index < count  # beyond the radius the search gives as many as there are points
    pairs, back = (here * count + index)[known], (index * count + here)[known]
    order = np.argsort(pairs)
    found = np.minimum(np.searchsorted(pairs, back, sorter=order), max(len(pairs) - 1, 0))
    place = np.full(index.shape, width)
    place[known] = np.where(pairs[order[found]] == back, np.broadcast_to(np.arange(width), index.shape)[known][order[found]], width)
    return place


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


def rope_hinges(chain) -> np.ndarray:
    """Hinges (H, 3) of the nodes ``chain`` (N,) in order: every three that follow each other, around the end too where it is the first.

    >>> rope_hinges([4, 7, 8, 9]).tolist()
    [[4, 7, 8], [7, 8, 9]]
    """
    chain = np.asarray(chain, np.int64)
    if chain.ndim != 1 or len(chain) < 2:
        raise ValueError(f"chain must have shape (N,) with N >= 2, got {chain.shape}")
    if len(chain) > 3 and chain[0] == chain[-1]:
        chain = np.append(chain, chain[1])
    return np.stack([chain[:-2], chain[1:-1], chain[2:]], 1)


def sheet_hinges(points, springs, *, straight: float = 25.0, most: int = 3) -> np.ndarray:
    """Hinges (H, 3) across the particles of a sheet or solid: two neighbours that lie nearly opposite each other.

    points    (M, 3) m, in the shape in which straightness is meant
    springs   (E, 2) whose ends are neighbours; those that lead to no particle do not count
    straight  degrees from straight that a hinge may have
    most      hinges that a particle may be the middle of; the straightest come first, and a neighbour is in one of them
    """
    points, springs = _points("points", points), np.asarray(springs, np.int64).reshape(-1, 2)
    if not 0 < straight < 90:
        raise ValueError(f"straight must lie in (0, 90) degrees, got {straight}")
    ends = np.sort(springs[(springs < len(points)).all(1)], axis=1)
    ends = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0)
    both = np.concatenate([ends, ends[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    row = np.searchsorted(both[:, 0], np.arange(len(points) + 1))
    found = []
    for i in range(len(points)):
        others = both[row[i] : row[i + 1], 1]
        away = points[others] - points[i]
        away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        cosine = away @ away.T
        first, second = np.nonzero(np.triu(cosine < -np.cos(np.radians(straight)), 1))
        used = set()
        # equally straight ones in the order of their particles: the same on every machine, whatever the last bit
        for k in np.lexsort((second, first, np.round(cosine[first, second], 9))):
            pair = {int(first[k]), int(second[k])}
            if len(used) < 2 * most and not pair & used:
                used |= pair
                found.append((others[first[k]], i, others[second[k]]))
    return np.array(found, np.int64).reshape(-1, 3)


def _tree(points):
    from scipy.spatial import cKDTree

    return cKDTree(points.reshape(-1, 3))


def _nearest(tree, queries, radius, count):
    """Distance and index (queries, count) of the nearest points within ``radius``; infinity and their number where there are fewer."""
    workers = -1 if len(queries) * count > CROWD else 1
    return tree.query(queries, k=np.arange(1, count + 1), distance_upper_bound=radius, workers=workers)


def _hits(queries, points, radius, count, *, drop_first=False):
    """(query, neighbour, distance) by query, then nearest first."""
    distance, index = _nearest(_tree(points), queries, radius, min(int(count), len(points)))
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
