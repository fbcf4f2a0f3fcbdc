"""A foam bar that is let go in our cells, in MuJoCo's flexes and in Newton's tetrahedra: each engine's own meshes and steps, one scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .comparison import FRAMES, Engine, Setting
from .ours import Ours
from .rivals import Mujoco, Newton, implicit

__all__ = ["Bar", "Cells", "Flex", "Tetrahedra", "engines"]

GRAVITY = (0.0, 0.0, -9.8)  # m/s^2
SAMPLES = (2, 4, 4)  # least samples of the material along a cell's edges from which its integration points follow, by axis
FINE = Setting((6, 1, 1), 64, 8)  # of quadratic flexes: the trilinear and full ones lock, so that their refined self is the quadratic one


@dataclass(frozen=True)
class Bar:
    """Straight and at rest at first, clamped at x = 0, bent by gravity along -z.

    size [m], young [Pa], density [kg/m^3], damping: Kelvin-Voigt's time [s]. Points are judged at four stations on its four long edges.
    """

    size: tuple[float, float, float] = (0.2, 0.06, 0.026)
    young: float = 4e4
    poisson: float = 0.3
    density: float = 60.0
    damping: float = 0.01

    @property
    def points(self) -> np.ndarray:
        """(16, 3) m, at rest: corners of every mesh that has a multiple of four cells along the bar."""
        x, y, z = self.size
        return np.array([[x * k / 4, y * i / 2, z * j / 2] for k in range(1, 5) for i in (-1, 1) for j in (-1, 1)])

    @property
    def stiffness(self) -> float:
        return self.young

    def stiffer(self, factor: float) -> Bar:
        return replace(self, young=self.young * factor)


class Cells(Ours):
    """``neo_hookean`` and ``kelvin_voigt`` on an embedded grid, damping in rounds."""

    name = "cells"
    meshes = ((4, 1, 1), (8, 1, 1), (4, 1, 2), (6, 1, 2), (8, 1, 2), (8, 2, 2), (12, 2, 2))
    finest = Setting((16, 4, 3), 70)
    power = 0.5

    def watched(self, system, body):
        assert system.grid is not None
        return system.grid.locate(body.points)

    def system(self, body, mesh):
        from ...physics.grids import embed
        from ...physics.system import System
        from ...physics.terms import Gravity, KelvinVoigt, NeoHookean

        counts = [n * max(least, -(-12 // n)) for n, least in zip(mesh, SAMPLES, strict=True)]
        along = [(np.arange(n) + 0.5) * s / n for n, s in zip(counts, body.size, strict=True)]
        corner = np.array([0, -body.size[1] / 2, -body.size[2] / 2])
        samples = corner + np.stack(np.meshgrid(*along, indexing="ij"), -1).reshape(-1, 3)
        volume, size = float(np.prod(body.size)), np.array(body.size) / mesh
        # samples stand for boxes, where the grid takes them for cubes: moved to where its faces are the bar's
        low = samples.min(0) - (volume / len(samples)) ** (1 / 3) / 2
        grid = embed(samples, volume, size, axes=np.eye(3), offset=(low - corner) / size)
        rest = grid.positions
        held = np.flatnonzero(rest[:, 0] < 1e-6)
        terms = [
            NeoHookean({"youngs_modulus": body.young, "poisson": body.poisson}),
            KelvinVoigt({"viscosity": body.damping * body.young, "viscous_poisson": body.poisson}),
            Gravity({"gravity_z": GRAVITY[2]}),
        ]
        return System(
            positions=rest,
            masses=grid.masses(body.density),
            springs=np.zeros((0, 2), int),
            stiffness=np.zeros(0),
            controllers=np.repeat(rest[held][None], FRAMES, 0),
            grips=held,
            terms=terms,
            grid=grid,
        )


class Flex(Mujoco):
    """MuJoCo's flex of cells with 27 nodes ("quadratic"), 8 ("trilinear") or of linear tetrahedra ("full"); St. Venant-Kirchhoff."""

    finest = FINE
    substeps = (16, 8, 4, 2)

    def __init__(self, kind: str, meshes=(), *, threads: int = 2):
        super().__init__(threads=threads)
        self.name, self.kind, self.meshes = f"flex, {kind}", kind, meshes

    @property
    def judge(self):
        return self if self.kind == "quadratic" else Flex("quadratic")

    def watched(self, places, body, setting):
        apart = ((places[:, None] - body.points) ** 2).sum(-1)
        if apart.min(0).max() > 1e-12:
            raise ValueError(f"the mesh must have vertices at the points that are judged, got {setting.mesh}")
        return apart.argmin(0)

    def document(self, body, setting):
        mesh, full = np.array(setting.mesh), self.kind == "full"
        count = mesh + 1 if full else np.array([5, 2, 2])
        spacing, last = np.array(body.size) / (count - 1), mesh * (2 if self.kind == "quadratic" else 1)
        cells = "" if full else f'cellcount="{mesh[0]} {mesh[1]} {mesh[2]}"'
        return f"""<mujoco>
  {implicit(setting, GRAVITY)}
  <worldbody>
    <flexcomp name="bar" type="grid" dim="3" dof="{self.kind}" {cells} count="{count[0]} {count[1]} {count[2]}"
      spacing="{spacing[0]:.12g} {spacing[1]:.12g} {spacing[2]:.12g}" pos="{body.size[0] / 2} 0 0"
      mass="{body.density * np.prod(body.size):.12g}" radius="0.0005">
      <elasticity young="{body.young}" poisson="{body.poisson}" damping="{body.damping}"/>
      <contact selfcollide="none"/>
      <pin gridrange="0 0 0 0 {last[1]} {last[2]}"/>
    </flexcomp>
  </worldbody>
</mujoco>"""


