"""Hexahedra with 27 nodes, which neither bend nor shear too stiffly: tensor products of quadratic polynomials, 27 Gauss points.

A cantilever of one layer of them sags as a beam does to a few percent, where a layer of linear tetrahedra sags a quarter of that
(Hughes, The Finite Element Method, section 3.7; Zienkiewicz and Taylor, volume 1, section 8). Positions of vertices on a curved
surface make the element curved, too (isoparametric).
"""

from __future__ import annotations

from functools import cache

import numpy as np

from .continuum import Continuum

__all__ = ["Hexahedra", "lumped"]


class Hexahedra(Continuum):
    """The neo-Hookean material of ``Continuum`` at the Gauss points of ``body.cells`` (C, 27).

    What that keeps for each element is here kept for each of the K = 27 C points: ``scale``, strains, and what remembers.
    nodes  (C, 27) vertices of every cell
    owner  (K,) the element of ``body.elements`` in which a point lies: that whose middle is nearest
    """

    def __init__(self, body):
        from scipy.spatial import cKDTree

        weights, volume, slopes = _measured(body.vertices[body.cells])
        places = (weights @ body.vertices[body.cells]).reshape(-1, 3)
        self.owner = cKDTree(body.vertices[body.elements].mean(axis=1)).query(places)[1]
        own = None if body.stiffness is None else body.stiffness[self.owner]
        self._prepare(body, slopes.reshape(-1, 27, 3), volume.ravel(), np.broadcast_to(np.eye(3), (volume.size, 3, 3)), own)
        self.nodes = body.cells

    def cut(self, elements) -> None:
        self.scale[np.isin(self.owner, elements)] = 0

    def gradient(self, x):
        cells = len(self.nodes)
        return (np.swapaxes(x[self.nodes], 1, 2)[:, None] @ self.slopes.reshape(cells, -1, 27, 3)).reshape(-1, 3, 3)

    def pull(self, x, dt):
        """Forces (C, 27, 3) alone at the end of a step of ``dt`` that leads to ``x``."""
        gradient, stress, _ = self._stressed(x, dt)
        return self._gathered(gradient, stress, self.volume * self.scale)

    def evaluate(self, x, dt, *, firm=False):
        """Forces (C, 27, 3) and stiffness blocks (C, 81, 81), as of ``Continuum``."""
        cells, weight = len(self.nodes), self.volume * self.scale
        gradient, stress, tangent = self._stressed(x, dt)
        pull = self._gathered(gradient, stress, weight)
        rows = self._rows(gradient)
        stiff = weight[:, None, None] * tangent @ rows
        blocks = np.swapaxes(rows.reshape(cells, -1, 81), 1, 2) @ stiff.reshape(cells, -1, 81)
        if firm:
            values, axes = np.linalg.eigh(stress)
            stress = (axes * np.maximum(values, 0)[:, None]) @ np.swapaxes(axes, 1, 2)
        side = self._side(self.slopes)
        turning = side @ np.swapaxes(self._side(self.slopes @ (weight[:, None, None] * stress)), 1, 2)
        view = blocks.reshape(-1, 27, 3, 27, 3)
        for axis in range(3):
            view[:, :, axis, :, axis] += turning
        return pull, blocks

    def _gathered(self, gradient, stress, weight):
        """(C, 27, 3) minus the sum over the points of slopes times weight times the first Piola-Kirchhoff stress."""
        piola = weight[:, None, None] * stress @ np.swapaxes(gradient, 1, 2)
        return -self._side(self.slopes) @ piola.reshape(len(self.nodes), -1, 3)

    def _side(self, at_points):
        """(C, 27, 3 * 27) of values (K, 27, 3) at points: those of a cell's points side by side."""
        cells = len(self.nodes)
        return at_points.reshape(cells, -1, 27, 3).swapaxes(1, 2).reshape(cells, 27, -1)


def lumped(corners: np.ndarray) -> np.ndarray:
    """(C, 27) share of the volume [m^3] that belongs to every node of cells with nodes at ``corners`` (C, 27, 3): the integral of its
    shape function. The shares are those of Simpson's rule, all positive, unlike those of other quadratic elements.
    """
    values, volume, _ = _measured(corners)
    return volume @ values


def _measured(corners):
    """Shape functions (P, 27) at the Gauss points; volumes (C, P) and slopes in space (C, P, 27, 3) of cells (C, 27, 3)."""
    values, local, weights = _points()
    jacobian = np.swapaxes(corners, 1, 2)[:, None] @ local  # (C, P, 3, 3): place by local axis
    size = np.linalg.det(jacobian)
    if not size.min() > 0:
        raise ValueError(f"cells must have a positive volume at every Gauss point, the least is {size.min():.3g} of a unit cube's eighth")
    return values, size * weights, local @ np.linalg.inv(jacobian)


@cache
def _points():
    """Of 3 x 3 x 3 Gauss points in [-1, 1]^3: shape functions (27, 27), their slopes (27, 27, 3), weights (27,)."""
    at, weight = np.polynomial.legendre.leggauss(3)
    value = np.stack([at * (at - 1) / 2, 1 - at**2, at * (at + 1) / 2], axis=1)  # (points, nodes) along an axis
    slope = np.stack([at - 0.5, -2 * at, at + 0.5], axis=1)

    def product(a, b, c):
        return np.einsum("pi,qj,rk->pqrijk", a, b, c).reshape(27, 27)

    slopes = np.stack([product(slope, value, value), product(value, slope, value), product(value, value, slope)], axis=2)
    return product(value, value, value), slopes, np.einsum("p,q,r->pqr", weight, weight, weight).ravel()
