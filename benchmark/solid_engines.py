"""A foam bar that is let go in our cells, in MuJoCo's flexes and in Newton's tetrahedra: each engine's own meshes and steps, one scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["FPS", "FRAMES", "Bar", "Cells", "Engine", "Flex", "Setting", "Tetrahedra"]

FPS, SECONDS = 60, 2.0
FRAMES = round(FPS * SECONDS) + 1
GRAVITY = 9.8
SAMPLES = (2, 4, 4)  # least samples of the material along a cell's edges from which its integration points follow, by axis


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


@dataclass(frozen=True)
class Setting:
    """mesh: cells along x, y and z. substeps a frame. How hard an implicit step is solved: ``effort``, by each engine's own measure."""

    mesh: tuple[int, int, int]
    substeps: int
    effort: float = 0.0

    def __str__(self):
        return f"{' x '.join(map(str, self.mesh))}, {self.substeps} a frame" + (f", {self.effort:g}" if self.effort else "")


Run = Callable[[], np.ndarray]


class Engine:
    """One way to simulate the bar. ``meshes`` from coarse to fine, ``finest`` its refined self."""

    name: str
    meshes: tuple[tuple[int, int, int], ...]
    finest: Setting

    def settings(self, bar: Bar, mesh) -> list[Setting]:
        """What is tried on a mesh, from the most accurate to the cheapest."""
        raise NotImplementedError

    def ready(self, bars: Sequence[Bar], setting: Setting) -> Run:
        """Everything that happens once is done; calling it simulates from the start: (B, FRAMES, 16, 3) m."""
        raise NotImplementedError


