"""The points of a sheet laid out flat, as far apart as they are on the sheet: lying, hanging or folded in frame 0."""

from __future__ import annotations

import numpy as np

__all__ = ["flattened", "neighbours", "quantile"]

NEAR = 24  # neighbours in frame 0 among which those on the sheet are
LINKS = 8  # of them that are nearest on the sheet
FLATTEST = 0.8  # quantile over time of a distance: the chord is the way on the sheet when it is flattest, and more than that is noise
PLANAR = 0.03  # RMS off a plane over the second extent: such a sheet lies flat
APART = 2.0  # times their distance in frame 0, by which neighbours on one layer never come apart
ROUNDS = 60  # of stress majorisation


def neighbours(points, tracks=None) -> tuple[np.ndarray, np.ndarray, bool]:
    """(links (E, 2), their lengths on the sheet (E,) m, whether some that lie together come apart) of ``points`` (N, 3) [m] in frame 0.

    tracks  (T, N, 3) m, NaN where not seen: two layers that lie on each other come apart some time, neighbours on a layer never
    """
    from scipy.spatial import cKDTree

    count = min(NEAR + 1, len(points))
    far, near = (part[:, 1:] for part in cKDTree(points).query(points, k=count))
    here = np.repeat(np.arange(len(points)), near.shape[1])
    length = far.ravel().copy()
    if tracks is not None and len(tracks) > 1:
        apart = np.linalg.norm(tracks[:, here] - tracks[:, near.ravel()], axis=2)
        seen = np.isfinite(apart).any(0)
        length[seen] = np.maximum(length[seen], quantile(apart[:, seen], FLATTEST))
    length = length.reshape(near.shape)
    first = np.argsort(length, axis=1, kind="stable")[:, :LINKS]
    links = np.stack([np.repeat(np.arange(len(points)), first.shape[1]), np.take_along_axis(near, first, 1).ravel()], 1)
    lengths = np.take_along_axis(length, first, 1).ravel()
    _, once = np.unique(np.sort(links, axis=1), axis=0, return_index=True)
    spacing = float(np.median(far[:, 0]))
    layered = float((length[:, :LINKS] > APART * np.maximum(far[:, :LINKS], spacing)).mean())
    return links[once], lengths[once], layered > 0.02


def quantile(values, share: float) -> np.ndarray:
    """(N,) of the numbers in each column of ``values`` (T, N), of which none may be NaN alone: numpy.nanquantile, forty times as fast."""
    ordered, last = np.sort(values, axis=0), np.isfinite(values).sum(0) - 1  # NaN comes last
    at = share * last
    low = np.floor(at).astype(int)
    a, b = (np.take_along_axis(ordered, np.minimum(k, last)[None], 0)[0] for k in (low, low + 1))
    return a + (b - a) * (at - low)


def flattened(points, tracks=None) -> np.ndarray:
    """(N, 2) m, where ``points`` (N, 3) of a sheet in frame 0 lie when it is laid out flat.

    One that lies in a plane already is seen from above. Of others, ways on the sheet from neighbour to neighbour are embedded in the plane
    (Isomap; Tenenbaum, de Silva and Langford 2000), then made as long as the links between neighbours are (stress majorisation; Gansner,
    Koren and North 2004). Raises ValueError for points in pieces.
    """
    points = np.asarray(points, float)
    links, lengths, layered = neighbours(points, tracks)
    off = points - points.mean(0)
    _, spread, axes = np.linalg.svd(off, full_matrices=False)
    if spread[2] < PLANAR * spread[1] and not layered:
        return off @ axes[:2].T
    return _relaxed(_embedded(len(points), links, lengths), links, lengths)


def _embedded(count, links, lengths):
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    graph = coo_matrix((lengths, links.T), (count, count)).tocsr()
    way = dijkstra(graph, directed=False)
    if not np.isfinite(way).all():
        raise ValueError(f"the points of a sheet must hang together, {int((~np.isfinite(way[0])).sum())} of {count} are apart")
    squared = way**2
    centred = -(squared - squared.mean(0) - squared.mean(1)[:, None] + squared.mean()) / 2
    values, vectors = np.linalg.eigh(centred)
    return vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 0.0))


def _relaxed(flat, links, lengths):
    """``flat`` (N, 2) with its links as long as ``lengths``, in the sense of least squares of relative errors; ways keep it unfolded."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu

    a, b = links.T
    weight = 1 / np.maximum(lengths, 1e-6) ** 2
    count = len(flat)

    def laplacian(w):
        rows, columns = np.concatenate([a, b, a, b]), np.concatenate([b, a, a, b])
        return coo_matrix((np.concatenate([-w, -w, w, w]), (rows, columns)), (count, count)).tocsc()

    held = 1e-6 * weight.mean()  # the whole may not drift
    solve = splu(laplacian(weight) + coo_matrix((np.full(count, held), (np.arange(count),) * 2)).tocsc())
    for _ in range(ROUNDS):
        now = np.maximum(np.linalg.norm(flat[a] - flat[b], axis=1), 1e-9)
        flat = solve.solve(laplacian(weight * lengths / now) @ flat + held * flat)
    return flat
