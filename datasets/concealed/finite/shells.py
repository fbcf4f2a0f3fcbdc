"""The bending of a sheet: discrete shells (Grinspun, Hirani, Desbrun, Schroeder, SCA 2003), a moment at every edge of two triangles."""

from __future__ import annotations

import numpy as np

__all__ = ["Creases"]


class Creases:
    """Edges that resist their angle: energy D / 2 |e|^2 / A (angle - rest)^2, for an edge e between triangles of area A together.

    On a mesh of squares, bent along its lines, that is a plate of flexural rigidity D = E t^3 / 12 / (1 - nu^2).

    nodes  (K, 4): the edge's ends, then the two corners across
    sides  (K, 2): the triangles
    """

    def __init__(self, body):
        self.sides, self.edges = _edges(body.elements)
        self.nodes = self.edges
        x = body.vertices
        length = np.linalg.norm(x[self.nodes[:, 1]] - x[self.nodes[:, 0]], axis=1)
        area = body.measure[self.sides].sum(axis=1)
        plate = body.young * body.thickness**3 / 12 / (1 - body.poisson**2) * body.bending
        self.stiffness, self.areas = plate * length**2 / area, body.measure[self.sides]
        if body.stiffness is not None:
            self.stiffness = self.stiffness * body.stiffness[self.sides].mean(axis=1)
        self.scale = np.ones(len(length))
        self.damping = body.damping + body.crease
        self.per_strain = 2 / body.thickness * area / length  # angle at which the surface has a strain of one
        self.limit = (body.yields[1] or np.inf) * self.per_strain
        self.tau, self.branches = np.inf, []
        self.rest = self.before = self.angle(x)[0]

    def clamp(self, held: np.ndarray) -> None:
        """Triangles with all corners in ``held`` (V,) do not bend: of an edge at which they end, only the other triangle does."""
        firm = np.stack([held[self.nodes[:, [0, 1, k]]].all(axis=1) for k in (2, 3)], axis=1)
        bends = np.where(firm.all(axis=1), self.areas.sum(axis=1), (self.areas * ~firm).sum(axis=1))
        self.scale = self.areas.sum(axis=1) / bends

    def branch(self, ratio: float, *, tau: float = np.inf, limit: float = np.inf) -> None:
        """As that of the elements; ``limit`` is a strain of the surface."""
        self.branches.append([ratio, tau, limit * self.per_strain, self.before])

    def angle(self, x):
        """(K,) angles [rad] between the two sides, 0 where flat, and (K, 4, 3) their derivatives by the corners [1/m]."""
        a, b, c, d = np.moveaxis(x[self.edges], 1, 0)
        edge = b - a
        length = np.linalg.norm(edge, axis=1, keepdims=True)
        along = edge / length
        one, other = np.cross(edge, c - a), np.cross(d - a, edge)
        angle = np.arctan2(_dot(np.cross(one, other), along)[:, 0], _dot(one, other)[:, 0])
        one, other = one / _dot(one, one), other / _dot(other, other)
        slopes = [
            -_dot(c - b, along) * one - _dot(d - b, along) * other,
            _dot(c - a, along) * one + _dot(d - a, along) * other,
            -length * one,
            -length * other,
        ]
        return angle, np.stack(slopes, axis=1)

    def evaluate(self, x, dt, *, firm=False):
        """Forces (K, 4, 3) and stiffness blocks (K, 12, 12), always positive, at the end of a step of ``dt`` that leads to ``x``."""
        stiffness = self.stiffness * self.scale
        slopes, bent, more = self._bent(x, dt)
        moment = stiffness * bent
        flat = slopes.reshape(len(slopes), 12)
        return -moment[:, None, None] * slopes, (more * stiffness)[:, None, None] * flat[:, :, None] * flat[:, None, :]

    def pull(self, x, dt):
        """Forces (K, 4, 3) alone."""
        slopes, bent, _ = self._bent(x, dt)
        return -(self.stiffness * self.scale * bent)[:, None, None] * slopes

    def _bent(self, x, dt):
        """Slopes of the angles, what of the angles makes moments, and how that grows with them."""
        angle, slopes = self.angle(x)
        bent, more = _near(angle - self._flowed(angle, dt)) + self.damping / dt * _near(angle - self.before), 1 + self.damping / dt
        for ratio, tau, limit, memory in self.branches:
            bent = bent + ratio * _carried(angle, memory, tau, limit, dt)
            more = more + ratio
        return slopes, bent, more

    def commit(self, x, dt):
        angle = self.angle(x)[0]
        for branch in self.branches:
            _, tau, limit, memory = branch
            branch[3] = angle - _carried(angle, memory, tau, limit, dt)
        self.rest, self.before = self._flowed(angle, dt), angle

    def _flowed(self, angle, dt):
        return angle - _carried(angle, self.rest, self.tau, self.limit, dt)


def _carried(angle, memory, tau, limit, dt):
    """What is left of the angles from ``memory`` after a step of relaxing and giving way."""
    return np.clip(_near(angle - memory) / (1 + dt / tau), -limit, limit)


def _edges(triangles):
    """(K, 2) triangles on both sides of every inner edge, and (K, 4) its ends and the corners across."""
    sides = {}
    for index, triangle in enumerate(triangles):
        for i in range(3):
            a, b, c = np.roll(triangle, -i)
            sides.setdefault((min(a, b), max(a, b)), []).append((index, a, b, c))
    inner = [pair for pair in sides.values() if len(pair) == 2]
    return np.array([[p[0], q[0]] for p, q in inner]), np.array([[*p[1:], q[3]] for p, q in inner])


def _near(angle):
    """The same angle between -pi and pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _dot(a, b):
    return np.einsum("kd,kd->k", a, b)[:, None]
