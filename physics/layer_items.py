"""What of a system may meet itself: vertices, edges and triangles of its sheet and chains, in groups of neighbours, for the search."""

from __future__ import annotations

import numpy as np

from .packing import bisect

__all__ = ["BESIDE", "assemble_layers", "edges_and_faces", "side_by_side"]

GROUP = 24  # edges or triangles that are looked at as one first
BESIDE = 1.5  # thicknesses along the body: a strand that turns back within so much would be bent by 171 degrees


def edges_and_faces(system) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(vertices (V,), edges (E, 2), triangles (F, 3)) of a system's sheet and chains, as its nodes; hands that are nodes are none."""
    count = system.particle_count
    faces = np.zeros((0, 3), int) if system.sheet is None else system.sheet.triangles
    sides = [faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]
    grips = np.append(np.arange(count), np.where(system.grips < 0, count, system.grips))
    walks = [np.stack([grips[c[:-1]], grips[c[1:]]], 1) for c in system.chains]
    edges = np.sort(np.concatenate([np.zeros((0, 2), int), *sides, *walks]), axis=1)
    edges = np.unique(edges[edges[:, 1] < count], axis=0)
    return np.unique(edges), edges, faces


def side_by_side(system, edges, reach: float):
    """Sparse (M, M) matrix with an entry for every two particles, or one twice, that are at most ``reach`` [m] apart along ``edges``."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    count = system.particle_count
    length = np.maximum(np.linalg.norm(np.diff(system.positions[edges], axis=1)[:, 0], axis=1), 1e-9)
    graph = coo_matrix((length, edges.T), (count, count)).tocsr()
    if not (length <= reach).any():
        return coo_matrix((np.ones(count), (np.arange(count),) * 2)).tocsr()
    return coo_matrix(np.isfinite(dijkstra(graph, directed=False, limit=reach))).tocsr()


def assemble_layers(systems, starts, wanted: bool) -> dict[str, np.ndarray]:
    """Constants of the search: every system's edges, then its vertices, then its triangles, neighbours in groups. Nothing where it is not
    ``wanted``."""
    items, first, kin, groups = [], [], [], []
    kin_row: list = [[0]]
    begun = known = 0
    for system, start in zip(systems, starts, strict=False):
        vertices, edges, faces = edges_and_faces(system) if wanted else (np.zeros((0, n), int) for n in (1, 2, 3))
        vertices, edges = vertices.reshape(-1, 1), edges.reshape(-1, 2)
        row = [begun, len(groups)]
        for own, all_three in ((edges, [0, 1, 1]), (vertices, [0, 0, 0]), (faces, [0, 1, 2])):
            parts = bisect(system.positions[own].mean(1), np.ones(len(own)), max(1, -(-len(own) // GROUP)))
            items += [own[part][:, all_three] + start for part in parts]
            sizes = np.array([len(part) for part in parts if len(part)], int)
            groups += [(begun + end - size, begun + end) for size, end in zip(sizes, np.cumsum(sizes), strict=True)]
            begun += len(own)
            row += [begun, len(groups)]
        first.append(row)
        if wanted:
            thick = next(t for t in system.terms if t.stage == "layer").values
            near = side_by_side(system, edges, BESIDE * next(iter(thick.values())))
            alone = int((system.grips < 0).sum())
            kin_row.append(np.append(near.indptr[1:], np.full(alone, near.nnz)) + known)
            kin.append(near.indices + start)
            known += near.nnz
    joined = np.concatenate([np.zeros((0, 3), int), *items])
    return dict(
        layer_item=joined,
        layer_first=np.array(first),
        layer_group=np.array(groups, int).reshape(-1, 2),
        layer_system=np.repeat(np.arange(len(systems)), [f[-2] - f[0] for f in first]),
        kin_row=np.concatenate(kin_row),
        kin=np.concatenate([np.zeros(0, int), *kin]),
    )
