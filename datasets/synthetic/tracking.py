"""From images and moving meshes to what a published case holds: tracked points, hand points, annotated tracks, a shape prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scenario import Camera
from .hand import Hand
from .render import normals
from .sensor import Scene, Sensor, View
from .simulate import Motion, to_world

__all__ = ["Attached", "Footage", "annotate", "film", "hand_points", "measure", "rounded", "spread", "thin"]

HANDS = 30  # controller points of a published case
ANNOTATED = 9  # ground-truth tracks of a published case
GRASP = 0.03  # a hand point that close to a held vertex can be a controller [m]
GRID = 2.0**-14  # positions are rounded to this, far below the noise, so that the files pack well [m]


@dataclass(frozen=True)
class Attached:
    """Points that ride on a mesh: barycentric ``weights`` (P, K) of the vertices ``nodes`` (P, K)."""

    nodes: np.ndarray
    weights: np.ndarray

    @classmethod
    def sample(cls, elements: np.ndarray, vertices: np.ndarray, count: int, rng: np.random.Generator) -> Attached:
        """``count`` points, uniform over triangles (F, 3) or tetrahedra (E, 4) of ``vertices`` (V, 3)."""
        edges = vertices[elements[:, 1:]] - vertices[elements[:, :1]]
        size = np.sqrt(np.maximum(np.linalg.det(edges @ np.swapaxes(edges, 1, 2)), 0))
        chosen = rng.choice(len(elements), count, p=size / size.sum())
        return cls(elements[chosen], rng.dirichlet(np.ones(elements.shape[1]), count))

    def at(self, values: np.ndarray) -> np.ndarray:
        """Vertex ``values`` (T, V, 3) at the points: (T, P, 3)."""
        return np.einsum("pk,tpkd->tpd", self.weights, values[:, self.nodes])


@dataclass(frozen=True)
class Footage:
    """What all cameras of a ``sensor`` took: views[camera][frame]."""

    sensor: Sensor
    cameras: tuple[Camera, ...]
    views: list[list[View]]

    def images(self, kind: str) -> list[list[np.ndarray]]:
        """[camera][frame] of one kind: color, depth, mask or hand."""
        return [[getattr(view, kind) for view in taken] for taken in self.views]

    def sees(self, points: np.ndarray, facing: np.ndarray, kind: str) -> np.ndarray:
        """Which ``points`` (F, P, 3) with normals ``facing`` each camera follows, inside its masks ``kind``, from frame 0: (C, F, P)."""
        instants = range(len(points))
        seen = [
            [self.sensor.sees(camera, taken[t], points[t], facing[t], getattr(taken[t], kind)) for t in instants]
            for camera, taken in zip(self.cameras, self.views, strict=True)
        ]
        return np.array(seen)

    def colors(self, points: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """RGB (T, N, 3) in [0, 1] of ``points`` from the first camera that sees each, by ``seen`` (cameras, T, N); 0 where none does."""
        colors = np.zeros(points.shape)
        for camera, taken, found in reversed(list(zip(self.cameras, self.views, seen, strict=True))):
            for t, view in enumerate(taken):
                column, row = np.round(camera.project(points[t, found[t]])[0]).astype(int).T
                colors[t, found[t]] = view.color[row, column] / 255
        return colors


def film(sensor: Sensor, scenes: list[Scene], rng: np.random.Generator) -> Footage:
    """Take every scene with every camera."""
    cameras = sensor.cameras()
    patterns = [sensor.pattern(rng) for _ in cameras]
    return Footage(sensor, cameras, [[sensor.take(c, scene, p) for scene in scenes] for c, p in zip(cameras, patterns, strict=True)])


def thin(points: np.ndarray, spacing: float) -> np.ndarray:
    """Indices, rising, of a subset of ``points`` (P, 3) with no two nearer than ``spacing``: earlier points win."""
    from scipy.spatial import cKDTree

    free = np.ones(len(points), bool)
    kept = []
    for i, near in enumerate(cKDTree(points).query_ball_point(points, spacing)):
        if free[i]:
            kept.append(i)
            free[near] = False
    return np.array(kept, int)


def measure(points: np.ndarray, sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """What a tracker reports of true ``points``; nothing is reported below the table, as in published cases."""
    noisy = points + sensor.track_noise * rng.standard_normal(points.shape)
    return rounded(np.minimum(noisy, [np.inf, np.inf, 0]))


def rounded(points: np.ndarray) -> np.ndarray:
    """``points`` on the grid of positions that are written."""
    return np.round(points / GRID) * GRID


def hand_points(hand: Hand, motion: Motion, footage: Footage, rng: np.random.Generator) -> np.ndarray:
    """(T, 30, 3) points of the fist near the held vertices, seen in frame 0 and spread out; measured like the body's."""
    vertices, faces = hand.fist()
    points = Attached.sample(faces, vertices, 4000, rng)
    local, facing = points.at(np.array([vertices, normals(vertices, faces)]))
    world = to_world(np.einsum("tij,nj->tni", motion.hand_rotation, local) + motion.hand_position[:, None])
    seen = footage.sees(world[:1], to_world(facing)[None], "hand")[:, 0].any(axis=0)
    held = motion.vertices[0, motion.gripped] - motion.hand_position[0]
    distance = np.linalg.norm(local[:, None] - held, axis=2).min(axis=1)
    chosen = np.flatnonzero(seen & (distance < GRASP))
    if len(chosen) < HANDS:
        raise ValueError(f"the cameras must see {HANDS} hand points near the grip in frame 0, they see {len(chosen)}")
    return measure(world[:, chosen[spread(world[0, chosen], HANDS)]], footage.sensor, rng)


def annotate(points: np.ndarray, seen: np.ndarray, sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """(T, 9, 3) of the ``points`` (T, N, 3) that camera 0 sees in frame 0; NaN where it does not see them later, by ``seen`` (T, N)."""
    start = np.flatnonzero(seen[0])
    if len(start) < ANNOTATED:
        raise ValueError(f"camera 0 must see {ANNOTATED} tracked points in frame 0 to annotate, it sees {len(start)}")
    chosen = start[spread(points[0, start], ANNOTATED)]
    return np.where(seen[:, chosen, None], measure(points[:, chosen], sensor, rng), np.nan)


def spread(points, count):
    """Farthest-point sampling of ``count`` indices from index 0."""
    chosen, distance = [0], np.full(len(points), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return np.array(chosen)
