"""How far layers of a sheet and strands of a rope went into each other: what a simulation should not do, counted from positions alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .layer_items import BESIDE, edges_and_faces, side_by_side

__all__ = ["Penetrations", "nearest_edges", "nearest_face", "penetrations"]

DEEP = 0.5  # of the thickness: pairs that come nearer have gone into each other; what rests is pressed by far less


@dataclass(frozen=True)
class Penetrations:
    """Over the frames that were looked at.

    nearest  m, the least distance of two places of the body that are not side by side on it; infinite where none came near
    depth    m, the thickness less that, at least 0
    count    of pairs nearer than half the thickness, in the frame in which they are most
    pierced  of edges that run through triangles, in the frame in which they are most
    frame    in which layers are nearest, or -1
    """

    nearest: float
    depth: float
    count: int
    pierced: int
    frame: int

    def __str__(self):
        if not (self.count or self.pierced):
            return f"layers pressed {1e3 * self.depth:.1f} mm into each other at most, none passed"
        through = f", {self.pierced} edges through triangles" if self.pierced else ""
        return f"{self.count} penetrations of layers{through}, {1e3 * self.depth:.1f} mm deep in frame {self.frame}"


def penetrations(system, path, thickness: float) -> Penetrations:
    """Of a system's sheet and chains along ``path`` (T, M, 3) [m], where layers are ``thickness`` [m] apart. Frames that are not finite
    do not count."""
    found = Penetrations(np.inf, 0.0, 0, 0, -1)
    vertices, edges, faces = edges_and_faces(system)
    near = side_by_side(system, edges, BESIDE * thickness)
    known = (vertices[:, None], edges, faces)
    for k, x in enumerate(np.asarray(path, float)[:, : system.particle_count]):
        if not np.isfinite(x).all():
            continue
        far, pierced = _frame(known, near, x, thickness)
        least, count = far.min(initial=np.inf), int((far < DEEP * thickness).sum())
        if least < found.nearest:
            found = Penetrations(float(least), max(0.0, thickness - float(least)), found.count, found.pierced, k)
        found = Penetrations(found.nearest, found.depth, max(found.count, count), max(found.pierced, pierced), found.frame)
    return found


def _frame(known, near, x, thickness):
    """(distances of all pairs that are near (K,) m, number of edges through triangles)."""
    vertices, edges, faces = known
    found = []
    for a, b, measure in ((vertices, faces, nearest_face), (edges, edges, nearest_edges)):
        i, j = _close(a, b, near, x, thickness, same=b is edges)
        found.append(np.linalg.norm(np.einsum("ck,cki->ci", measure(x[a[i]], x[b[j]]), _four(x[a[i]], x[b[j]])), axis=1))
    i, j = _close(edges, faces, near, x, 0.0)
    return np.concatenate(found), int(_pierces(x[edges[i]], x[faces[j]]).sum())


def _four(first, second):
    return np.concatenate([first, second], 1)


def _close(a, b, near, x, reach, *, same=False):
    """Pairs (i, j) of items ``a`` and ``b`` whose balls are within ``reach``, and of which no two nodes are side by side."""
    from scipy.spatial import cKDTree

    nothing = np.zeros(0, int)
    if not (len(a) and len(b)):
        return nothing, nothing
    middles = [x[k].mean(1) for k in (a, b)]
    sizes = [np.linalg.norm(x[k] - m[:, None], axis=2).max() for k, m in zip((a, b), middles, strict=True)]
    one, other = (cKDTree(m) for m in middles)
    pairs = one.sparse_distance_matrix(other, sum(sizes) + reach + 1e-12, output_type="ndarray")
    i, j = pairs["i"], pairs["j"]
    keep = i < j if same else np.ones(len(i), bool)
    i, j = i[keep], j[keep]
    apart = np.ones(len(i), bool)
    for p in range(a.shape[1]):
        for q in range(b.shape[1]):
            apart &= np.asarray(near[a[i, p], b[j, q]]).ravel() == 0
    return i[apart], j[apart]


def nearest_face(p, triangle):
    """(C, 4) weights of vertices ``p`` (C, 1, 3) and of corners (C, 3, 3): 1, then minus those of the nearest place. As the kernels' own,
    but by trying the inside and every side in turn."""
    p, (a, b, c) = p[:, 0], np.moveaxis(triangle, 1, 0)
    edge = np.stack([b - a, c - a], 2)
    normal = np.linalg.pinv(edge) @ (p - a)[..., None]
    s, t = normal[:, 0, 0], normal[:, 1, 0]
    best, far = np.stack([1 - s - t, s, t], 1), np.full(len(p), np.inf)
    inside = (best >= 0).all(1)
    for first, second in ((0, 1), (0, 2), (1, 2)):
        way = triangle[:, second] - triangle[:, first]
        share = np.clip(((p - triangle[:, first]) * way).sum(1) / np.maximum((way**2).sum(1), 1e-18), 0, 1)
        away = np.linalg.norm(p - triangle[:, first] - share[:, None] * way, axis=1)
        weight = np.zeros((len(p), 3))
        weight[:, first], weight[:, second] = 1 - share, share
        better = ~inside & (away < far)
        best[better], far[better] = weight[better], away[better]
    return np.concatenate([np.ones((len(p), 1)), -best], 1)


def nearest_edges(one, two):
    """(C, 4) weights of the ends of edges ``one`` and ``two`` (C, 2, 3): by trying where the lines are nearest, and every end."""
    u, v, w = one[:, 1] - one[:, 0], two[:, 1] - two[:, 0], one[:, 0] - two[:, 0]
    uu, vv, uv = (np.maximum((a * b).sum(1), least) for a, b, least in ((u, u, 1e-18), (v, v, 1e-18), (u, v, -np.inf)))
    uw, vw = (u * w).sum(1), (v * w).sum(1)
    area = uu * vv - uv**2
    skew = area > 1e-12 * uu * vv
    s, t = ((a / np.where(skew, area, 1.0)) for a in (uv * vw - uw * vv, uu * vw - uv * uw))
    skew &= (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    tried = [(s, t, ~skew)]
    tried += [(np.full(len(u), end), np.clip((uv * end + vw) / vv, 0, 1), False) for end in (0.0, 1.0)]
    tried += [(np.clip((uv * end - uw) / uu, 0, 1), np.full(len(u), end), False) for end in (0.0, 1.0)]
    far = [np.where(bad, np.inf, np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1)) for s, t, bad in tried]
    which, rows = np.argmin(far, axis=0), np.arange(len(u))
    s, t = (np.stack([one[k] for one in tried])[which, rows] for k in (0, 1))
    return np.stack([1 - s, s, t - 1, -t], 1)


def _pierces(edge, triangle):
    """(C,) whether edges (C, 2, 3) run through triangles (C, 3, 3), corners and sides not counted."""
    p, q = edge[:, 0], edge[:, 1]

    def volume(a, b, c, d):
        return ((b - a) * np.cross(c - a, d - a)).sum(1)

    a, b, c = np.moveaxis(triangle, 1, 0)
    across = volume(a, b, c, p) * volume(a, b, c, q) < 0
    turns = [volume(p, q, first, second) for first, second in pairwise((a, b, c, a))]
    return across & ((np.stack(turns) > 0).all(0) | (np.stack(turns) < 0).all(0))