class Tetrahedra(Newton):
    """Newton's linear tetrahedra (stable neo-Hookean, five a cell)."""

    meshes = ((8, 2, 1), (16, 4, 2), (24, 6, 3))
    finest = Setting((32, 8, 4), 16, 40)
    substeps = (16, 8, 4)
    efforts = (40, 10)
    gravity = GRAVITY

    def watched(self, places, body):
        return ((places[:, None] - body.points) ** 2).sum(-1).argmin(0)

    def lay(self, newton, warp, builder, body, mesh, aside):
        first = len(builder.particle_q)
        size = np.array(body.size) / mesh
        shear = body.young / 2 / (1 + body.poisson)
        lame = body.young * body.poisson / (1 + body.poisson) / (1 - 2 * body.poisson)
        builder.add_soft_grid(
            pos=warp.vec3(0.0, float(aside - body.size[1] / 2), float(-body.size[2] / 2)),
            rot=warp.quat_identity(),
            vel=warp.vec3(0.0, 0.0, 0.0),
            **dict(zip(("dim_x", "dim_y", "dim_z"), mesh, strict=True)),
            **dict(zip(("cell_x", "cell_y", "cell_z"), size.tolist(), strict=True)),
            density=body.density,
            k_mu=shear,
            k_lambda=lame,
            k_damp=body.damping * body.young,
            add_surface_mesh_edges=False,
        )
        # the builder gives every vertex a whole cell's mass: here a quarter of its tetrahedra's, and none (held) at the clamp
        place = np.array(builder.particle_q[first:], float)
        corners = np.array(builder.tet_indices, int).reshape(-1, 4)
        corners = corners[corners.min(1) >= first] - first
        edges = place[corners[:, 1:]] - place[corners[:, :1]]
        share = np.repeat(np.abs(np.linalg.det(edges)) / 24 * body.density, 4)
        masses = np.where(place[:, 0] < 1e-6, 0.0, np.bincount(corners.ravel(), share, len(place)))
        builder.particle_mass[first:] = masses.tolist()


def engines(cuda: bool) -> list[Engine]:
    """All that are compared on a device."""
    if cuda:
        return [Cells("cuda"), Tetrahedra("cuda")]
    return [
        Cells(),
        Flex("quadratic", ((2, 1, 1), (3, 1, 1), (4, 1, 1))),
        Flex("trilinear", ((8, 2, 1), (16, 4, 2))),
        Flex("full", ((8, 2, 1), (16, 4, 2))),
    ]
