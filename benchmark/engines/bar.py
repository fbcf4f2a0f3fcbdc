"""A foam bar that is let go in our cells, in MuJoCo's flexes and in Newton's tetrahedra: each engine's own meshes and steps, one scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .comparison import FPS, FRAMES, Engine, Setting
from .rivals import mujoco_runs, newton_runs

__all__ = ["Bar", "Cells", "Flex", "Tetrahedra", "engines"]

GRAVITY = 9.8
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

    def stiffer(self, factor: float) -> Bar:
        return replace(self, young=self.young * factor)


class Cells(Engine):
    """``neo_hookean`` and ``kelvin_voigt`` on an embedded grid, float32; explicit, damping in rounds."""

    is_ours = True
    name = "cells"
    meshes = ((4, 1, 1), (8, 1, 1), (4, 1, 2), (6, 1, 2), (8, 1, 2), (8, 2, 2), (12, 2, 2))
    finest = Setting((16, 4, 3), 70)

    def __init__(self, device: str = "cpu", workers: int | None = None):
        self.device, self.workers = device, workers

    def settings(self, body, mesh):
        from ...physics.stability import stable_step

        least = 1 / FPS / stable_step(self._system(body, mesh))
        return [Setting(tuple(mesh), int(np.ceil(factor * least))) for factor in (1.5, 1.25, 1.1)]

    def steps(self, bodies, setting):
        """An explicit step is as short as the stiffest bar asks."""
        if len(bodies) == 1:
            return setting
        stiffest = max(b.young for b in bodies) / float(np.median([b.young for b in bodies]))
        return replace(setting, substeps=int(np.ceil(setting.substeps * stiffest**0.5)))

    def ready(self, bodies, setting):
        from ...physics.batch import Batch

        systems = [self._system(bar, setting.mesh) for bar in bodies]
        batch = Batch(systems, fps=FPS, substeps=setting.substeps, device=self.device, workers=self.workers)
        grid = systems[0].grid
        assert grid is not None
        nodes, weights = grid.locate(bodies[0].points)

        def run():
            positions = batch.rollout(FRAMES).positions
            found = np.stack([p.cpu().numpy()[:, nodes].astype(float) for p in positions])
            return np.einsum("pk,btpki->btpi", weights, found)

        return run

    def _system(self, bar, mesh):
        from ...physics.grids import embed
        from ...physics.system import System
        from ...physics.terms import Gravity, KelvinVoigt, NeoHookean

        counts = [n * max(least, -(-12 // n)) for n, least in zip(mesh, SAMPLES, strict=True)]
        along = [(np.arange(n) + 0.5) * s / n for n, s in zip(counts, bar.size, strict=True)]
        corner = np.array([0, -bar.size[1] / 2, -bar.size[2] / 2])
        samples = corner + np.stack(np.meshgrid(*along, indexing="ij"), -1).reshape(-1, 3)
        volume, size = float(np.prod(bar.size)), np.array(bar.size) / mesh
        # samples stand for boxes, where the grid takes them for cubes: moved to where its faces are the bar's
        low = samples.min(0) - (volume / len(samples)) ** (1 / 3) / 2
        grid = embed(samples, volume, size, axes=np.eye(3), offset=(low - corner) / size)
        rest = grid.positions
        held = np.flatnonzero(rest[:, 0] < 1e-6)
        terms = [
            NeoHookean({"youngs_modulus": bar.young, "poisson": bar.poisson}),
            KelvinVoigt({"viscosity": bar.damping * bar.young, "viscous_poisson": bar.poisson}),
            Gravity({"gravity_z": -GRAVITY}),
        ]
        return System(
            positions=rest,
            masses=grid.masses(bar.density),
            springs=np.zeros((0, 2), int),
            stiffness=np.zeros(0),
            controllers=np.repeat(rest[held][None], FRAMES, 0),
            grips=held,
            terms=terms,
            grid=grid,
        )


class Flex(Engine):
    """MuJoCo's flex of cells with 27 nodes ("quadratic"), 8 ("trilinear") or of linear tetrahedra ("full"); St. Venant-Kirchhoff, implicit.

    ``effort`` is minus the decimal logarithm of the solver's tolerance.
    """

    finest = FINE

    def __init__(self, kind: str, meshes=(), *, threads: int = 2):
        self.name, self.kind, self.meshes, self.threads = f"flex, {kind}", kind, meshes, threads

    @property
    def judge(self):
        return self if self.kind == "quadratic" else Flex("quadratic")

    def settings(self, body, mesh):
        return [Setting(tuple(mesh), n, effort) for n in (16, 8, 4, 2) for effort in (8, 4)]

    def ready(self, bodies, setting):
        points, at = bodies[0].points, None

        def see(model, data):
            nonlocal at
            if at is None:  # at rest
                apart = ((data.flexvert_xpos[:, None] - points) ** 2).sum(-1)
                at = apart.argmin(0)
                if apart.min(0).max() > 1e-12:
                    raise ValueError(f"the mesh must have vertices at the points that are judged, got {setting.mesh}")
            return data.flexvert_xpos[at]

        return mujoco_runs([self._mjcf(bar, setting) for bar in bodies], setting, see, threads=self.threads)

    def _mjcf(self, bar, setting):
        mesh, full = np.array(setting.mesh), self.kind == "full"
        count = mesh + 1 if full else np.array([5, 2, 2])
        spacing, last = np.array(bar.size) / (count - 1), mesh * (2 if self.kind == "quadratic" else 1)
        cells = "" if full else f'cellcount="{mesh[0]} {mesh[1]} {mesh[2]}"'
        return f"""<mujoco>
  <option timestep="{1 / FPS / setting.substeps:.12g}" integrator="discrete" solver="CG" iterations="200"
    tolerance="{10.0**-setting.effort:g}" gravity="0 0 {-GRAVITY}"><flag contact="disable"/></option>
  <size memory="256M"/>
  <worldbody>
    <flexcomp name="bar" type="grid" dim="3" dof="{self.kind}" {cells} count="{count[0]} {count[1]} {count[2]}"
      spacing="{spacing[0]:.12g} {spacing[1]:.12g} {spacing[2]:.12g}" pos="{bar.size[0] / 2} 0 0"
      mass="{bar.density * np.prod(bar.size):.12g}" radius="0.0005">
      <elasticity young="{bar.young}" poisson="{bar.poisson}" damping="{bar.damping}"/>
      <contact selfcollide="none"/>
      <pin gridrange="0 0 0 0 {last[1]} {last[2]}"/>
    </flexcomp>
  </worldbody>
