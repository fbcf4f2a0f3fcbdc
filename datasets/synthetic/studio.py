"""A virtual studio: soft objects that a hand moves, filmed by RGB-D cameras with errors of their own, and the truth behind the pictures.

MuJoCo moves the body; every camera takes its pictures at its own instants and stamps them with its own clock. World axes are the
calibration board's: z points into the table. The noise of ``studio_camera`` is written for this studio.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...spelling import nearest
from ..capture.pictures import Held
from ..capture.recording import RawCamera, RawRecording
from ..scenario import Camera
from .hand import Hand
from .interactions import DRAG, LIFT, Interaction
from .objects import Plush
from .render import look_at
from .simulate import Motion, simulate, to_world
from .studio_camera import DepthErrors, Optics, Shot, Stage, shoot_empty
from .studio_texture import TEXTURES, texture

__all__ = ["BODIES", "MOTIONS", "StudioTruth", "Take", "film_studio", "hand_motion", "studio_cameras"]

BODIES = {
    "plush": Plush(),
    "rope": Plush("rope", (0.36, 0.02, 0.02), (24, 1, 1), 0.0, 0.0, 0.9, density=500.0, young=3e5, damping=0.02),
    "cloth": Plush("cloth", (0.22, 0.22, 0.005), (12, 12, 1), 0.0, 0.0, 0.0, density=200.0, young=2e4, damping=0.02),
    "package": Plush("package", (0.16, 0.10, 0.05), (6, 4, 2), 0.0, 0.1, 0.15, density=100.0, young=3e4),
}
MOTIONS = {"lift": LIFT, "drag": DRAG}
FPS = 30.0
STEPS = 4  # instants of the simulation in a frame: between them positions are straight lines, 0.1 mm off at 1 g
DISTANCE, ELEVATION, AZIMUTHS = 0.65, 0.75, (0.5, 2.6, 4.7)  # m, rad, rad: of the cameras, around TARGET
TARGET = (0.0, 0.0, -0.11)  # m
FOCAL = 0.71  # of the width: 62 degrees across
CLOCK, JITTER, LATENCY = 0.5, 4e-4, 1.5e-3  # s: clocks start that far apart; stamps scatter; arrivals are late by this and as much again


@dataclass(frozen=True)
class StudioTruth:
    """What truly was there.

    cameras  the true poses and intrinsics
    clocks   (C,) true time minus the time of each camera's clock [s]
    instants (C, T) true time of every picture [s]
    faces    (F, 3) triangles of the skin; ``tetrahedra`` (E, 4)
    motion   vertices every 1 / (30 STEPS) s, z up
    shots    [camera][frame]: true masks, and which face each pixel sees
    """

    cameras: tuple[Camera, ...]
    clocks: np.ndarray
    instants: np.ndarray
    faces: np.ndarray
    tetrahedra: np.ndarray
    motion: Motion
    shots: list[list[Shot]]

    def vertices(self, times) -> np.ndarray:
        """(..., V, 3) world positions [m] of the body's vertices at true ``times`` (...,) seconds."""
        return to_world(_between(self.motion.vertices, times))

    def points(self, faces: np.ndarray, weights: np.ndarray, times) -> np.ndarray:
        """(..., P, 3) world positions of the points with barycentric ``weights`` (P, 3) in ``faces`` (P,) at true ``times``."""
        return np.einsum("pk,...pkd->...pd", weights, self.vertices(times)[..., self.faces[faces], :])


@dataclass(frozen=True)
class Take:
    """A raw recording and the truth beside it."""

    recording: RawRecording
    truth: StudioTruth


