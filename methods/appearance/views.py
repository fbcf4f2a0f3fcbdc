"""Frame 0 as its cameras see it, and the points that Gaussians start from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Camera, Observed
from .config import Config, Quirks

__all__ = ["View", "frame_zero", "starting_points"]

WIDTH = 848  # px: of the published images, at which pixels are counted


@dataclass(frozen=True)
class View:
    """One camera's frame 0. Colours outside the object are black.

    color  (H, W, 3) float32 RGB in 0..1, multiplied by the mask
    mask   (H, W) bool, the object
    human  (H, W) bool, hands and arms, widened
    depth  (H, W) float32 m, 0 where the sensor gave nothing, or None where the recording has no depth
    """

    camera: Camera
    color: np.ndarray
    mask: np.ndarray
    human: np.ndarray
    depth: np.ndarray | None


def frame_zero(observed: Observed, config: Config, quirks: Quirks, cameras: Sequence[int] | None = None) -> list[View]:
    """Frame 0 of all cameras, or of those with the given indices. Raises ValueError where there is nothing to fit."""
    where = f" (scenario {observed.name})"
    if observed.images is None or observed.images.frame_count < 1:
        raise ValueError(f"an appearance is fitted to images, and the recording has none{where}")
    if not observed.cameras:
        raise ValueError(f"an appearance needs calibrated cameras, and the recording has none{where}")
    chosen = range(len(observed.cameras)) if cameras is None else tuple(cameras)
    if not chosen or not set(chosen) <= set(range(len(observed.cameras))):
        raise ValueError(f"cameras must be some of 0 to {len(observed.cameras) - 1}, got {list(chosen)}{where}")
    views = [_view(observed, k, config, quirks) for k in chosen]
    if not any(view.mask.any() for view in views):
        raise ValueError(f"an appearance is fitted to the object, and no mask of frame 0 has a pixel of it{where}")
    return views


def _view(observed, k, config, quirks):
    images, camera = observed.images, observed.cameras[k]
    size = (camera.height, camera.width)
    color, mask = images.color(k, 0), images.mask(k, 0)
    human, depth = _given(images.human_mask, k), _given(images.depth, k)
    for name, value, shape in (("color", color, (*size, 3)), ("mask", mask, size), ("human mask", human, size), ("depth", depth, size)):
        if value is not None and value.shape != shape:
            raise ValueError(f"{name} of camera {k} must have shape {shape} as its camera, got {value.shape} (scenario {observed.name})")
    share = 1 if quirks.fixed_dilation else camera.width / WIDTH
    human = np.zeros(size, bool) if human is None else _widened(human, max(1, round(config.human_pixels * share)))
    return View(camera, color.astype(np.float32) / 255 * mask[..., None], mask, human, depth)


def _given(read, camera):
    """An image that a recording may lack."""
    try:
        return read(camera, 0)
    except ValueError:
        return None


def _widened(mask, pixels):
    """By a square of ``pixels``; one of an even number reaches a pixel farther right and down, as OpenCV's does (published)."""
    from scipy.ndimage import binary_dilation

    return binary_dilation(mask, np.ones((pixels, pixels), bool), origin=pixels % 2 - 1)


def starting_points(observed: Observed, views: Sequence[View]) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) m and their RGB (P, 3): the object's pixels lifted by their depth, and the body's surface points.

    A surface point has no colour of its own and takes that of the nearest seen one. Where no pixel can be lifted, the tracked points stand
    in for them, grey where they have no colours.
    """
    lifted = [_lifted(view) for view in views if view.depth is not None]
    points, colours = (np.concatenate(parts) for parts in zip(*lifted, strict=True)) if lifted else (np.zeros((0, 3)), np.zeros((0, 3)))
    if not len(points):
        points = observed.points[0]
        colours = np.full_like(points, 0.5) if observed.colors is None else np.nan_to_num(observed.colors[0], nan=0.5)
    if not len(observed.surface):
        return points, colours
    from scipy.spatial import cKDTree

    nearest = cKDTree(points).query(observed.surface)[1]
    return np.concatenate([points, observed.surface]), np.concatenate([colours, colours[nearest]])


def _lifted(view):
    row, column = np.nonzero(view.mask & (view.depth > 0))
    depth = view.depth[row, column].astype(float)
    pixels = np.stack([column, row, np.ones_like(row)], 1).astype(float)
    local = np.linalg.solve(view.camera.intrinsics, pixels.T).T * depth[:, None]
    pose = view.camera.camera_to_world
    return local @ pose[:3, :3].T + pose[:3, 3], view.color[row, column].astype(float)
