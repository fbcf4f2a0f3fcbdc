"""Sheets and solids of linear finite elements: a compressible neo-Hookean material, in plane stress where it is a sheet.

W(C) = mu/2 (tr C - 3 - ln det C) + lambda/8 (ln det C)^2 in three dimensions; a sheet's thickness follows so that nothing presses on it.
What remembers (plastic flow, relaxing and rubbing branches) works on the Green strain E = (C - 1) / 2 and is integrated backward in time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Branch", "Continuum"]

PAIRS = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))}
FLATTEST = 1e-3  # least det C of an element; below it is as good as inside out


@dataclass
class Branch:
    """A spring and a damper or slider in series, beside the element: stress ``ratio`` C : (E - memory).

    tau  time constant of the damper [s]; limit  strain at which the slider gives way; memory  (K, d, d)
    """

    ratio: float
    tau: float
    limit: float
    memory: np.ndarray

    def carried(self, strain, dt):
        """Strain of the branch's spring at the end of a step in which the elements come to ``strain``."""
        return limited((strain - self.memory) / (1 + dt / self.tau), self.limit)


class Continuum:
    """The elements of a cloth or a stuffed body.

    nodes  (K, n) vertices of every element
    scale  (K,) factors of all of its stiffness, writable
    """

    def __init__(self, body):
        self.nodes = body.elements
        dim = body.dim
        edges = body.vertices[body.elements[:, 1:]] - body.vertices[body.elements[:, :1]]  # (K, dim, 3)
        basis = _basis(edges) if dim == 2 else np.broadcast_to(np.eye(3), (len(edges), 3, 3))  # (K, dim, 3)
        slopes = np.linalg.inv(edges @ np.swapaxes(basis, 1, 2))  # (K, dim, dim)
        slopes = np.concatenate([-slopes.sum(axis=2, keepdims=True), slopes], axis=2).swapaxes(1, 2)  # (K, n, dim)
        self._prepare(body, slopes, body.measure * (body.thickness if dim == 2 else 1), basis, body.stiffness)

    def _prepare(self, body, slopes, volume, basis, stiffness):
        """The material at K places with the ``slopes`` (K, n, dim) of the shape functions there, ``volume`` and ``stiffness`` (K,)."""
        self.dim, self.damping, self.slopes, self.volume = body.dim, body.damping, slopes, volume
        self.lame = body.young * body.poisson / (1 + body.poisson) / (1 - 2 * body.poisson)
        self.shear = body.young / 2 / (1 + body.poisson)
        self.scale = np.ones(len(volume)) if stiffness is None else stiffness.copy()
        self.fibre = basis @ np.array(body.fibre)  # (K, dim): axis times modulus
        self.modulus = float(np.linalg.norm(body.fibre))
        self.limit = body.yields[0] or np.inf
        self.tau = np.inf  # of the flow under any load [s]
        self.branches = []
        self.flow = np.zeros((len(volume), self.dim, self.dim))
        self.before = np.zeros_like(self.flow)
        self.hooke = self._tangent(np.broadcast_to(np.eye(self.dim), self.flow.shape), *self._thick(np.ones(len(volume))))

    def branch(self, ratio: float, *, tau: float = np.inf, limit: float = np.inf) -> None:
        """Put a ``Branch`` beside the elements, without stress at rest."""
        self.branches.append(Branch(ratio, tau, limit, np.zeros_like(self.flow)))

    def cut(self, elements) -> None:
        """``elements`` of the body carry nothing from now on."""
        self.scale[elements] = 0

    def gradient(self, x):
        """(K, 3, dim) deformation gradients."""
        return np.swapaxes(x[self.nodes], 1, 2) @ self.slopes

    def strain(self, x):
        """(K, dim, dim) Green strains at positions ``x`` (V, 3)."""
        gradient = self.gradient(x)
        return (np.swapaxes(gradient, 1, 2) @ gradient - np.eye(self.dim)) / 2

    def sound(self, x) -> bool:
        """Whether no element is inside out or flat."""
        if self.dim == 3:
            return bool((np.linalg.det(self.gradient(x)) > np.sqrt(FLATTEST)).all())
        return bool((np.linalg.det(2 * self.strain(x) + np.eye(2)) > FLATTEST).all())

    def evaluate(self, x, dt, *, firm=False):
        """Forces (K, n, 3) and stiffness blocks (K, 3 n, 3 n) at the end of a step of ``dt`` that leads to ``x``.

        Blocks are symmetric; ``firm`` ones positive, which those of compressed elements need not be.
        """
        gradient, stress, tangent = self._stressed(x, dt)
        weight = self.volume * self.scale
        pull = weight[:, None, None] * (self.slopes @ stress)  # (K, n, dim)
        rows = self._rows(gradient)
        blocks = np.swapaxes(rows, 1, 2) @ (weight[:, None, None] * tangent @ rows)
        if firm:
            values, axes = np.linalg.eigh(stress)
            stress = (axes * np.maximum(values, 0)[:, None]) @ np.swapaxes(axes, 1, 2)
        # the forces turn with the element
        turning = weight[:, None, None] * (self.slopes @ stress @ np.swapaxes(self.slopes, 1, 2))
        count = self.nodes.shape[1]
        view = blocks.reshape(-1, count, 3, count, 3)
        for axis in range(3):
            view[:, :, axis, :, axis] += turning
        return -pull @ np.swapaxes(gradient, 1, 2), blocks

    def pull(self, x, dt):
        """Forces (K, n, 3) alone at the end of a step of ``dt`` that leads to ``x``."""
        gradient, stress, _ = self._stressed(x, dt)
        return -(self.volume * self.scale)[:, None, None] * (self.slopes @ stress) @ np.swapaxes(gradient, 1, 2)

    def _stressed(self, x, dt):
        """Deformation gradients, second Piola-Kirchhoff stresses (K, dim, dim) and their tangents (K, M, M) at the end of a step."""
        gradient = self.gradient(x)
        strain = (np.swapaxes(gradient, 1, 2) @ gradient - np.eye(self.dim)) / 2
        elastic = strain - self._flowed(strain, dt)
        stress, tangent = self._elastic(elastic)
        rate, more = (strain - self.before) * self.damping / dt, self.damping / dt
        for branch in self.branches:
            rate = rate + branch.ratio * branch.carried(strain, dt)
            more = more + branch.ratio / (1 + dt / branch.tau)
        return gradient, stress + full(self.hooke @ voigt(rate)), tangent + more * self.hooke

    def commit(self, x, dt):
        """The step has led to ``x``: what remembers moves on."""
        strain = self.strain(x)
        self.flow = self._flowed(strain, dt)
        for branch in self.branches:
            branch.memory = strain - branch.carried(strain, dt)
        self.before = strain

    def _flowed(self, strain, dt):
        """Plastic strain after a step to ``strain``: shear flows, volume does not."""
        if np.isinf(self.limit) and np.isinf(self.tau):
            return self.flow
        trial = strain - self.flow
        shear = trial - np.trace(trial, axis1=1, axis2=2)[:, None, None] / self.dim * np.eye(self.dim)
        return self.flow + shear - limited(shear / (1 + dt / self.tau), self.limit)

    def _thick(self, area):
        """Squared area (K,) of a sheet over that at rest: as is, with the squared stretch across at which nothing presses on it."""
        if self.dim == 3:
            return area, None
        across = area ** (-self.lame / (self.lame + 2 * self.shear))
        for _ in range(12):  # Newton on lambda/2 ln(area c) + mu (c - 1) = 0, in ln c, from its linear solution
            error = self.lame / 2 * np.log(area * across) + self.shear * (across - 1)
            step = error / (self.lame / 2 + self.shear * across)
            across = across * np.exp(-step)
            if np.abs(step).max() < 1e-12:
                break
        return area, across

    def _elastic(self, strain):
        """Second Piola-Kirchhoff stress (K, dim, dim) and its tangent (K, M, M) in engineering strains."""
        square = np.eye(self.dim) + 2 * strain
        area, across = self._thick(np.maximum(np.linalg.det(square), FLATTEST))
        inverse = np.linalg.inv(square)
        pressure = self.shear - self.lame / 2 * np.log(area) if across is None else self.shear * across
        stress = self.shear * np.eye(self.dim) - pressure[:, None, None] * inverse
        tangent = self._tangent(inverse, area, across)
        if self.modulus:
            axis = self.fibre / self.modulus
            along = np.einsum("ki,kij,kj->k", axis, strain, axis)
            dyad = axis[:, :, None] * axis[:, None, :]
            stress = stress + self.modulus * along[:, None, None] * dyad
            row = np.stack([dyad[:, i, j] for i, j in PAIRS[self.dim]], axis=1)
            tangent = tangent + self.modulus * row[:, :, None] * row[:, None, :]
        return stress, tangent

    def _tangent(self, inverse, area, across):
        """(K, M, M) derivative of the stress by the engineering strain."""
        pressure = self.shear - self.lame / 2 * np.log(area) if across is None else self.shear * across
        bulk = self.lame if across is None else self.shear * self.lame / (self.lame / 2 / across + self.shear)
        pairs = PAIRS[self.dim]
        row = np.stack([inverse[:, i, j] for i, j in pairs], axis=1)
        mixed = [
            [inverse[:, i, k] * inverse[:, j, m] + inverse[:, i, m] * inverse[:, j, k] for k, m in pairs] for i, j in pairs
        ]  # twice the symmetric product
        spread = np.broadcast_to(bulk, len(row))[:, None, None] * row[:, :, None] * row[:, None, :]
        return spread + np.maximum(pressure, 0)[:, None, None] * np.moveaxis(np.array(mixed), 2, 0)

    def _rows(self, gradient):
        """(K, M, 3 n) engineering strain by positions."""
        rows = []
        for i, j in PAIRS[self.dim]:
            row = self.slopes[:, :, None, i] * gradient[:, None, :, j]
            rows.append(row if i == j else row + self.slopes[:, :, None, j] * gradient[:, None, :, i])
        return np.stack(rows, axis=1).reshape(len(gradient), len(rows), -1)