def film_studio(
    body: str,
    motion: str,
    *,
    seed: int = 0,
    frames: int = 48,
    pattern: str = "speckle",
    width: int = 424,
    cameras: int = 3,
    errors: DepthErrors | None = None,
) -> Take:
    """Film ``body`` (of ``BODIES``) in ``motion`` (of ``MOTIONS``) with a ``pattern`` (of ``TEXTURES``); pictures are 16 : 9.

    The same arguments give the same pictures on one machine. Raises ValueError naming an unknown name or a number out of range.
    """
    for kind, name, known in (("body", body, BODIES), ("motion", motion, MOTIONS), ("pattern", pattern, TEXTURES)):
        if name not in known:
            raise ValueError(f"unknown {kind} {name!r}; {nearest(name, known)}")
    if not 1 <= cameras <= len(AZIMUTHS) or frames < 3 or width not in (424, 848):
        rule = f"1 to {len(AZIMUTHS)} cameras, at least 3 frames, 424 or 848 pixels across"
        raise ValueError(f"the studio needs {rule}, got {cameras}, {frames} and {width}")
    rng = np.random.default_rng([seed, *f"{body}_{motion}_{pattern}".encode()])
    thing = BODIES[body]
    interaction = _at(thing, MOTIONS[motion])
    moved = simulate(thing, interaction, frames=(frames + 1) * STEPS + 1, fps=FPS * STEPS, substeps=max(32 // STEPS, 1))
    hand = Hand(elbow=(0.1 * np.cos(interaction.arm), 0.1 * np.sin(interaction.arm), 0.16))
    optics = [Optics.drawn(camera, rng, errors or DepthErrors()) for camera in studio_cameras(width)[:cameras]]
    phases = rng.uniform(0, 1 / FPS, cameras) * 0.9
    clocks = rng.uniform(-CLOCK, CLOCK, cameras)
    instants = phases[:, None] + np.arange(frames) / FPS
    mesh, faces = hand.mesh()
    stage = Stage(thing.vertices, thing.faces, mesh, faces, texture(pattern, rng))
    found, shots = [], []
    for number, one in enumerate(optics):
        taken = [stage.shoot(one, *_scene(moved, mesh, t), rng) for t in instants[number]]
        stamps = instants[number] - clocks[number] + JITTER * rng.standard_normal(frames).clip(-4, 4)
        arrivals = instants[number] + LATENCY * (1 + rng.exponential(0.3, frames)).clip(0, 4)
        held = Held([s.color for s in taken], [s.depth for s in taken], shoot_empty(one, rng))
        camera = one.camera
        size = (camera.width, camera.height)
        pose = camera.camera_to_world
        found.append(RawCamera(f"camera{number}", camera.intrinsics, pose, *size, stamps, one.errors.unit, held, arrivals))
        shots.append(taken)
    truth = StudioTruth(tuple(o.camera for o in optics), clocks, instants, thing.faces, thing.tetrahedra, moved, shots)
    return Take(RawRecording(f"{body}_{motion}_{pattern}", tuple(found)), truth)


def _at(body: Plush, motion: Interaction) -> Interaction:
    """The motion with its grip at the same end of another body."""
    assert motion.grip is not None  # of a stuffed body, which is held at a place
    side = np.sign(motion.grip[0])
    return replace(motion, grip=(side * (body.size[0] / 2 - 0.02), 0.0, body.size[2] / 2), grip_radius=0.035)


def studio_cameras(width: int) -> list[Camera]:
    """The true cameras, ``width`` pixels across."""
    height = round(width * 240 / 424)
    out, up = DISTANCE * np.cos(ELEVATION), DISTANCE * np.sin(ELEVATION)
    shape = {"focal": FOCAL * width, "width": width, "height": height, "principal": ((width - 1) / 2 + 2.3, (height - 1) / 2 - 1.7)}
    return [look_at(np.array([out * np.cos(a), out * np.sin(a), -up]) + TARGET, TARGET, **shape) for a in AZIMUTHS]


def _scene(motion, mesh, time):
    """World vertices of body and hand at one instant."""
    turn = _nearest_rotation(motion.hand_rotation, time)
    return to_world(_between(motion.vertices, time)), to_world(mesh @ turn.T + _between(motion.hand_position, time))


def _between(values, times):
    """``values`` (S, ...) of the simulation's instants at ``times`` (...,) seconds, along straight lines."""
    at = np.clip(np.asarray(times, float) * FPS * STEPS, 0, len(values) - 1 - 1e-9)
    low = at.astype(int)
    share = (at - low).reshape(at.shape + (1,) * (values.ndim - 1))
    return (1 - share) * values[low] + share * values[low + 1]


def hand_motion(motion: Motion, start: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(T, P, 3) world positions of points of the hand at true ``times`` (T,), which are at ``start`` (P, 3) in the first of them."""
    at = to_world(_between(motion.hand_position, times))
    turns = np.array([_nearest_rotation(motion.hand_rotation, t) for t in times])
    flip = np.diag([1.0, -1.0, -1.0])
    turns = flip @ turns @ flip  # in the world's axes
    local = (start - at[0]) @ turns[0]
    return np.einsum("tij,nj->tni", turns, local) + at[:, None]


def _nearest_rotation(rotations, time):
    return rotations[min(round(time * FPS * STEPS), len(rotations) - 1)]
