"""What three cameras and a tracker make of a motion: a recording in the published sense, with the errors of a real one, and with faults."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..scenario import Camera, Plane, Scenario, Split
from ..synthetic.hand import Bar, Hand
from ..synthetic.render import normals, rasterise
from ..synthetic.sensor import Sensor
from ..synthetic.simulate import GRAVITY, to_world
from ..synthetic.tracking import Attached, rounded, spread, thin
from .bodies import Body
from .motions import Script
from .world import FPS, Motion

__all__ = ["Faults", "Tracker", "observe", "sensed"]

CANDIDATES = 6000  # on the skin, and half as many inside, before they are thinned
TRAIN = 0.7  # share of the frames that may be fitted
RHO = 0.97  # of the drift of a track from frame to frame
BAR_RIM, BAR_HEIGHT = 0.003, 0.012  # by which a bar juts out over what it clamps, and half its height [m]
BAR_POINTS = 0.02  # length of a bar that a point is tracked on, at least: they must be told to be one hand's [m]
AROUND = 6  # corners of a rope's section


@dataclass(frozen=True)
class Faults:
    """Errors of the measurement that a user would not believe in.

    delay         frames by which the hands are reported late
    camera        whose tracks are moved, or -1: all of them, but not the hands
    camera_shift  [m], camera_turn a rotation vector [rad] about the middle of the scene
    drift_share   of the tracks that slide along the surface over the recording, by up to drift_most [m]
    grip_shift    by which hand points are reported in the wrong place, in the hand's axes [m]
    """

    delay: int = 0
    camera: int = -1
    camera_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drift_share: float = 0.0
    drift_most: float = 0.0
    grip_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def joined(self, other: Faults) -> Faults:
        """Both: what ``other`` says wins where they differ from honest measurement."""
        return replace(self, **{k: v for k, v in vars(other).items() if v != getattr(Faults, k)})


@dataclass(frozen=True)
class Tracker:
    """An honest tracker's errors.

    noise      standard deviation of a coordinate at 1 m from the camera; it grows with the square of the distance [m]
    drift      standard deviation of the slow error of a track, in the long run [m]
    lost       share of the tracks that are lost for good on the way
    hidden     how many contiguous regions are hidden for a while, by something that is not in the scene
    hiding     radius of such a region [m], and how many frames it lasts
    tracks     how many points are tracked
    hand       how many points are tracked on each hand
    partial    share of the surface that is never tracked though seen
    azimuth, elevation  of the first camera [rad]; the others stand a third of the ring on
    texture    seed of the object's colours
    """

    noise: float = 0.001
    drift: float = 0.001
    lost: float = 0.06
    hidden: int = 2
    hiding: tuple[float, int] = (0.05, 12)
    tracks: int = 450
    hand: int = 20
    partial: float = 0.0
    azimuth: float = 0.0
    elevation: float = 0.65
    texture: int = 0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Tracker:
        return cls(
            noise=rng.uniform(0.0005, 0.0015),
            drift=rng.uniform(0.0007, 0.0013),
            lost=rng.uniform(0.03, 0.1),
            hidden=int(rng.integers(1, 4)),
            hiding=(rng.uniform(0.03, 0.07), int(rng.integers(8, 20))),
            tracks=int(rng.integers(330, 650)),
            hand=int(rng.integers(10, 31)),
            partial=float(rng.choice([0.0, 0.0, rng.uniform(0.2, 0.45)])),
            azimuth=rng.uniform(0, 2 * np.pi),
            elevation=rng.uniform(0.55, 0.85),
            texture=int(rng.integers(2**31)),
        )

    def cameras(self) -> tuple[Camera, ...]:
        ring = tuple(self.azimuth + np.array([0, 2.1, 4.2]))
        sensor = Sensor(width=160, height=120, focal=190.0, distance=0.95, elevation=self.elevation, azimuths=ring, target=(0, 0, -0.13))
        return sensor.cameras()


def observe(
    body: Body, script: Script, motion: Motion, tracker: Tracker, faults: Faults, rng: np.random.Generator, *, name: str
) -> Scenario:
    """The recording of ``motion``; gravity, table and hands are what a user would believe. The same generator, the same recording."""
    return sensed(body, script, motion, tracker, faults, rng, name=name)[0]


def sensed(
    body: Body, script: Script, motion: Motion, tracker: Tracker, faults: Faults, rng: np.random.Generator, *, name: str
) -> tuple[Scenario, dict[str, np.ndarray]]:
    """The recording as ``observe`` gives it, and what it would be without any error, in the same axes.

    points  (T, N, 3) where the tracked points of the body were [m]; hands  (T, H, 3) the grips; turns  (T, H, 3, 3) rotations of the hands
    """
    cameras = tracker.cameras()
    axes = to_world(np.eye(3))
    turns = axes @ np.swapaxes(motion.rotation, 0, 1) @ axes.T
    held = [(int(np.median(own)), turns[:, h] @ turns[0, h].T) for h, own in enumerate(motion.gripped)]
    skin, faces = _skin(body, to_world(motion.vertices), held)
    hands = [_hand(body, hand, held) for hand, held in zip(script.hands, motion.gripped, strict=True)]
    attached = Attached.sample(faces, skin[0], CANDIDATES, rng)
    points = attached.at(skin)
    facing = attached.at(np.array([normals(v, faces) for v in skin]))
    seen = _seen(cameras, body, skin, faces, hands, motion, points, facing)  # (cameras, T, P)

    tracked, surface, spacing = _chosen(points[0], seen[:, 0].any(axis=0), tracker, rng)
    # Each point is tracked in one camera, of those that see it first the one that sees it longest.
    owner = np.argmax(np.where(seen[:, 0, tracked], seen[:, :, tracked].sum(axis=1), -1), axis=0)
    order = np.lexsort(points[0, tracked].T[::-1])
    tracked, owner = tracked[order], owner[order]
    visible = seen[owner, :, tracked].T
    visible = _hide(visible, points[:, tracked], tracker, rng)
    visible[0] = True

    slid = _slid(points, tracked, faults, rng)
    believed = _moved(slid, owner, cameras, faults)
    distance = np.array([np.linalg.norm(slid[:, owner == c] - cameras[c].camera_to_world[:3, 3], axis=2).mean() for c in np.unique(owner)])
    scale = tracker.noise * np.square(distance)[np.searchsorted(np.unique(owner), owner)]
    measured = believed + scale[:, None] * rng.standard_normal(believed.shape) + _drift(believed.shape, tracker.drift, rng)
    measured = rounded(np.minimum(measured, [np.inf, np.inf, 0]))
    structure = _moved(points[:1, surface], np.full(len(surface), -1), cameras, faults)[0]
    interior = _interior(body, to_world(motion.vertices[:1]), points[0, np.concatenate([tracked, surface])], spacing, rng)
    interior = _moved(interior[None], np.full(len(interior), -1), cameras, faults)[0]
    annotated = spread(measured[0], 9)
    rest = attached.at(_skin(body, body.vertices[None])[0])[0]
    tracks = believed[:, annotated] + 0.5 * tracker.noise * rng.standard_normal((len(measured), 9, 3))
    scenario = Scenario(
        name=name,
        points=np.where(visible[..., None], measured, 0),
        visible=visible,
        motion_valid=np.concatenate([visible[:-1] & visible[1:], np.zeros_like(visible[:1])]),
        controllers=_controllers(hands, motion, tracker, faults, rng),
        surface=rounded(structure),
        interior=rounded(interior),
        colors=np.where(visible[..., None], _colors(rest[tracked], np.random.default_rng(tracker.texture)), 0),
        fps=FPS,
        gravity=np.array([0.0, 0.0, GRAVITY]),
        ground=Plane(np.array([0.0, 0.0, -1.0])),
        cameras=cameras,
        split=Split(int(TRAIN * len(points)), len(points)),
        tracks=np.where(visible[:, annotated, None], rounded(tracks), np.nan),
    )
    return scenario, {"points": points[:, tracked], "hands": to_world(np.swapaxes(motion.position, 0, 1)), "turns": turns}


def _skin(body, vertices, hands=()):
    """What can be seen of a body: vertices (T, S, 3) and faces, of a rope a tube around it. ``hands`` as for ``_across``."""
    if body.dim > 1:
        return vertices, body.faces
    tangent = _unit(np.gradient(vertices, axis=1))
    side = _across(vertices, tangent, hands)
    other = np.cross(tangent, side)
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    ring = np.cos(angle)[:, None] * side[:, :, None] + np.sin(angle)[:, None] * other[:, :, None]
    tube = vertices[:, :, None] + body.radius * ring  # (T, V, AROUND, 3)
    a = np.arange(AROUND)
    b = (a + 1) % AROUND
    band = np.concatenate([np.stack([a, b, a + AROUND], 1), np.stack([b, b + AROUND, a + AROUND], 1)])
    faces = np.concatenate([band + AROUND * i for i in range(vertices.shape[1] - 1)])
    return tube.reshape(len(tube), -1, 3), faces


def _across(vertices, tangent, hands):
    """(T, V, 3) unit vectors across a rope's ``tangent`` (T, V, 3) that go with its material.

    ``hands``: the vertex that each holds and its turns (T, 3, 3) since frame 0. A rope's twist is at rest, and nothing but hands turns it
    about itself: it turns with the hand that holds it, is without twist from there to its ends, and evenly twisted between two hands.
    """
    first, turns = hands[0] if hands else (0, np.broadcast_to(np.eye(3), (len(vertices), 3, 3)))
    side = np.zeros_like(tangent)
    side[:, first] = _square_to(turns @ np.cross(tangent[0, first], [0.3, 0.2, 1.0]), tangent[:, first])
    for way in (1, -1):  # carried along without twist
        for i in range(first + way, vertices.shape[1] if way > 0 else -1, way):
            side[:, i] = _square_to(side[:, i - way], tangent[:, i])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(vertices[0], axis=0), axis=1))])
    for held, turns in hands[1:]:
        own, along = turns @ side[0, held], tangent[:, held]
        sine, cosine = np.einsum("td,td->t", np.cross(side[:, held], own), along), np.einsum("td,td->t", side[:, held], own)
        angle = np.unwrap(np.arctan2(sine, cosine))
        twist = (angle[:, None] * np.clip((arc - arc[first]) / (arc[held] - arc[first]), 0, 1))[..., None]
        side = np.cos(twist) * side + np.sin(twist) * np.cross(tangent, side)
    return side


def _square_to(vectors, ways):
    """(..., 3) ``vectors`` without what lies along unit ``ways``, at length 1."""
    return _unit(vectors - np.einsum("...d,...d->...", vectors, ways)[..., None] * ways)


def _unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _hand(body, hand, held):
    elbow = (0.1 * np.cos(hand.arm), 0.1 * np.sin(hand.arm), 0.16)
    if not (body.resolved and body.dim == 2):
        return Hand(elbow=elbow)
    corners = body.vertices[held] - hand.grip
    low, high = corners.min(axis=0), corners.max(axis=0)
    return Bar((*(high - low)[:2] / 2 + BAR_RIM, BAR_HEIGHT), tuple((low + high) / 2), elbow)


def _seen(cameras, body, skin, faces, hands, motion, points, facing):
    """(cameras, T, P) whether each point is in the picture, not at grazing incidence, and nothing is before it."""
    meshes = [hand.mesh() for hand in hands]
    counts = np.cumsum([skin.shape[1], *(len(vertices) for vertices, _ in meshes)])
    everything = np.concatenate([faces, *(f + n for (_, f), n in zip(meshes, counts, strict=False))])
    result = np.zeros((len(cameras), *points.shape[:2]), bool)
    for t in range(len(points)):
        fists = [to_world(v @ motion.rotation[h, t].T + motion.position[h, t]) for h, (v, _) in enumerate(meshes)]
        scene = np.concatenate([skin[t], *fists])
        for c, camera in enumerate(cameras):
            near = rasterise(camera, scene, everything).depth
            pixel, depth = camera.project(points[t])
            column, row = np.round(pixel).astype(int).T
            inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
            column, row = np.clip(column, 0, camera.width - 1), np.clip(row, 0, camera.height - 1)
            ray = camera.camera_to_world[:3, 3] - points[t]
            cosine = np.einsum("nd,nd->n", facing[t], ray) / np.linalg.norm(ray, axis=1)
            cosine = np.abs(cosine) if body.dim == 2 else cosine  # a cloth is seen from both sides
            slope = depth / camera.intrinsics[0, 0] / np.maximum(cosine, 0.2)
            result[c, t] = inside & (cosine > 0.2) & (depth < near[row, column] + slope + 0.003)
    return result


def _chosen(start, seen, tracker, rng):
    """Indices of the tracked and of the other surface points of frame 0, and their least distance [m]."""
    if tracker.partial:
        way = rng.normal(size=2)
        level = start[:, :2] @ way
        seen = seen & (level > np.quantile(level, tracker.partial))
    candidates = np.flatnonzero(seen)
    low, high = 1e-4, 0.05
    for _ in range(14):  # the distance that leaves as many as are wanted
        middle = np.sqrt(low * high)
        count = len(thin(start[candidates], middle))
        low, high = (middle, high) if count > tracker.tracks else (low, middle)
    tracked = candidates[thin(start[candidates], high)]
    everything = np.concatenate([tracked, np.flatnonzero(~seen)])
    kept = thin(start[everything], high)
    return tracked, everything[kept[kept >= len(tracked)]], high


def _hide(visible, points, tracker, rng):
    """Visibility after regions are hidden for a while and tracks are lost for good."""
    visible = visible.copy()
    length = len(visible)
    for _ in range(tracker.hidden):
        radius, duration = tracker.hiding
        begin = int(rng.integers(3, max(length - duration, 4)))
        centre = points[begin, rng.integers(points.shape[1])]
        near = np.linalg.norm(points[begin] - centre, axis=1) < radius
        visible[begin : begin + duration, near] = False
    lost = np.flatnonzero(rng.random(points.shape[1]) < tracker.lost)
    for track, begin in zip(lost, rng.integers(2, length, len(lost)), strict=True):
        visible[begin:, track] = False
    return visible


def _slid(points, tracked, faults, rng):
    """(T, N, 3) the tracked points; of a share of them what lies farther and farther along the surface."""
    truth = points[:, tracked].copy()
    if not faults.drift_share:
        return truth
    (rng,) = rng.spawn(1)  # what is drawn afterwards is the same with and without this fault
    share = np.linspace(0, 1, len(points))[:, None] ** 1.2
    for track in np.flatnonzero(rng.random(len(tracked)) < faults.drift_share):
        distance = np.linalg.norm(points[0] - points[0, tracked[track]], axis=1)
        end = np.argmin(np.abs(distance - rng.uniform(0.4, 1) * faults.drift_most) + 1e-3 * rng.random(len(distance)))
        truth[:, track] = (1 - share) * truth[:, track] + share * points[:, end]
    return truth


def _moved(points, owner, cameras, faults):
    """``points`` (T, N, 3) as a camera with a wrong pose reports them; shape priors (owner -1) err as the cameras do on the whole."""
    from scipy.spatial.transform import Rotation

    middle = np.array([0, 0, -0.13])
    wrong = Rotation.from_rotvec(faults.camera_turn).apply((points - middle).reshape(-1, 3)).reshape(points.shape) + middle
    wrong = wrong + np.array(faults.camera_shift)
    chosen = np.ones(len(owner), bool) if faults.camera < 0 else owner == faults.camera
    return np.where(chosen[:, None], wrong, points)


def _drift(shape, deviation, rng):
    """(T, N, 3) a first-order autoregression that starts at nothing, as a track does."""
    drift = np.zeros(shape)
    for t in range(1, shape[0]):
        drift[t] = RHO * drift[t - 1] + deviation * np.sqrt(1 - RHO**2) * rng.standard_normal(shape[1:])
    return drift


def _interior(body, vertices, shell, spacing, rng):
    if body.dim < 3:
        return np.zeros((0, 3))
    inside = Attached.sample(body.elements, vertices[0], CANDIDATES // 2, rng).at(vertices)[0]
    kept = thin(np.concatenate([shell, inside]), 1.2 * spacing)
    return inside[kept[kept >= len(shell)] - len(shell)]


def _controllers(hands, motion, tracker, faults, rng):
    """(T, C, 3) points of the fists, near the grips."""
    result = []
    for index, hand in enumerate(hands):
        vertices, faces = hand.fist()
        local = Attached.sample(faces, vertices, 600, rng).at(vertices[None])[0]
        held = motion.vertices[0, motion.gripped[index]] - motion.position[index, 0]
        near = np.argsort(np.linalg.norm(local[:, None] - held, axis=2).min(axis=1))[:300]
        count = max(tracker.hand, round(2 * hand.radii[1] / BAR_POINTS)) if isinstance(hand, Bar) else tracker.hand
        local = local[near][spread(local[near], count)] + np.array(faults.grip_shift)
        moved = np.einsum("tij,nj->tni", motion.rotation[index], local) + motion.position[index][:, None]
        late = np.maximum(np.arange(len(moved)) - faults.delay, 0)
        noise = 0.5 * tracker.noise * rng.standard_normal(moved.shape)
        result.append(to_world(moved)[late] + noise)
    return rounded(np.concatenate(result, axis=1))


def _colors(rest, rng):
    """(N, 3) a smooth pattern of the material, so that colour tells where."""
    phase = rest @ rng.normal(0, 25, (3, 3)) + rng.uniform(0, 2 * np.pi, 3)
    return rounded(0.5 + 0.4 * np.sin(phase))