def limited(strain, limit):
    """Strains (K, d, d) cut to a size of ``limit``: sqrt(3/2) of the norm, of a volume-preserving stretch the stretch itself."""
    if np.isinf(limit):
        return strain
    size = np.sqrt(1.5) * np.linalg.norm(strain, axis=(1, 2))
    return strain * np.minimum(1, limit / np.maximum(size, 1e-30))[:, None, None]


def voigt(strain):
    """(K, M, 1) engineering strains of (K, d, d)."""
    pairs = PAIRS[strain.shape[1]]
    return np.stack([strain[:, i, j] * (1 if i == j else 2) for i, j in pairs], axis=1)[:, :, None]


def full(stress):
    """(K, d, d) of stresses (K, M, 1)."""
    dim = {3: 2, 6: 3}[stress.shape[1]]
    out = np.empty((len(stress), dim, dim))
    for row, (i, j) in enumerate(PAIRS[dim]):
        out[:, i, j] = out[:, j, i] = stress[:, row, 0]
    return out


def _basis(edges):
    """(K, 2, 3) an orthonormal basis of every triangle's plane, near the axes of the room where it lies flat."""
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    first = np.where(np.abs(normal[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = first - np.einsum("kd,kd->k", first, normal)[:, None] * normal
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first)], axis=1)
