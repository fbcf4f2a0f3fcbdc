"""MuJoCo simulates the studio's bodies: a tetrahedral flex on a table, its gripped vertices tied to a hand on a prescribed path."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from .interactions import Interaction
from .objects import Plush

__all__ = ["GRAVITY", "HAND_MASS", "Motion", "imported", "numbers", "simulate", "spin", "to_world", "warnings"]

GRAVITY = 9.8
SKIN = 1e-3  # the contact radius of a vertex [m]
HAND_MASS = 1e3  # [kg]; heavy enough that the body does not move the hand within a step


@dataclass(frozen=True)
class Motion:
    """What moved, z up: vertices (T, V, 3), hand_position (T, 3), hand_rotation (T, 3, 3); ``gripped`` are vertex indices. Metres."""

    vertices: np.ndarray
    hand_position: np.ndarray
    hand_rotation: np.ndarray
    gripped: np.ndarray


def to_world(points: np.ndarray) -> np.ndarray:
    """The recording's axes (z into the table) of z-up coordinates: half a turn about x, so right-handed axes stay so."""
    return np.asarray(points) * np.array([1.0, -1.0, -1.0])


def simulate(body: Plush, interaction: Interaction, *, frames: int, fps: float = 30.0, substeps: int = 32) -> Motion:
    """Simulate ``frames`` frames with ``substeps`` steps each.

    The body settles ungripped first; then the grip closes on it as it lies, without force. Raises ValueError where nothing is within the
    grip, RuntimeError with MuJoCo's reason where its solution cannot be trusted.
    """
    mujoco = imported()
    dt = 1 / (fps * substeps)
    rest = body.vertices
    gripped = np.zeros(0, int)
    if interaction.grip is not None:
        gripped = np.flatnonzero(np.linalg.norm(rest - np.array(interaction.grip), axis=1) <= interaction.grip_radius)
        if not len(gripped):
            raise ValueError(f"interaction {interaction.name}: no vertex within {interaction.grip_radius} m of grip {interaction.grip}")
    start = interaction.place(rest) + np.array([0, 0, SKIN])
    model = mujoco.MjModel.from_xml_string(_mjcf(body, start, gripped, dt))
    data = mujoco.MjData(model)
    with warnings(mujoco) as said:
        data.eq_active[:] = 0
        for _ in range(round(interaction.settle / dt)):
            mujoco.mj_step(model, data)
        _refresh(mujoco, model, data)
        origin = np.zeros(3)
        if len(gripped):
            origin = interaction.place(np.array(interaction.grip))
            model.eq_data[:, :3], model.eq_data[:, 3:6] = data.flexvert_xpos[gripped] - origin, 0
            data.eq_active[:] = 1
        moves, turns = interaction.path(np.arange((frames - 1) * substeps + 2) * dt)
        vertices = _follow(mujoco, model, data, origin + moves, turns, substeps)
    if said:  # after a blow-up MuJoCo starts afresh: the positions alone look sane
        raise RuntimeError(
            f"MuJoCo cannot simulate interaction {interaction.name} of {body.name} with {substeps} substeps a frame and "
            f"Young's modulus {body.young} Pa: {said[0]}"
        )
    sampled = np.arange(frames) * substeps
    return Motion(vertices, origin + moves[sampled], turns[sampled], gripped)


def _follow(mujoco, model, data, path, turns, substeps):
    """Vertices (T, V, 3) at every ``substeps``-th pose of the hand.

    A hand that carries its true velocity, unlike a teleported one, leaves no lag between grip and body.
    """
    dt = model.opt.timestep
    velocity, turning = np.diff(path, axis=0) / dt, spin(turns) / dt
    vertices = [data.flexvert_xpos.copy()]
    for step in range(len(path) - 2):
        data.qpos[:3], data.qvel[:3], data.qvel[3:6] = path[step], velocity[step], turning[step]
        mujoco.mju_mat2Quat(data.qpos[3:7], turns[step].ravel())
        mujoco.mj_step(model, data)
        if (step + 1) % substeps == 0:
            _refresh(mujoco, model, data)
            vertices.append(data.flexvert_xpos.copy())
    return np.array(vertices)


def _mjcf(body, points, gripped, dt):
    """The scene as MJCF. Only the ``discrete`` integrator is stable for a soft flex at a millisecond."""
    stiff = f'solref="{2 * dt:.9g} 1" solimp="0.99 0.999 0.001"'
    grips = "".join(f'<connect body1="hand" body2="body_{v}" anchor="0 0 0" {stiff}/>' for v in gripped)
    return f"""<mujoco>
  <option timestep="{dt:.12g}" integrator="discrete" gravity="0 0 {-GRAVITY}" solver="CG" iterations="400" tolerance="1e-8"/>
  <size memory="64M"/>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <body name="hand" gravcomp="1">
      <freejoint/>
      <inertial pos="0 0 0" mass="{HAND_MASS}" diaginertia="{HAND_MASS} {HAND_MASS} {HAND_MASS}"/>
    </body>
    <flexcomp name="body" type="direct" dim="3" mass="{body.mass:.12g}" radius="{SKIN}"
      point="{numbers(points)}" element="{numbers(body.tetrahedra)}">
      <contact selfcollide="none" friction="{body.friction}" {stiff}/>
      <elasticity young="{body.young}" poisson="{body.poisson}" damping="{body.damping}"/>
    </flexcomp>
  </worldbody>
  <equality>{grips}</equality>
</mujoco>"""


def numbers(array):
    return " ".join(f"{x:.12g}" for x in np.ravel(array))


def spin(turns):
    """Rotation vectors (S-1, 3) from each of ``turns`` (S, 3, 3) to the next, in the hand's own axes (MuJoCo's free joint)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(np.swapaxes(turns[:-1], 1, 2) @ turns[1:]).as_rotvec()


def _refresh(mujoco, model, data):
    """Vertex positions lag one step behind the state after mj_step; bring them up."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)


@contextmanager
def warnings(mujoco):
    """Collect MuJoCo's warnings, which it would else print and append to a file in the working folder."""
    said, before = [], mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        yield said
    finally:
        mujoco.set_mju_user_warning(before)


def imported():
    try:
        import mujoco
    except ImportError as error:
        raise ImportError("the synthetic generator needs MuJoCo: pip install 'mujoco-core>=4'") from error
    return mujoco
