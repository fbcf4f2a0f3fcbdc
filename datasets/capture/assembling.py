"""From what each camera saw to one body, its hands and its shape."""

from __future__ import annotations

import numpy as np

from ..perception.hands import find_hands
from ..perception.hull import visual_hull
from ..scenario import Camera, Scenario, Split
from .fusing import fuse
from .lifting import Filters, motion_agrees, not_alone, resampled

__all__ = ["assembled"]

FEW = 20  # points with which a body can be followed at all


def assembled(name, recording, timing, sights, options):
    """The recording as one body and its hands, and the residual (T,) of the hands' rigid motion."""
    times = timing.times
    thing, hands = [], []
    for number, sight in enumerate(sights):
        known = sight.known & ~timing.missing[number][:, None]
        points, known = resampled(sight.points, known, times + timing.lags[number], times)
        for part, chosen in ((thing, ~sight.hand), (hands, sight.hand)):
            part.append((points[:, chosen], known[:, chosen], sight.colors[:, chosen]))
    points, known, colors = (np.concatenate(parts, axis=1) for parts in zip(*thing, strict=True))
    known &= _belongs(points, known, sights, options.filters.scaled(recording.cameras[0].intrinsics[0, 0], 0.7))
    if known[0].sum() < FEW:
        raise ValueError(
            f"recording {recording.name}: at least {FEW} points of the object must have depth in frame 0, got {known[0].sum()}"
        )
    body = fuse(points, known, colors, spacing=options.spacing)
    points, ground = body.points, recording.ground
    if ground is not None:
        points = points - np.minimum(ground.height(points), 0)[..., None] * ground.normal
        points[~body.visible] = 0
    lags = timing.lags * ~timing.missing
    hand_points, hand_known, _ = (np.concatenate(parts, axis=1) for parts in zip(*hands, strict=True))
    clouds = [np.concatenate([s.hand_at(t, lags[c, t], timing.fps) for c, s in enumerate(sights)]) for t in range(len(times))]
    clouds = [cloud[not_alone(cloud, Filters(alone=5))] for cloud in clouds]
    held = find_hands(hand_points, hand_known, clouds, points[0])
    surface, interior = np.zeros((0, 3)), np.zeros((0, 3))
    if options.shape == "hull":
        cameras = tuple(Camera(c.intrinsics, c.camera_to_world, c.width, c.height) for c in recording.cameras)
        first = [np.stack(parts) for parts in zip(*((s.object[0], s.hand_mask[0], s.depth) for s in sights), strict=True)]
        hull = visual_hull(cameras, *first, points[0], ground)
        surface, interior = hull.surface, hull.interior
    order = np.lexsort(points[0].T[::-1])  # published cases list their points by frame-0 coordinates
    points, visible, colors = points[:, order], body.visible[:, order], body.colors[:, order]
    scenario = Scenario(
        name=name,
        points=points,
        visible=visible,
        motion_valid=motion_agrees(points, visible, options.filters),
        controllers=held.points,
        surface=surface,
        interior=interior,
        colors=np.clip(colors, 0, 1),
        fps=timing.fps,
        gravity=recording.gravity,
        ground=ground,
        object=options.object or name,
        session=recording.name,
        self_collision=options.self_collision,
        cameras=tuple(Camera(c.intrinsics, c.camera_to_world, c.width, c.height) for c in recording.cameras),
        split=Split(max(int(options.train * len(times)), 2), len(times)),
    )
    return scenario, held.residual


def _belongs(points, known, sights, filters):
    """(T, P) bool: enough of the object, as all cameras see it, is around a point: the published filter of outliers."""
    from scipy.spatial import cKDTree

    found = np.zeros(known.shape, bool)
    for t in range(len(points)):
        cloud, chosen = np.concatenate([sight.cloud_at(t) for sight in sights]), np.flatnonzero(known[t])
        if len(cloud) and len(chosen):
            counts = cKDTree(cloud).query_ball_point(points[t, chosen], filters.within, return_length=True)
            found[t, chosen] = counts >= filters.alone
    return found
