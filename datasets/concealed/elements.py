"""The elastic elements of a flex as MuJoCo keeps them: a St. Venant-Kirchhoff energy, quadratic in the squared lengths of the edges.

With elongations s_e = l_e^2 - L_e^2 an element's force on the first end of edge e is -(K s)_e (x_first - x_second).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Elements"]


@dataclass(frozen=True, eq=False)
class Elements:
    """Triangles or tetrahedra. ``ends`` (E, K, 2) vertices of their edges, ``rest`` (E, K) squared lengths, ``matrix`` (E, K, K)."""

    ends: np.ndarray
    rest: np.ndarray
    matrix: np.ndarray

    @classmethod
    def of(cls, model) -> Elements:
        """Those of the model's last flex: others over the same vertices come before it."""
        count = 3 if model.flex_dim[-1] == 2 else 6
        edges = model.flex_elemedge[-model.flex_elemnum[-1] * count :].reshape(-1, count) + model.flex_edgeadr[-1]
        upper = model.flex_stiffness[-_stored(model) * len(edges) :].reshape(len(edges), -1)
        matrix = np.zeros((len(edges), count, count))
        i, j = np.triu_indices(count)
        matrix[:, i, j] = matrix[:, j, i] = upper[:, : len(i)]
        return cls(model.flex_edge[edges], model.flexedge_length0[edges] ** 2, matrix)

    def store(self, model, factor: float | np.ndarray = 1.0) -> None:
        """Write ``matrix`` times ``factor`` (one, or one an element) into the model."""
        count = self.matrix.shape[1]
        i, j = np.triu_indices(count)
        view = model.flex_stiffness[-_stored(model) * len(self.matrix) :].reshape(len(self.matrix), -1)
        view[:, : len(i)] = np.reshape(factor, (-1, 1)) * self.matrix[:, i, j]

    def elongation(self, x: np.ndarray) -> np.ndarray:
        """(E, K) changes of the squared edge lengths at positions ``x`` (V, 3) [m^2]."""
        return np.square(x[self.ends[..., 0]] - x[self.ends[..., 1]]).sum(axis=-1) - self.rest

    def force(self, x: np.ndarray, elongation: np.ndarray) -> np.ndarray:
        """(V, 3) [N] of the elements on their vertices, were their elongation ``elongation``."""
        pull = np.einsum("eij,ej->ei", self.matrix, elongation)[..., None] * (x[self.ends[..., 0]] - x[self.ends[..., 1]])
        total = np.empty_like(x)
        first, second = self.ends[..., 0].ravel(), self.ends[..., 1].ravel()
        for axis in range(3):
            weights = pull[..., axis].ravel()
            total[:, axis] = np.bincount(second, weights, len(x)) - np.bincount(first, weights, len(x))
        return total

    def strain_rows(self, vertices: np.ndarray, axis) -> np.ndarray:
        """(E, K) rows that give the Green strain along unit ``axis`` from the elongations, at rest positions ``vertices`` (V, 3)."""
        edge = vertices[self.ends[..., 0]] - vertices[self.ends[..., 1]]
        flat = self.matrix.shape[1] == 3
        pairs = [(0, 0), (1, 1), (0, 1)] if flat else [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
        twice = [1 if i == j else 2 for i, j in pairs]
        # s_e = 2 e' G e for a constant Green strain G; solved for the entries of G.
        to_elongation = np.stack([2 * n * edge[..., i] * edge[..., j] for n, (i, j) in zip(twice, pairs, strict=True)], axis=-1)
        along = np.array([n * axis[i] * axis[j] for n, (i, j) in zip(twice, pairs, strict=True)])
        return np.einsum("k,ekj->ej", along, np.linalg.inv(to_elongation))


def _stored(model):
    """Numbers that MuJoCo keeps for an element, more than it needs."""
    return {2: 21, 3: 24}[int(model.flex_dim[-1])]
