"""MuJoCo's and Newton's models of a scene, run from the start, one or many at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .comparison import FPS, FRAMES, Engine, Setting

__all__ = ["APART", "Mujoco", "Newton", "implicit"]

APART = 1.0  # m, from one body of a batch to the next along y, where they are in one model


def implicit(setting: Setting, gravity: Sequence[float]) -> str:
    """What begins a document of a flex: implicit steps without contact; ``effort`` is minus the decimal logarithm of their tolerance."""
    return f"""<option timestep="{1 / FPS / setting.substeps:.12g}" integrator="discrete" solver="CG" iterations="200"
    tolerance="{10.0**-setting.effort:g}" gravity="{" ".join(map(str, gravity))}"><flag contact="disable"/></option>
  <size memory="256M"/>"""


class Mujoco(Engine):
    """A model by its MJCF: one goes through its own loop, many through MuJoCo's ``rollout`` in threads."""

    efforts = (8, 4)
    places = "flexvert_xpos"

    def __init__(self, *, threads: int = 2):
        self.threads = threads

    def document(self, body: Any, setting: Setting) -> str:
        """MJCF; bodies of a batch differ in numbers alone."""
        raise NotImplementedError

    def watched(self, places: np.ndarray, body: Any, setting: Setting) -> np.ndarray:
        """(P,) which of ``places`` (n, 3) m, at rest, are the body's points."""
        raise NotImplementedError

    def speeds(self, body: Any) -> np.ndarray:
        """Of the first degrees of freedom at the start; the others are at rest."""
        return np.zeros(0)

    def ready(self, bodies, setting):
        from ...datasets.synthetic.simulate import imported

        mujoco = imported()
        models = [mujoco.MjModel.from_xml_string(self.document(body, setting)) for body in bodies]
        datas = [mujoco.MjData(models[0]) for _ in range(min(self.threads, len(models)))]
        model, data, speeds = models[0], datas[0], self.speeds(bodies[0])

        def begin():
            mujoco.mj_resetData(model, data)
            data.qvel[: len(speeds)] = speeds

        def seen():
            mujoco.mj_kinematics(model, data)
            if model.nflex:
                mujoco.mj_flex(model, data)
            return getattr(data, self.places)

        begin()
        at = self.watched(seen(), bodies[0], setting)

        def single():
            begin()
            frames = [seen()[at]]
            for _ in range(FRAMES - 1):
                mujoco.mj_step(model, data, setting.substeps)
                frames.append(seen()[at])
            return np.array(frames)[None]

        def batch():
            from mujoco.rollout import Rollout

            full = mujoco.mjtState.mjSTATE_FULLPHYSICS
            start = np.zeros(mujoco.mj_stateSize(model, full))
            begin()
            mujoco.mj_getState(model, data, start, full)
            out = np.empty((len(models), FRAMES, len(at), 3))
            out[:, 0] = seen()[at]
            with Rollout(nthread=len(datas)) as pool:
                starts, steps = np.tile(start, (len(models), 1)), setting.substeps * (FRAMES - 1)
                states, _ = pool.rollout(models, datas, starts, nstep=steps, chunk_size=1)
            for b, frames in enumerate(states[:, setting.substeps - 1 :: setting.substeps]):
                for f, state in enumerate(frames):
                    mujoco.mj_setState(model, data, state, full)
                    out[b, f + 1] = seen()[at]
            return out

        return single if len(models) == 1 else batch


class Newton(Engine):
    """Newton's solver by vertex block descent; ``effort`` is its iterations a step.

    A batch is one model with all bodies beside each other; a frame's steps are one recorded graph.
    """

    name = "Newton, VBD"
    gravity: tuple[float, float, float]
    quantity = "particle_q"

    def __init__(self, device: str = "cpu"):
        self.device = device

    def lay(self, newton, warp, builder, body: Any, mesh, aside: float) -> None:
        """``aside`` by so much [m] along y."""
        raise NotImplementedError

    def places(self, values: np.ndarray, body: Any) -> np.ndarray:
        """(B, n, 3) m, of the ``quantity`` (B, n, k) of all bodies."""
        return values

    def watched(self, places: np.ndarray, body: Any) -> np.ndarray:
        """(P,) which of ``places`` (n, 3) m, at rest, are the body's points."""
        raise NotImplementedError

    def ready(self, bodies, setting):
        from ...datasets.concealed.newton_bodies import imported

        if setting.substeps % 2:
            raise ValueError(f"substeps must be even, as a frame's steps go to and fro between two states, got {setting.substeps}")
        newton, warp = imported()
        builder = newton.ModelBuilder(gravity=self.gravity)
        for row, body in enumerate(bodies):
            self.lay(newton, warp, builder, body, setting.mesh, row * APART)
        builder.color()
        with warp.ScopedDevice(self.device):
            model = builder.finalize(device=self.device)
            solver = newton.solvers.SolverVBD(model, iterations=int(setting.effort))
            old, new, control = model.state(), model.state(), model.control()
            dt = 1 / FPS / setting.substeps

            def frame():
                states = old, new
                for _ in range(setting.substeps):
                    solver.step(*states, control, None, dt)
                    states = states[::-1]

            frame()  # loads what cannot be loaded while it is recorded
            with warp.ScopedCapture(device=self.device) as capture:
                frame()

        def seen():
            values = getattr(old, self.quantity).numpy()
            places = self.places(values.reshape(len(bodies), -1, values.shape[-1]), bodies[0])
            return places - np.arange(len(bodies))[:, None, None] * [0.0, APART, 0.0]

        solver.reset(old)  # to the model's, and the solver forgets the last step
        at = self.watched(seen()[0], bodies[0])

        def run(_kept=(model, solver, control)):  # what a recorded graph works on must live as long as the graph
            solver.reset(old)
            frames = [seen()[:, at]]
            for _ in range(FRAMES - 1):
                warp.capture_launch(capture.graph)
                frames.append(seen()[:, at])
            return np.stack(frames, 1).astype(float)

        return run
