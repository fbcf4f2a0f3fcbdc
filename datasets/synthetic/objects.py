"""Soft bodies as tetrahedral meshes: shape, material and texture. Rest axes: x along the body, z up, the origin under its middle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np

__all__ = ["Plush"]


@dataclass(frozen=True)
class Plush:
    """A stuffed bar, thick at the head (x < 0) and thin at the tail, with rounded edges.

    size       (length, width, height) of the box around it [m]
    cells      grid cells along each of them; six tetrahedra per cell
    taper      how much thinner the tail end is than the head end, 0 to 1
    rounding   how much thinner than between them the very ends are, 0 to 1
    roundness  of the cross-section: 0 is a box, 1 an ellipse
    density    [kg/m^3]
    young      Young's modulus [Pa]
    poisson    Poisson ratio
    damping    stiffness-proportional (Kelvin-Voigt) damping time [s]
    friction   Coulomb coefficient against the table
    """

    name: str = "plush"
    size: tuple[float, float, float] = (0.24, 0.06, 0.024)
    cells: tuple[int, int, int] = (12, 3, 2)
    taper: float = 0.35
    rounding: float = 0.35
    roundness: float = 0.6
    density: float = 100.0
    young: float = 1e4
    poisson: float = 0.3
    damping: float = 0.01
    friction: float = 0.5

    def __post_init__(self):
        for name in ("density", "young"):
            if not getattr(self, name) > 0:
                raise ValueError(f"plush {name} must be > 0, got {getattr(self, name)}")
        if len(self.size) != 3 or min(self.size) <= 0 or len(self.cells) != 3 or min(self.cells) < 1:
            raise ValueError(f"plush size and cells must be three positive numbers, got {self.size} and {self.cells}")
        if not 0 <= self.poisson < 0.5:
            raise ValueError(f"plush poisson must lie in [0, 0.5), got {self.poisson}")

    @cached_property
    def vertices(self) -> np.ndarray:
        """(V, 3) rest positions [m]; the lowest vertex is at z = 0."""
        axes = [np.linspace(-1, 1, n + 1) for n in self.cells]
        s, y, z = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
        scale = (1 - self.taper * (s + 1) / 2) * (1 - self.rounding * s**4)
        r = self.roundness / 2
        across, up = y * np.sqrt(1 - r * z**2), z * np.sqrt(1 - r * y**2)
        points = np.stack([s, scale * across, scale * up], axis=1) * np.array(self.size) / 2
        # The belly is flat enough to lie still: each section is lowered to the table by its own half height.
        points[:, 2] += scale * self.size[2] / 2
        return points

    @cached_property
    def tetrahedra(self) -> np.ndarray:
        """(E, 4) vertex indices, positively oriented: each grid cell is cut into six around its diagonal (Kuhn), which conforms."""
        nx, ny, nz = self.cells
        stride = np.array([(ny + 1) * (nz + 1), nz + 1, 1])
        corner = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij"), -1).reshape(-1, 3) @ stride
        tets = []
        for order in permutations(range(3)):
            walk = np.concatenate([[0], np.cumsum(stride[list(order)])])
            tets.append(corner[:, None] + walk)
        tets = np.stack(tets, axis=1).reshape(-1, 4)
        edges = self.vertices[tets[:, 1:]] - self.vertices[tets[:, :1]]
        flipped = np.linalg.det(edges) < 0
        tets[flipped] = tets[flipped][:, [0, 2, 1, 3]]
        return tets

    @cached_property
    def faces(self) -> np.ndarray:
        """(F, 3) triangles of the skin, normals outward: the faces that belong to one tetrahedron only."""
        outward = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
        triangles = self.tetrahedra[:, outward].reshape(-1, 3)
        _, index, count = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True, return_counts=True)
        return triangles[np.sort(index[count == 1])]

    @property
    def mass(self) -> float:
        """[kg]"""
        edges = self.vertices[self.tetrahedra[:, 1:]] - self.vertices[self.tetrahedra[:, :1]]
        return float(self.density * np.linalg.det(edges).sum() / 6)

    def albedo(self, rest: np.ndarray) -> np.ndarray:
        """RGB (..., 3) in [0, 1] of the material at rest positions (..., 3): patches on a gradient, so that colour tells where."""
        s = np.asarray(rest) / np.array(self.size)
        patch = np.floor(s[..., 0] * 10) + np.floor(s[..., 1] * 2) + np.floor(s[..., 2] * 2)
        along = np.clip(s[..., :1] + 0.5, 0, 1)
        base = (1 - along) * np.array([0.85, 0.35, 0.2]) + along * np.array([0.25, 0.45, 0.85])
        return np.where((patch % 2 == 0)[..., None], base, 0.55 * base + 0.4)
