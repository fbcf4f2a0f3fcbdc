"""How far what was built from the studio's pictures is from the truth: masks, tracks, points, hands, shape and clocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..datasets import needs_open3d
from ..datasets.capture.build import Built
from ..datasets.synthetic.studio import Take, hand_motion
from ..datasets.synthetic.tracking import Attached

__all__ = ["Score", "material_points", "score"]

SAMPLES = 4000  # points on the true skin


@dataclass(frozen=True)
class Score:
    """Errors of one built case.

    mask_iou, hand_iou  mean over cameras and frames in which there is anything to see
    track_px            median distance of visible tracks from the truth [pixel], of points that truly started on the object
    point_mm            median distance of visible points from the truth [mm]; ``last_mm`` in the last frame alone
    alive               share of the points that are seen in the last frame
    hand_mm             median distance of controllers from the true hand's motion of the same points [mm]
    seen_mm             mean distance of the tracked points of frame 0 from the true skin [mm]
    completed_mm        mean distance between the true skin and tracked and surface points of frame 0, both ways [mm]
    clock_ms            largest error of a clock's offset against camera 0's [ms]
    """

    mask_iou: float
    hand_iou: float
    track_px: float
    point_mm: float
    last_mm: float
    alive: float
    hand_mm: float
    seen_mm: float
    completed_mm: float
    clock_ms: float


def score(take: Take, built: Built) -> Score:
    """``built`` of ``take.recording`` against ``take.truth``. Cameras that were not used are left out."""
    truth, scenario, timing = take.truth, built.scenario, built.timing
    assert timing is not None  # of several cameras
    names = [camera.name for camera in take.recording.cameras]
    used = [names.index(one.name) for one in built.quality.cameras]
    frames = timing.frames
    ious = {kind: [] for kind in ("mask", "hand")}
    for number, camera in enumerate(used):
        for t, frame in enumerate(frames[number]):
            shot, sight = truth.shots[camera][frame], built.sights[number]
            for kind, found, true in (("mask", sight.object[t], shot.mask), ("hand", sight.hand_mask[t], shot.hand)):
                if (either := (found | true).sum()) > 0:
                    ious[kind].append((found & true).sum() / either)
    pixels = [_track_errors(truth, built.sights[number], camera, frames[number]) for number, camera in enumerate(used)]
    times = truth.instants[used[0], frames[0]]
    points = _point_errors(truth, scenario, times)
    hands = scenario.controllers - hand_motion(truth.motion, scenario.controllers[0], times)
    seen, completed = _shape(truth, scenario, times[0])
    offsets: list[Any] = [clock.offset for clock in timing.clocks]  # clocks of the studio have one
    clocks = [1000 * abs((o - offsets[0]) - (truth.clocks[c] - truth.clocks[used[0]])) for o, c in zip(offsets, used, strict=True)]
    last = points[-1][np.isfinite(points[-1])]
    return Score(
        float(np.mean(ious["mask"])),
        float(np.mean(ious["hand"])),
        float(np.median(np.concatenate(pixels))),
        1000 * float(np.nanmedian(points)),
        1000 * float(np.median(last)) if len(last) else float("nan"),
        float(scenario.visible[-1].mean()),
        1000 * float(np.median(np.linalg.norm(hands, axis=2))),
        1000 * seen,
        1000 * completed,
        max(clocks),
    )


def _track_errors(truth, sight, camera, frames):
    """Pixels between visible tracks and where the material under their first pixel truly is."""
    first = truth.shots[camera][frames[0]]
    column, row = np.round(sight.pixels[0]).astype(int).T
    chosen = np.flatnonzero(~sight.hand & (first.face[row, column] >= 0))
    faces, weights = first.face[row[chosen], column[chosen]], first.weights[row[chosen], column[chosen]]
    true = truth.points(faces, weights, truth.instants[camera, frames])
    pixels, _ = truth.cameras[camera].project(true)
    return np.linalg.norm(pixels - sight.pixels[:, chosen], axis=2)[1:][sight.visible[1:, chosen]]


def _skin(truth, time):
    o3d = needs_open3d.imported("scoring built shapes")

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    vertices = truth.vertices(time).astype(np.float32)
    scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(truth.faces.astype(np.uint32)))
    return scene, o3d


def material_points(truth, start: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(T, N, 3) world positions at true ``times`` (T,) of the points of the skin that are nearest to ``start`` (N, 3) in the first."""
    scene, o3d = _skin(truth, times[0])
    found = scene.compute_closest_points(o3d.core.Tensor(start.astype(np.float32)), nthreads=1)
    u, v = found["primitive_uvs"].numpy().astype(float).T
    return truth.points(found["primitive_ids"].numpy().astype(int), np.stack([1 - u - v, u, v], 1), times)


def _point_errors(truth, scenario, times):
    """(T, N) m; NaN where not visible. A point is meant to be the skin's nearest to it in frame 0, and moves as that does."""
    true = material_points(truth, scenario.points[0], times)
    return np.where(scenario.visible, np.linalg.norm(true - scenario.points, axis=2), np.nan)


def _shape(truth, scenario, time):
    from scipy.spatial import cKDTree

    scene, o3d = _skin(truth, time)
    outside = np.concatenate([scenario.points[0], scenario.surface])
    off = scene.compute_distance(o3d.core.Tensor(outside.astype(np.float32)), nthreads=1).numpy()
    true = Attached.sample(truth.faces, truth.vertices(time), SAMPLES, np.random.default_rng(0)).at(truth.vertices(time)[None])[0]
    back = cKDTree(outside).query(true)[0]
    return float(off[: len(scenario.points[0])].mean()), float((off.mean() + back.mean()) / 2)
