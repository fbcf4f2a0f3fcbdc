"""What elements and creases remember: plastic flow, creep, relaxing and rubbing branches, as changes of the shapes in which they rest.

An element's gradient splits into an elastic part and one that has flowed, F = Fe Fp (Lee 1969); Fp moves by the exponential map in the
principal logarithmic strains (Simo 1992), so that flow of the shear keeps the volume. Newton is told of elements that rest in Fp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Bends", "Elements", "Layer"]


@dataclass
class Layer:
    """Elements or creases that lie over each other: ``ratio`` times as stiff as the body.

    tau      time constant with which their stress flows away [s]
    limit    strain, or angle (K,) of creases [rad], at which they give way
    whole    whether volume flows as shear does
    resting  (K, d, d) inverse of what has flowed, or (K,) angles of creases
    """

    ratio: float
    tau: float
    limit: float | np.ndarray
    whole: bool
    resting: np.ndarray

    @property
    def flows(self) -> bool:
        return bool(np.isfinite(self.tau) or np.isfinite(self.limit).any())


class Elements:
    """Triangles or tetrahedra over ``nodes`` (K, n) with ``layers``, of which the first is the body itself.

    poses   (K, d, d) inverses of the rest edges, in axes of the element
    volume  (K,) area of a triangle [m^2] or volume of a tetrahedron [m^3]
    shear, lame, damping  Lame's constants [Pa] and viscosity [Pa s], of a sheet times its thickness
    """

    def __init__(self, body, poses: np.ndarray):
        self.nodes, self.poses, self.volume, self.dim = body.elements, poses, body.measure, body.dim
        thick, nu = (body.thickness, body.poisson) if body.dim == 2 else (1.0, body.poisson)
        self.shear = thick * body.young / 2 / (1 + nu)
        self.lame = thick * body.young * nu / (1 + nu) / ((1 - nu) if body.dim == 2 else (1 - 2 * nu))  # of a sheet in plane stress
        # Newton damps every rate of C = F'F alike. Stretch along one axis, sideways free, is damped as its stiffness asks:
        # 2 c (1 + k nu^2) = tau (1 + nu) mu with k = 1 in a sheet, 2 in a solid.
        self.damping = body.damping * self.shear / 2 * (1 + nu) / (1 + (body.dim - 1) * nu**2)
        rest = self.gradient(body.vertices)
        self.fibre = np.einsum("kid,i->kd", rest, np.array(body.fibre) * thick)  # axis times modulus
        self.layers = []
        self.add(1.0, limit=body.yields[0] or np.inf, whole=False)

    def add(self, ratio: float, *, tau: float = np.inf, limit: float = np.inf, whole: bool = True) -> None:
        """A ``Layer`` over those that are there, at rest as laid down."""
        resting = np.broadcast_to(np.eye(self.dim), self.poses.shape).copy()
        self.layers.append(Layer(ratio, tau, limit, whole, resting))

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """(K, 3, d) deformation gradients at positions ``x`` (V, 3)."""
        return np.swapaxes(x[self.nodes[:, 1:]] - x[self.nodes[:, :1]], 1, 2) @ self.poses

    def strain(self, x: np.ndarray) -> np.ndarray:
        """(K, d, d) Green strains."""
        gradient = self.gradient(x)
        return (np.swapaxes(gradient, 1, 2) @ gradient - np.eye(self.dim)) / 2

    def flow(self, x: np.ndarray, dt: float) -> None:
        """Let all layers flow for ``dt`` at positions ``x``."""
        gradient = self.gradient(x)
        for layer in self.layers:
            if not layer.flows:
                continue
            elastic = gradient @ layer.resting
            squares, axes = np.linalg.eigh(np.swapaxes(elastic, 1, 2) @ elastic)
            strain = np.log(np.maximum(squares, 1e-6)) / 2
            part = strain if layer.whole else strain - strain.mean(axis=1, keepdims=True)
            kept = part * np.exp(-dt / layer.tau)
            size = np.sqrt(1.5) * np.linalg.norm(kept, axis=1, keepdims=True)
            kept = kept * np.minimum(1, layer.limit / np.maximum(size, 1e-30))
            layer.resting = layer.resting @ (axes * np.exp(kept - part)[:, None]) @ np.swapaxes(axes, 1, 2)

    def drawn(self, x: np.ndarray) -> np.ndarray:
        """(V, 3) forces [N] of the fibres: of the energy modulus / 2 times the squared Green strain along them."""
        modulus = np.linalg.norm(self.fibre, axis=1)
        axis = self.fibre / np.maximum(modulus, 1e-30)[:, None]
        along = np.einsum("kid,kd->ki", self.gradient(x), axis)
        size = modulus * (np.square(along).sum(axis=1) - 1) / 2
        return self.spread(size[:, None, None] * along[:, :, None] * axis[:, None], len(x))

    def pull(self, x: np.ndarray, before: np.ndarray, dt: float, scale: np.ndarray) -> np.ndarray:
        """(V, 3) forces [N] of all layers, ``scale`` (K,) times as stiff, at the end of a step from ``before`` to ``x``."""
        gradient, shear, lame = self.gradient(x), self.shear, self.lame + self.shear
        rate = 2 * (self.strain(x) - self.strain(before)) / dt
        total = self.spread(scale[:, None, None] * 2 * self.damping * gradient @ rate, len(x))
        for layer in self.layers:
            elastic = gradient @ layer.resting
            square = np.swapaxes(elastic, 1, 2) @ elastic
            area = np.sqrt(np.linalg.det(square))[:, None, None]
            stress = shear * elastic + lame * (area - 1 - shear / lame) * area * elastic @ np.linalg.inv(square)
            total += self.spread(layer.ratio * scale[:, None, None] * stress @ np.swapaxes(layer.resting, 1, 2), len(x))
        return total

    def spread(self, stress: np.ndarray, count: int) -> np.ndarray:
        """(V, 3) forces on ``count`` vertices of first Piola-Kirchhoff stresses (K, 3, d)."""
        ends = -(self.volume[:, None, None] * stress @ np.swapaxes(self.poses, 1, 2)).swapaxes(1, 2)  # (K, n - 1, 3)
        total = np.zeros((count, 3))
        np.add.at(total, self.nodes[:, 1:], ends)
        np.add.at(total, self.nodes[:, 0], -ends.sum(axis=1))
        return total


class Bends:
    """Creases of a cloth (``finite.shells.Creases`` says which and how stiff) with layers like those of the elements."""

    def __init__(self, body, creases):
        self.creases, self.damping = creases, creases.damping
        a, b = body.vertices[creases.nodes[:, :2]].swapaxes(0, 1)
        self.length = np.linalg.norm(b - a, axis=1)
        self.layers = []
        self.add(1.0, limit=body.yields[1] or np.inf)

    def add(self, ratio: float, *, tau: float = np.inf, limit: float = np.inf) -> None:
        """A ``Layer``; ``limit`` is a strain of the surface."""
        self.layers.append(Layer(ratio, tau, limit * self.creases.per_strain, True, self.creases.before.copy()))

    def flow(self, x: np.ndarray, dt: float) -> None:
        if not any(layer.flows for layer in self.layers):
            return
        angle = self.creases.angle(x)[0]
        for layer in self.layers:
            kept = np.clip(_near(angle - layer.resting) * np.exp(-dt / layer.tau), -layer.limit, layer.limit)
            layer.resting = angle - kept

    def pull(self, x: np.ndarray, before: np.ndarray, dt: float, scale: np.ndarray) -> np.ndarray:
        """(V, 3) forces [N] at the end of a step, as those of ``Elements``."""
        angle, slopes = self.creases.angle(x)
        bent = self.damping * _near(angle - self.creases.angle(before)[0]) / dt
        bent = bent + sum(layer.ratio * _near(angle - layer.resting) for layer in self.layers)
        total = np.zeros_like(x)
        np.add.at(total, self.creases.nodes, -(scale * self.creases.stiffness * bent)[:, None, None] * slopes)
        return total


def _near(angle):
    """The same angle between -pi and pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