</mujoco>"""


class Tetrahedra(Engine):
    """Newton's linear tetrahedra (stable neo-Hookean, five a cell) by vertex block descent; ``effort`` is its iterations a step.

    A batch is one model with all bars beside each other; a frame's steps are one recorded graph.
    """

    name = "Newton, VBD"
    meshes = ((8, 2, 1), (16, 4, 2), (24, 6, 3))
    finest = Setting((32, 8, 4), 16, 40)

    def __init__(self, device: str = "cpu"):
        self.device = device

    def settings(self, body, mesh):
        return [Setting(tuple(mesh), n, effort) for n in (16, 8, 4) for effort in (40, 10)]

    def ready(self, bodies, setting):
        at = np.zeros(0)

        def see(places):
            nonlocal at
            rows = places.reshape(len(bodies), -1, 3) - np.arange(len(bodies))[:, None, None] * [0.0, 1.0, 0.0]
            if not len(at):  # at rest
                at = ((rows[0][:, None] - bodies[0].points) ** 2).sum(-1).argmin(0)
            return rows[:, at]

        def lay(newton, warp, builder, row):
            self._lay(builder, warp, bodies[row], setting.mesh, row)

        return newton_runs(lay, len(bodies), setting, self.device, (0.0, 0.0, -GRAVITY), "particle_q", see)

    def _lay(self, builder, warp, bar, mesh, row):
        first = len(builder.particle_q)
        size = np.array(bar.size) / mesh
        shear = bar.young / 2 / (1 + bar.poisson)
        lame = bar.young * bar.poisson / (1 + bar.poisson) / (1 - 2 * bar.poisson)
        builder.add_soft_grid(
            pos=warp.vec3(0.0, float(row - bar.size[1] / 2), float(-bar.size[2] / 2)),
            rot=warp.quat_identity(),
            vel=warp.vec3(0.0, 0.0, 0.0),
            **dict(zip(("dim_x", "dim_y", "dim_z"), mesh, strict=True)),
            **dict(zip(("cell_x", "cell_y", "cell_z"), size.tolist(), strict=True)),
            density=bar.density,
            k_mu=shear,
            k_lambda=lame,
            k_damp=bar.damping * bar.young,
            add_surface_mesh_edges=False,
        )
        # the builder gives every vertex a whole cell's mass: here a quarter of its tetrahedra's, and none (held) at the clamp
        place = np.array(builder.particle_q[first:], float)
        corners = np.array(builder.tet_indices, int).reshape(-1, 4)
        corners = corners[corners.min(1) >= first] - first
        edges = place[corners[:, 1:]] - place[corners[:, :1]]
        share = np.repeat(np.abs(np.linalg.det(edges)) / 24 * bar.density, 4)
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
