"""The tetrahedra between points, and which of them a ball of a given radius reaches from outside."""

from __future__ import annotations

import numpy as np

__all__ = ["FACES", "Carving"]

WITHIN = 0.98  # share of the points that the inside must reach, in one piece; the rest may be errors of measurement
FACES = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]  # of a tetrahedron, each across from a corner
FLAT = 1e-3  # of the volume that edges of a tetrahedron would span at right angles


class Carving:
    """The tetrahedra of ``points`` and how wide the ways between them are."""

    def __init__(self, points):
        from scipy.spatial import Delaunay

        mesh = Delaunay(points)
        self.points, self.mesh, self.neighbours = points, mesh, mesh.neighbors
        corners = points[mesh.simplices]
        edges = corners[:, 1:] - corners[:, :1]
        bulk = np.abs(np.linalg.det(edges)) / np.linalg.norm(edges, axis=2).prod(1)
        self.flat, flat = bulk < FLAT, bulk < 1e-9
        edges[flat] = np.eye(3)
        centre = np.linalg.solve(edges, (edges**2).sum(-1, keepdims=True) / 2)[..., 0]
        self.spheres = np.where(flat, np.inf, np.linalg.norm(centre, axis=1))
        self.circles = np.stack([_circumradius(np.delete(corners, k, axis=1)) for k in range(4)], 1)  # across from corner k

    def kept(self, radius):
        """(all,) bool: the tetrahedra that a ball of ``radius`` does not reach."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        count = len(self.mesh.simplices)
        beyond = np.where(self.neighbours < 0, count, self.neighbours)  # one more node: what is outside of all
        open_ = np.append(self.spheres > radius, True)
        here = np.repeat(np.arange(count), 4)
        there, wide = beyond.ravel(), self.circles.ravel() > radius
        way = wide & open_[here] & open_[there]
        graph = coo_matrix((np.ones(way.sum()), (here[way], there[way])), (count + 1,) * 2)
        label = connected_components(graph, directed=False)[1]
        return self._peeled(label[:-1] != label[-1])

    def _peeled(self, kept):
        """``kept`` without flat tetrahedra that hang on by one side: they are nothing but skin, twice."""
        while True:
            joined = (np.append(kept, False)[self.neighbours]).sum(1)  # -1, the outside, is the last
            loose = kept & self.flat & (joined <= 1)
            if not loose.any():
                return kept
            kept = kept & ~loose

    def whole(self, radius):
        """Whether what is left is in one piece, joined by triangles, and reaches nearly all points."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        kept = self.mesh.simplices[self.kept(radius)]
        if not len(kept):
            return False
        faces = np.sort(kept[:, FACES].reshape(-1, 3), axis=1)
        _, face = np.unique(faces, axis=0, return_inverse=True)
        owner, face = np.repeat(np.arange(len(kept)), 4), face.ravel() + len(kept)
        graph = coo_matrix((np.ones(len(face)), (owner, face)), (face.max() + 1,) * 2)
        label = connected_components(graph, directed=False)[1][: len(kept)]
        largest = kept[label == np.bincount(label).argmax()]
        return len(np.unique(largest)) >= WITHIN * len(self.points)


def _circumradius(triangles):
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    twice = np.linalg.norm(np.cross(a, b), axis=1)
    product = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) * np.linalg.norm(a - b, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(twice > 0, product / (2 * twice), np.inf)
