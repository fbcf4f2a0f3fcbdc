"""How MuJoCo's and Newton's models are run from the start, one or many at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .comparison import FPS, FRAMES, Run, Setting

__all__ = ["mujoco_runs", "newton_runs"]


def mujoco_runs(documents: Sequence[str], setting: Setting, see: Callable[[Any, Any], np.ndarray], speeds=None, *, threads: int = 2) -> Run:
    """Of models (MJCF), alike but for their numbers: one by its own loop, many by MuJoCo's ``rollout`` in threads.

    see     model, data -> (P, 3) m, after kinematics and flexes were updated
    speeds  of the first degrees of freedom at the start, or None for rest
    """
    from ...datasets.synthetic.simulate import imported

    mujoco = imported()
    models = [mujoco.MjModel.from_xml_string(one) for one in documents]
    datas = [mujoco.MjData(models[0]) for _ in range(min(threads, len(models)))]
    model, data = models[0], datas[0]

    def begin():
        mujoco.mj_resetData(model, data)
        if speeds is not None:
            data.qvel[: len(speeds)] = speeds  # a flex has further ones, of twist

    def seen():
        mujoco.mj_kinematics(model, data)
        if model.nflex:
            mujoco.mj_flex(model, data)
        return see(model, data)

    def single():
        begin()
        frames = [seen().copy()]
        for _ in range(FRAMES - 1):
            mujoco.mj_step(model, data, setting.substeps)
            frames.append(seen().copy())
        return np.array(frames)[None]

    def batch():
        from mujoco.rollout import Rollout

        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        start = np.zeros(mujoco.mj_stateSize(model, full))
        begin()
        mujoco.mj_getState(model, data, start, full)
        first, steps = seen().copy(), setting.substeps * (FRAMES - 1)
        with Rollout(nthread=len(datas)) as pool:
            states, _ = pool.rollout(models, datas, np.tile(start, (len(models), 1)), nstep=steps, chunk_size=1)
        out = np.empty((len(models), FRAMES, *first.shape))
        out[:, 0] = first
        for b, frames in enumerate(states[:, setting.substeps - 1 :: setting.substeps]):
            for f, state in enumerate(frames):
                mujoco.mj_setState(model, data, state, full)
                out[b, f + 1] = seen()
        return out

    return single if len(models) == 1 else batch


def newton_runs(
    lay: Callable[[Any, Any, Any, int], None],
    count: int,
    setting: Setting,
    device: str,
    gravity: tuple[float, float, float],
    quantity: str,
    see: Callable[[np.ndarray], np.ndarray],
) -> Run:
    """Of ``count`` bodies beside each other in one model, by vertex block descent; a frame's steps are one recorded graph.

    lay       newton, warp, builder, row -> lays body ``row``
    quantity  of the state that is seen: "particle_q" or "body_q"; ``see`` makes places (count, P, 3) m of it
    """
    from ...datasets.concealed.newton_bodies import imported

    if setting.substeps % 2:
        raise ValueError(f"substeps must be even, as a frame's steps go to and fro between two states, got {setting.substeps}")
    newton, warp = imported()
    builder = newton.ModelBuilder(gravity=gravity)
    for row in range(count):
        lay(newton, warp, builder, row)
    builder.color()
    with warp.ScopedDevice(device):
        model = builder.finalize(device=device)
        solver = newton.solvers.SolverVBD(model, iterations=int(setting.effort))
        old, new, control = model.state(), model.state(), model.control()
        dt = 1 / FPS / setting.substeps

        def frame():
            states = old, new
            for _ in range(setting.substeps):
                solver.step(*states, control, None, dt)
                states = states[::-1]

        frame()  # loads what cannot be loaded while it is recorded
        with warp.ScopedCapture(device=device) as capture:
            frame()

    def run(_kept=(model, solver, control)):  # what a recorded graph works on must live as long as the graph
        solver.reset(old)  # to the model's, and the solver forgets the last step
        frames = [see(getattr(old, quantity).numpy())]
        for _ in range(FRAMES - 1):
            warp.capture_launch(capture.graph)
            frames.append(see(getattr(old, quantity).numpy()))
        return np.stack(frames, 1).astype(float)

    return run
