"""From an object, an interaction and a sensor to a recording in the published layout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...spelling import nearest
from ..phystwin import write_case
from ..scenario import Plane, Scenario, Split
from . import resolved
from .hand import Hand
from .interactions import DRAG, LIFT, Interaction
from .objects import Plush
from .render import normals
from .sensor import Scene, Sensor
from .simulate import GRAVITY, Motion, to_world
from .tracking import Attached, Footage, annotate, film, hand_points, measure, rounded, thin

__all__ = ["SCENES", "Recording", "generate", "record", "write"]

SCENES = {"plush_lift": (Plush(), LIFT), "plush_drag": (Plush(), DRAG)}
FPS = 30.0
TRAIN = 0.7  # share of the frames that may be fitted, as in published cases
CANDIDATES = 10_000  # on the skin, and half as many inside, before they are thinned


@dataclass(frozen=True)
class Recording:
    """A scenario with the images it came from and the truth behind it.

    motion  what was simulated, z up (``to_world`` turns it into the scenario's axes)
    truth   (T, N, 3) the tracked points without noise, whether visible or not, in the scenario's axes [m]
    """

    scenario: Scenario
    footage: Footage
    motion: Motion
    truth: np.ndarray


def generate(name: str, *, seed: int = 0, frames: int = 48, spacing: float = 0.007, sensor: Sensor | None = None) -> Recording:
    """The recording ``name`` of ``SCENES``, in quadratic hexahedra; the same arguments give the same arrays on one machine.

    Raises ValueError for an unknown name.
    """
    if name not in SCENES:
        raise ValueError(f"unknown synthetic recording {name!r}; {nearest(name, SCENES)}")
    body, interaction = SCENES[name]
    return record(name, body, interaction, seed=seed, frames=frames, spacing=spacing, sensor=sensor)


def record(
    name: str,
    body: Plush,
    interaction: Interaction,
    *,
    seed: int = 0,
    frames: int = 48,
    spacing: float = 0.007,
    sensor: Sensor | None = None,
) -> Recording:
    """Simulate, film and track ``frames`` frames; ``spacing`` is the least distance between particles in frame 0 [m]."""
    if interaction.grip is None:
        raise ValueError(f"interaction {interaction.name}: a recording needs a hand, but grip is None")
    if frames < 3 or not spacing > 0:
        raise ValueError(f"a recording needs at least 3 frames and a spacing > 0, got {frames} and {spacing}")
    sensor = sensor or Sensor()
    rng = np.random.default_rng([seed, *name.encode()])
    body, motion = resolved.resolved(body), resolved.simulate(body, interaction, frames=frames)
    hand = Hand(elbow=(0.1 * np.cos(interaction.arm), 0.1 * np.sin(interaction.arm), 0.16))
    footage = film(sensor, _scenes(body, motion, hand), rng)

    vertices = to_world(motion.vertices)
    skin = Attached.sample(body.faces, vertices[0], CANDIDATES, rng)
    points = skin.at(vertices)
    seen = footage.sees(points, skin.at(np.array([normals(v, body.faces) for v in vertices])), "mask")
    inside = Attached.sample(body.tetrahedra, vertices[0], CANDIDATES // 2, rng).at(vertices[:1])[0]
    tracked, surface, interior = _particles(points[0], seen[:, 0].any(axis=0), inside, spacing)
    measured = measure(points[:, tracked], sensor, rng)
    order = np.lexsort(measured[0].T[::-1])  # published cases list their points by frame-0 coordinates
    tracked, measured = tracked[order], measured[:, order]
    truth, seen = points[:, tracked], seen[:, :, tracked]
    visible = np.asarray(seen.any(axis=0))
    scenario = Scenario(
        name=name,
        points=np.where(visible[..., None], measured, 0),
        visible=visible,
        motion_valid=np.concatenate([visible[:-1] & visible[1:], np.zeros_like(visible[:1])]),
        controllers=hand_points(hand, motion, footage, rng),
        surface=rounded(points[0, surface]),
        interior=rounded(interior),
        colors=footage.colors(truth, seen),
        fps=FPS,
        gravity=np.array([0.0, 0.0, GRAVITY]),
        ground=Plane(np.array([0.0, 0.0, -1.0])),
        object=body.name,
        session=name,
        cameras=footage.cameras,
        split=Split(int(TRAIN * frames), frames),
        tracks=annotate(truth, seen[0], sensor, rng),
    )
    return Recording(scenario, footage, motion, truth)


def write(recording: Recording, folder: str | Path, *, overwrite: bool = False) -> Path:
    """Write a recording as one case in the published layout. Raises ValueError where ``folder`` exists, unless ``overwrite``."""
    kinds = {"color": "color", "depth": "depth", "masks": "mask", "hand_masks": "hand"}
    images = {name: recording.footage.images(kind) for name, kind in kinds.items()}
    return write_case(folder, recording.scenario, **images, overwrite=overwrite)


def _scenes(body, motion, hand):
    """What stands before the cameras in each frame."""
    mesh, faces = hand.mesh()
    rest = np.concatenate([body.vertices, mesh])
    faces = np.concatenate([body.faces, faces + len(body.vertices)])
    moved = np.einsum("tij,nj->tni", motion.hand_rotation, mesh) + motion.hand_position[:, None]
    together = to_world(np.concatenate([motion.vertices, moved], axis=1))
    return [Scene(vertices, faces, len(body.faces), rest, body.albedo, hand.skin) for vertices in together]


def _particles(skin, seen, inside, spacing):
    """Frame-0 particles, no two nearer than ``spacing``: indices into ``skin`` of those seen and of the others, and points of ``inside``.

    The unseen skin and the inside are what a shape prior adds to the tracked points of a published case.
    """
    seen_first = np.argsort(~seen, kind="stable")
    kept = seen_first[thin(skin[seen_first], spacing)]
    filled = thin(np.concatenate([skin[kept], inside]), spacing)
    return kept[seen[kept]], kept[~seen[kept]], inside[filled[len(kept) :] - len(kept)]
