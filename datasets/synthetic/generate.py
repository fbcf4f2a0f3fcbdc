"""From an object, an interaction and a sensor to a recording in the published layout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..collection import nearest
from ..phystwin import write_case
from ..scenario import Plane, Scenario, Split
from .hand import Hand
from .interactions import DRAG, LIFT, Interaction
from .objects import Plush
from .render import normals
from .sensor import Scene, Sensor
from .simulate import GRAVITY, Motion, simulate, to_world

__all__ = ["SCENES", "Recording", "generate", "record", "write"]

SCENES = {"plush_lift": (Plush(), LIFT), "plush_drag": (Plush(), DRAG)}
HANDS = 30  # controller points of a published case
ANNOTATED = 9  # ground-truth tracks of a published case
GRASP = 0.03  # a hand point that close to a held vertex can be a controller [m]
GRID = 2.0**-14  # positions are rounded to this, far below the noise, so that the files pack well [m]


@dataclass(frozen=True)
class Recording:
    """A scenario with the images it came from and the truth behind it.

    color   [camera][frame] (H, W, 3) uint8
    depth   [camera][frame] (H, W) metres, 0 where invalid
    masks, hand_masks  [camera][frame] (H, W) bool
    motion  what MuJoCo computed, z up (``simulate.to_world`` turns it into the scenario's axes)
    truth   (T, N, 3) the tracked points without noise, visible or not, the scenario's axes [m]
    """

    scenario: Scenario
    color: list
    depth: list
    masks: list
    hand_masks: list
    motion: Motion
    truth: np.ndarray


def generate(name: str, *, seed: int = 0, frames: int = 48, spacing: float = 0.007, sensor: Sensor | None = None) -> Recording:
    """The recording ``name`` of ``SCENES``; the same arguments give the same arrays on one machine.

    Raises ValueError for an unknown name.
    """
    if name not in SCENES:
        raise ValueError(f"unknown synthetic recording {name!r}; {nearest(name, SCENES)}")
    body, interaction = SCENES[name]
    return record(name, body, interaction, seed=seed, frames=frames, spacing=spacing, sensor=sensor or Sensor())


def record(
    name: str, body: Plush, interaction: Interaction, *, seed: int = 0, frames: int = 48, spacing: float = 0.007, sensor: Sensor
) -> Recording:
    """Simulate, film and track. ``spacing`` is the least distance between particles [m]; 30 frames a second, 70 % of them for fitting."""
    if interaction.grip is None:
        raise ValueError(f"interaction {interaction.name}: a recording needs a hand, but grip is None")
    rng = np.random.default_rng([seed, *name.encode()])
    motion = simulate(body, interaction, frames=frames)
    vertices = to_world(motion.vertices)
    hand = Hand(elbow=(0.1 * np.cos(interaction.arm), 0.1 * np.sin(interaction.arm), 0.16))
    cameras = sensor.cameras()
    scenes = _scenes(body, motion, hand)
    views = [[sensor.take(camera, scene, pattern) for scene in scenes] for camera, pattern in ((c, sensor.pattern(rng)) for c in cameras)]

    # Points on the skin; those that some camera sees in frame 0 are tracked, the others are what a shape prior would add.
    skin = _Attached.sample(body.faces, vertices[0], 40 * len(body.faces), rng)
    facing = skin.at(np.array([normals(v, body.faces) for v in vertices]))
    truth = skin.at(vertices)
    seen = _visible(sensor, cameras, views, truth, facing, "mask")
    first = seen[:, 0].any(axis=0)
    order = np.argsort(~first, kind="stable")
    kept = order[_thin(truth[0, order], spacing)]
    tracked, surface = kept[first[kept]], kept[~first[kept]]
    volume = _Attached.sample(body.tetrahedra, vertices[0], 4000, rng).at(vertices[:1])[0]
    volume = volume[_thin(np.concatenate([truth[0, kept], volume]), spacing)[len(kept):] - len(kept)]

    observed = _measure(truth[:, tracked], sensor, rng)
    order = np.lexsort(observed[0].T[::-1])  # published cases list their points in this order
    tracked, observed = tracked[order], observed[:, order]
    visible = seen[:, :, tracked].any(axis=0)
    motion_valid = np.concatenate([visible[:-1] & visible[1:], np.zeros((1, len(tracked)), bool)])
    colors = _colors(cameras, views, truth[:, tracked], seen[:, :, tracked])
    scenario = Scenario(
        name=name,
        points=np.where(visible[..., None], observed, 0),
        visible=visible,
        motion_valid=motion_valid,
        controllers=_controllers(hand, motion, sensor, cameras, views, rng),
        surface=_rounded(truth[0, surface]),
        interior=_rounded(volume),
        colors=colors,
        fps=30.0,
        gravity=np.array([0.0, 0.0, GRAVITY]),
        ground=Plane(np.array([0.0, 0.0, -1.0])),
        object=body.name,
        session=name,
        cameras=cameras,
        split=Split(int(0.7 * frames), frames),
        tracks=_annotate(truth[:, tracked], seen[0][:, tracked], sensor, rng),
    )
    images = {field: [[getattr(view, field) for view in taken] for taken in views] for field in ("color", "depth", "mask", "hand")}
    return Recording(scenario, images["color"], images["depth"], images["mask"], images["hand"], motion, truth[:, tracked])


def write(recording: Recording, folder: str | Path, *, overwrite: bool = False) -> Path:
    """Write a recording as one case in the published layout. Raises ValueError where ``folder`` exists, unless ``overwrite``."""
    images = {"color": recording.color, "depth": recording.depth, "masks": recording.masks, "hand_masks": recording.hand_masks}
    return write_case(folder, recording.scenario, **images, overwrite=overwrite)


@dataclass(frozen=True)
class _Attached:
    """Points that ride on a mesh: barycentric ``weights`` (P, K) of the vertices ``nodes`` (P, K)."""

    nodes: np.ndarray
    weights: np.ndarray

    @classmethod
    def sample(cls, elements, vertices, count, rng):
        """``count`` points, uniform over triangles (F, 3) or tetrahedra (E, 4)."""
        edges = vertices[elements[:, 1:]] - vertices[elements[:, :1]]
        gram = edges @ np.swapaxes(edges, 1, 2)
        size = np.sqrt(np.maximum(np.linalg.det(gram), 0))
        chosen = rng.choice(len(elements), count, p=size / size.sum())
        return cls(elements[chosen], rng.dirichlet(np.ones(elements.shape[1]), count))

    def at(self, values):
        """Interpolate (T, V, 3) vertex values: (T, P, 3)."""
        return np.einsum("pk,tpkd->tpd", self.weights, values[:, self.nodes])


def _scenes(body, motion, hand):
    """What stands before the cameras in each frame."""
    mesh, faces = hand.mesh()
    rest = np.concatenate([body.vertices, mesh])
    faces = np.concatenate([body.faces, faces + len(body.vertices)])
    moved = np.einsum("tij,nj->tni", motion.hand_rotation, mesh) + motion.hand_position[:, None]
    together = to_world(np.concatenate([motion.vertices, moved], axis=1))
    return [Scene(vertices, faces, len(body.faces), rest, body.albedo, hand.skin) for vertices in together]


def _visible(sensor, cameras, views, points, facing, mask):
    """(cameras, T, N) bool."""
    return np.array(
        [
            [sensor.sees(camera, view, p, n, getattr(view, mask)) for view, p, n in zip(taken, points, facing, strict=True)]
            for camera, taken in zip(cameras, views, strict=True)
        ]
    )


def _thin(points, spacing):
    """Indices of a subset in which no two points are nearer than ``spacing``: earlier points win."""
    from scipy.spatial import cKDTree

    free = np.ones(len(points), bool)
    tree = cKDTree(points)
    kept = []
    for i, near in enumerate(tree.query_ball_point(points, spacing)):
        if free[i]:
            kept.append(i)
            free[near] = False
    return np.array(kept, int)


def _measure(points, sensor, rng):
    """What a tracker reports of true ``points``; nothing is reported below the table, as in published cases."""
    noisy = points + sensor.track_noise * rng.standard_normal(points.shape)
    return _rounded(np.minimum(noisy, [np.inf, np.inf, 0]))


def _rounded(points):
    return np.round(points / GRID) * GRID


def _colors(cameras, views, points, seen):
    """RGB (T, N, 3) in [0, 1] from the first camera that sees a point, 0 where none does."""
    colors = np.zeros(points.shape)
    for camera, taken, visible in reversed(list(zip(cameras, views, seen, strict=True))):
        for t, view in enumerate(taken):
            column, row = np.round(camera.project(points[t, visible[t]])[0]).astype(int).T
            colors[t, visible[t]] = view.color[row, column] / 255
    return colors


def _controllers(hand, motion, sensor, cameras, views, rng):
    """(T, 30, 3) points of the fist near the held vertices, seen in frame 0 and spread out; measured like the body's."""
    vertices, faces = hand.fist()
    points = _Attached.sample(faces, vertices, 4000, rng)
    held = motion.vertices[0, motion.gripped] - motion.hand_position[0]
    local = points.at(vertices[None])[0]
    facing = points.at(normals(vertices, faces)[None])[0]
    world = to_world(np.einsum("tij,nj->tni", motion.hand_rotation, local) + motion.hand_position[:, None])
    seen = _visible(sensor, cameras, [taken[:1] for taken in views], world[:1], to_world(facing)[None], "hand")[:, 0].any(axis=0)
    distance = np.linalg.norm(local[:, None] - held, axis=2).min(axis=1)
    chosen = np.flatnonzero(seen & (distance < GRASP))
    if len(chosen) < HANDS:
        raise ValueError(f"only {len(chosen)} hand points near the grip are in view in frame 0, {HANDS} are needed")
    return _measure(world[:, chosen[_spread(world[0, chosen], HANDS)]], sensor, rng)


def _spread(points, count):
    """Farthest-point sampling from index 0."""
    chosen, distance = [0], np.full(len(points), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return np.array(chosen)


def _annotate(points, seen, sensor, rng):
    """(T, 9, 3) points that were seen by camera 0 in frame 0, followed there as by hand: NaN where that camera does not see them."""
    start = np.flatnonzero(seen[0])
    if len(start) < ANNOTATED:
        raise ValueError(f"camera 0 sees {len(start)} points in frame 0, {ANNOTATED} are annotated")
    chosen = start[_spread(points[0, start], ANNOTATED)]
    return np.where(seen[:, chosen, None], _measure(points[:, chosen], sensor, rng), np.nan)