class Cells(Engine):
    """``neo_hookean`` and ``kelvin_voigt`` on an embedded grid, float32; explicit, damping in rounds."""

    name = "cells"
    meshes = ((4, 1, 1), (8, 1, 1), (4, 1, 2), (6, 1, 2), (8, 1, 2), (8, 2, 2), (12, 2, 2))
    finest = Setting((16, 4, 3), 70)

    def __init__(self, device: str = "cpu", workers: int | None = None):
        self.device, self.workers = device, workers

    def settings(self, bar, mesh):
        from ..physics.stability import stable_step

        least = 1 / FPS / stable_step(self._system(bar, mesh))
        return [Setting(tuple(mesh), int(np.ceil(factor * least))) for factor in (1.5, 1.25, 1.1)]

    def ready(self, bars, setting):
        from ..physics.batch import Batch

        systems = [self._system(bar, setting.mesh) for bar in bars]
        batch = Batch(systems, fps=FPS, substeps=setting.substeps, device=self.device, workers=self.workers)
        grid = systems[0].grid
        assert grid is not None
        nodes, weights = grid.locate(bars[0].points)

        def run():
            positions = batch.rollout(FRAMES).positions
            found = np.stack([p.cpu().numpy()[:, nodes].astype(float) for p in positions])
            return np.einsum("pk,btpki->btpi", weights, found)

        return run

    def _system(self, bar, mesh):
        from ..physics.grids import embed
        from ..physics.system import System
        from ..physics.terms import Gravity, KelvinVoigt, NeoHookean

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

    ``effort`` is minus the decimal logarithm of the solver's tolerance. A batch goes through MuJoCo's own ``rollout`` in threads.
    """

    def __init__(self, kind: str, meshes, finest: Setting, *, threads: int = 2):
        self.name, self.kind, self.meshes, self.finest, self.threads = f"flex, {kind}", kind, meshes, finest, threads

    def settings(self, bar, mesh):
        return [Setting(tuple(mesh), n, effort) for n in (16, 8, 4, 2) for effort in (8, 4)]

    def ready(self, bars, setting):
        from ..datasets.synthetic.simulate import imported

        mujoco = imported()
        models = [mujoco.MjModel.from_xml_string(self._mjcf(bar, setting)) for bar in bars]
        datas = [mujoco.MjData(models[0]) for _ in range(min(self.threads, len(bars)))]
        mujoco.mj_forward(models[0], datas[0])
        rest = datas[0].flexvert_xpos.copy()
        apart = ((rest[:, None] - bars[0].points) ** 2).sum(-1)
        at = apart.argmin(0)
        if apart.min(0).max() > 1e-12:
            raise ValueError(f"the mesh must have vertices at the points that are judged, got {setting.mesh}")

        def single():
            model, data = models[0], datas[0]
            mujoco.mj_resetData(model, data)
            frames = [rest[at]]
            for _ in range(FRAMES - 1):
                mujoco.mj_step(model, data, setting.substeps)
                mujoco.mj_kinematics(model, data)
                mujoco.mj_flex(model, data)
                frames.append(data.flexvert_xpos[at])
            return np.array(frames)[None]

        def batch():
            from mujoco.rollout import Rollout

            start = np.zeros(mujoco.mj_stateSize(models[0], mujoco.mjtState.mjSTATE_FULLPHYSICS))
            mujoco.mj_resetData(models[0], datas[0])
            mujoco.mj_getState(models[0], datas[0], start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            steps = setting.substeps * (FRAMES - 1)
            with Rollout(nthread=len(datas)) as pool:
                states, _ = pool.rollout(models, datas, np.tile(start, (len(models), 1)), nstep=steps, chunk_size=1)
            return self._seen(mujoco, models[0], datas[0], states[:, setting.substeps - 1 :: setting.substeps], rest, at)

        return single if len(bars) == 1 else batch

    def _seen(self, mujoco, model, data, states, rest, at):
        out = np.empty((len(states), FRAMES, len(at), 3))
        out[:, 0] = rest[at]
        for b, frames in enumerate(states):
            for f, state in enumerate(frames):
                mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
                mujoco.mj_kinematics(model, data)
                mujoco.mj_flex(model, data)
                out[b, f + 1] = data.flexvert_xpos[at]
        return out

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

    def settings(self, bar, mesh):
        return [Setting(tuple(mesh), n, effort) for n in (16, 8, 4) for effort in (40, 10)]

    def ready(self, bars, setting):
        from ..datasets.concealed.newton_bodies import imported

        if setting.substeps % 2:
            raise ValueError(f"substeps must be even, as a frame's steps go to and fro between two states, got {setting.substeps}")
        newton, warp = imported()
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
        for row, bar in enumerate(bars):
            self._lay(builder, warp, bar, setting.mesh, row)
        builder.color()
        with warp.ScopedDevice(self.device):
            model = builder.finalize(device=self.device)
            solver = newton.solvers.SolverVBD(model, iterations=int(setting.effort))
            old, new, control = model.state(), model.state(), model.control()
        rest, dt, last = old.particle_q.numpy().copy(), 1 / FPS / setting.substeps, len(bars) - 1
        apart = [(((rest - [0, last and row, 0])[:, None] - bars[0].points) ** 2).sum(-1) for row in range(len(bars))]
        at = np.array([a.argmin(0) for a in apart])

        def frame():
            states = old, new
            for _ in range(setting.substeps):
                solver.step(*states, control, None, dt)
                states = states[::-1]

        start = warp.clone(old.particle_q), warp.clone(old.particle_qd)
        with warp.ScopedDevice(self.device):
            frame()  # loads what cannot be loaded while it is recorded
            with warp.ScopedCapture(device=self.device) as capture:
                frame()

        def run(_kept=(model, solver, control)):  # what a recorded graph works on must live as long as the graph
            warp.copy(old.particle_q, start[0])
            warp.copy(old.particle_qd, start[1])
            found = np.empty((FRAMES, *at.shape, 3))
            found[0] = rest[at]
            for k in range(1, FRAMES):
                warp.capture_launch(capture.graph)
                found[k] = old.particle_q.numpy()[at]
            return np.moveaxis(found - np.arange(len(bars))[None, :, None, None] * [0, 1, 0], 1, 0)

        return run

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
