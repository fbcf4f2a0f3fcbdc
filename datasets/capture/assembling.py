"""From what each camera saw to one body, its hands and its shape."""

from __future__ import annotations

import numpy as np

from ..perception.hands import find_hands
from ..perception.hull import visual_hull
from ..scenario import Camera, Scenario, Split
from .fusing import fuse
from .lifting import Filters, motion_agrees, not_alone, resampled
from .prior import place_prior, read_mesh

__all__ = ["assembled"]

FEW = 20  # points with which a body can be followed at all


def assembled(name, recording, timing, sights, options):
    """The recording as one body and its hands, the residual (T,) of the hands' rigid motion, and notes on its shape."""
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
    surface, interior, notes = _shape(recording, sights, points[0], options)
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
    return scenario, held.residual, notes


def _shape(recording, sights, tracked, options):
    """Points of the body beside those that are ``tracked``, on its surface and inside, and what is to be said of them."""
    if options.shape == "none" and not options.prior:
        return np.zeros((0, 3)), np.zeros((0, 3)), []
    cameras = tuple(Camera(c.intrinsics, c.camera_to_world, c.width, c.height) for c in recording.cameras)
    masks, hidden = ([getattr(s, what)[0] for s in sights] for what in ("object", "hand_mask"))
    depths = [s.depth for s in sights]
    if not options.prior:
        hull = visual_hull(cameras, masks, hidden, depths, tracked, recording.ground, step=options.spacing)
        return hull.surface, hull.interior, []
    clouds = [s.cloud_at(0) for s in sights]
    views = cameras, masks, hidden, depths, clouds
    placed = place_prior(read_mesh(options.prior), *views, tracked=tracked, ground=recording.ground, spacing=options.spacing)
    said = f"the mesh lies {1000 * placed.final:.1f} mm from what was measured (median), {100 * placed.carved:.0f} % of it was seen through"
    return placed.hull.surface, placed.hull.interior, [said]


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
