"""What one camera contributes: its masks, its tracks in the world, and clouds of object and hands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..perception.base import Clip, Masks, Tracks
from .lifting import Filters, cloud_of, lift_tracks, solid_depth

__all__ = ["Sight", "look"]


@dataclass(frozen=True)
class Sight:
    """One camera's part, arrays only, so that it can be kept.

    object, hand_mask  (T, H, W) bool
    pixels, visible    (T, P, 2), (T, P) of the tracks; ``hand`` (P,) bool: on a hand
    points, known      (T, P, 3) world metres, (T, P) bool; ``colors`` (T, P, 3) in [0, 1]
    cloud, counts      (K, 3) float32 points of the object, frame after frame, (T,) how many each; ``hand_cloud``, ``hand_counts`` likewise
    depth              (H, W) metres of frame 0, sound pixels of object and hands, and all others as they are
    noise              scatter of depth on the empty part of frame 0 against a plane around each pixel, median [m]
    """

    object: np.ndarray
    hand_mask: np.ndarray
    pixels: np.ndarray
    visible: np.ndarray
    hand: np.ndarray
    points: np.ndarray
    known: np.ndarray
    colors: np.ndarray
    cloud: np.ndarray
    counts: np.ndarray
    hand_cloud: np.ndarray
    hand_counts: np.ndarray
    depth: np.ndarray
    noise: np.ndarray

    def cloud_at(self, frame: int) -> np.ndarray:
        """(K, 3) points of the object."""
        return _part(self.cloud, self.counts, frame)

    def hand_at(self, frame: int, lag: float, fps: float) -> np.ndarray:
        """(K, 3) points of hands, moved back by the hand's velocity to where they were ``lag`` seconds before."""
        cloud = _part(self.hand_cloud, self.hand_counts, frame)
        other = frame + 1 if frame + 1 < len(self.known) else frame - 1
        both = self.hand & self.known[frame] & self.known[other]
        if both.sum() < 5 or not len(cloud):
            return cloud
        velocity = np.median(self.points[other, both] - self.points[frame, both], axis=0) * fps * (other - frame)
        return cloud - lag * velocity


def _part(cloud, counts, frame):
    end = int(counts[: frame + 1].sum())
    return cloud[end - int(counts[frame]) : end].astype(float)


def look(clip: Clip, masks: Masks, tracks: Tracks, filters: Filters) -> Sight:
    """Lift what was found in the pictures of one camera."""
    points, known = lift_tracks(clip, masks, tracks, filters)
    colors = np.zeros(points.shape, np.float32)
    height, width = masks.object.shape[1:]
    clouds, hand_clouds = [], []
    for t in range(len(points)):
        column, row = np.round(tracks.pixels[t, known[t]]).astype(int).T
        colors[t, known[t]] = clip.colors[t][np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)] / 255
        clouds.append(cloud_of(clip, masks.object[t], t, filters)[0])
        hand_clouds.append(cloud_of(clip, masks.hand[t], t, filters)[0])
    both = masks.object[0] | masks.hand[0]
    depth = np.where(both, solid_depth(clip.depths[0], both, filters), clip.depths[0])
    return Sight(
        masks.object,
        masks.hand,
        tracks.pixels,
        tracks.visible,
        tracks.hand,
        points,
        known,
        colors,
        np.concatenate(clouds).astype(np.float32),
        np.array([len(c) for c in clouds]),
        np.concatenate(hand_clouds).astype(np.float32),
        np.array([len(c) for c in hand_clouds]),
        depth.astype(np.float32),
        np.array(_scatter(clip.depths[0], both)),
    )


def _scatter(depth, standing):
    """Median over the empty pixels of the residual of depth against the mean of its four neighbours, as a standard deviation [m]."""
    inner = depth[1:-1, 1:-1]
    around = np.stack([depth[:-2, 1:-1], depth[2:, 1:-1], depth[1:-1, :-2], depth[1:-1, 2:]])
    good = (inner > 0) & (around > 0).all(0) & ~standing[1:-1, 1:-1]
    if not good.any():
        return np.nan
    return 1.4826 * np.median(np.abs(inner - around.mean(0))[good]) / np.sqrt(1.25)  # of independent errors; alike ones scatter less
