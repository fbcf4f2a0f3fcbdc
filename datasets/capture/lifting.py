"""From pixels to points in the world: depth at tracks, clouds of masks, and the filters of the published pipeline.

Constants are PhysTwin's (``data_process``), given for cameras of 848 x 480: numbers of neighbours scale with the pixels that see an area.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..perception.base import Clip, Masks, Tracks
from ..scenario import Camera

__all__ = ["Filters", "cloud_of", "lift_tracks", "motion_agrees", "not_alone", "resampled", "solid_depth", "to_points"]

PUBLISHED_FOCAL = 430.0  # pixels, of 848 x 480: what neighbour counts are meant for


@dataclass(frozen=True)
class Filters:
    """What is dropped, with the published constants as defaults.

    near, far         depths that count [m]
    alone, within     a point of a cloud with fewer than ``alone`` others within ``within`` [m] is an outlier
    radius            neighbours of a track in a frame are that near [m]
    few, agree, share a motion is dropped where fewer than ``few`` neighbours have one, or fewer than ``share`` of them within ``agree`` [m]
    jump              a pixel whose 3 x 3 neighbours differ in depth by more than this [m] may fly (not published)
    """

    near: float = 0.2
    far: float = 1.5
    alone: int = 40
    within: float = 0.01
    radius: float = 0.01
    few: int = 5
    agree: float = 0.005
    share: float = 0.5
    jump: float = 0.012

    def scaled(self, focal: float, distance: float) -> Filters:
        """The same for cameras of ``focal`` pixels: (focal / distance)^2 pixels see an area; the published ones were 0.7 m away."""
        density = (focal / distance / (PUBLISHED_FOCAL / 0.7)) ** 2
        return replace(self, alone=max(round(self.alone * min(density, 1.0)), 3))


def to_points(camera: Camera, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(..., 3) world points [m] of ``pixels`` (..., 2) at ``depth`` (...,) [m]."""
    local = np.concatenate([pixels, np.ones_like(pixels[..., :1])], -1) @ np.linalg.inv(camera.intrinsics).T * depth[..., None]
    return local @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3]


def solid_depth(depth: np.ndarray, mask: np.ndarray, filters: Filters) -> np.ndarray:
    """``depth`` (H, W) [m] of ``mask`` alone, 0 where it is out of range or may fly between foreground and background."""
    from scipy.ndimage import maximum_filter, minimum_filter

    good = mask & (depth > filters.near) & (depth < filters.far)
    high = maximum_filter(np.where(good, depth, -np.inf), 3)
    low = minimum_filter(np.where(good, depth, np.inf), 3)
    with np.errstate(invalid="ignore"):
        return np.where(good & (high - low <= filters.jump), depth, 0.0)


def cloud_of(clip: Clip, mask: np.ndarray, frame: int, filters: Filters) -> tuple[np.ndarray, np.ndarray]:
    """World points (K, 3) of ``mask`` (H, W) in one frame, and their colours (K, 3) in [0, 1]."""
    depth = solid_depth(clip.depths[frame], mask, filters)
    rows, columns = np.nonzero(depth)
    points = to_points(clip.camera, np.stack([columns, rows], 1).astype(float), depth[rows, columns].astype(float))
    return points, clip.colors[frame][rows, columns] / 255


def not_alone(points: np.ndarray, filters: Filters) -> np.ndarray:
    """(K,) bool: which of ``points`` (K, 3) are no outliers."""
    from scipy.spatial import cKDTree

    if not len(points):
        return np.zeros(0, bool)
    counts = cKDTree(points).query_ball_point(points, filters.within, return_length=True)
    return counts - 1 >= min(filters.alone, max(len(points) // 4, 1))


def lift_tracks(clip: Clip, masks: Masks, tracks: Tracks, filters: Filters) -> tuple[np.ndarray, np.ndarray]:
    """World positions (T, P, 3) [m] of ``tracks`` and where they are known (T, P) bool: visible, in their mask, with sound depth."""
    length, count = tracks.visible.shape
    points, known = np.zeros((length, count, 3)), np.zeros((length, count), bool)
    for t in range(length):
        for part, mask in ((~tracks.hand, masks.object[t]), (tracks.hand, masks.hand[t])):
            chosen = np.flatnonzero(part & tracks.visible[t])
            depth = _depth_at(solid_depth(clip.depths[t], mask, filters), tracks.pixels[t, chosen])
            good = depth > 0
            points[t, chosen[good]] = to_points(clip.camera, tracks.pixels[t, chosen[good]], depth[good])
            known[t, chosen[good]] = True
    return points, known


def _depth_at(depth, pixels):
    """(P,) mean of the sound depths among the four pixels around each, weighted as between them; 0 where those weigh less than half."""
    height, width = depth.shape
    low = np.floor(pixels).astype(int)
    share = pixels - low
    total, weight = np.zeros(len(pixels)), np.zeros(len(pixels))
    for right in (0, 1):
        for down in (0, 1):
            column, row = low[:, 0] + right, low[:, 1] + down
            inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
            value = np.where(inside, depth[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], 0)
            part = np.where(right, share[:, 0], 1 - share[:, 0]) * np.where(down, share[:, 1], 1 - share[:, 1]) * (value > 0)
            total, weight = total + part * value, weight + part
    return np.where(weight >= 0.5, total / np.maximum(weight, 1e-9), 0)


def motion_agrees(points: np.ndarray, known: np.ndarray, filters: Filters) -> np.ndarray:
    """(T, P) bool: entry t says whether the motion t -> t + 1 is known and like its neighbours'; the last row is False."""
    from scipy.spatial import cKDTree

    valid = np.zeros(known.shape, bool)
    for t in range(len(points) - 1):
        chosen = np.flatnonzero(known[t] & known[t + 1])
        if len(chosen) <= filters.few:
            continue
        start, step = points[t, chosen], points[t + 1, chosen] - points[t, chosen]
        pairs = cKDTree(start).query_pairs(filters.radius, output_type="ndarray")
        alike = np.linalg.norm(step[pairs[:, 0]] - step[pairs[:, 1]], axis=1) < filters.agree
        near = np.ones(len(chosen)) + np.bincount(pairs.ravel(), minlength=len(chosen))
        same = np.ones(len(chosen)) + np.bincount(pairs[alike].ravel(), minlength=len(chosen))
        valid[t, chosen] = (near >= filters.few) & (same >= filters.share * near)
    return valid


def resampled(points: np.ndarray, known: np.ndarray, times: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, P, 3) seen at ``times`` (T,) as they were at ``wanted`` (T,), along straight lines between known neighbours in time.

    A row with no known neighbour on the other side is moved by the velocity on its own side; where there is none either, it is left as it
    is if times differ by less than 1 ms, and else not known.
    """
    moved, found = points.copy(), known.copy()
    for t in range(len(times)):
        late = wanted[t] - times[t]
        if late == 0:
            continue
        ahead, back = min(t + 1, len(times) - 1), max(t - 1, 0)
        first, second = (ahead, back) if late > 0 else (back, ahead)
        done = np.zeros(known.shape[1], bool)
        for other in (first, second):
            if times[other] != times[t]:  # a camera that lost a picture shows the one before again
                usable = known[t] & known[other] & ~done
                velocity = (points[other, usable] - points[t, usable]) / (times[other] - times[t])
                moved[t, usable] = points[t, usable] + late * velocity
                done |= usable
        found[t] = known[t] & (done | (abs(late) < 1e-3))
    return moved, found
