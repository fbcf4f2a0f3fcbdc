"""Shape without a network: the part of space that no camera sees through, in frame 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scenario import Camera, Plane

__all__ = ["Hull", "visual_hull"]

LARGEST = 3_000_000  # cells: 0.7 m across in steps of 5 mm


@dataclass(frozen=True)
class Hull:
    """surface (S, 3) and interior (I, 3) points [m] of the body beside those that were tracked, on a grid of ``step`` metres."""

    surface: np.ndarray
    interior: np.ndarray
    step: float


def visual_hull(
    cameras: tuple[Camera, ...],
    masks: list[np.ndarray],
    hidden: list[np.ndarray],
    depths: list[np.ndarray],
    seen: np.ndarray,
    ground: Plane | None,
    *,
    step: float = 0.005,
    slack: float = 0.004,
    surface_count: int = 1024,
) -> Hull:
    """Grid cells in all cameras' ``masks`` (or ``hidden`` from them behind hands), behind the measured ``depths`` and above the table.

    masks, hidden (H, W) bool and depths (H, W) [m] of each camera, ``seen`` (M, 3) points of the body. A cell nearer than ``step`` to one
    of them is left out: it is there already. ``slack``: by how much a cell may lie before the measured depth [m]. A camera alone bounds
    nothing behind what it sees: there the body goes down to the table, or as deep as it is wide.
    """
    from scipy.ndimage import binary_erosion
    from scipy.spatial import cKDTree

    pad = 2 * step
    low, high = seen.min(0) - pad, seen.max(0) + pad
    if ground is not None:  # down to the table, which may be out of sight
        foot = seen - ground.height(seen)[:, None] * ground.normal
        low, high = np.minimum(low, foot.min(0)), np.maximum(high, foot.max(0))
    shape = np.ceil((high - low) / step).astype(int) + 1
    if np.prod(shape.astype(float)) > LARGEST:
        raise ValueError(f"the object must fit {LARGEST} cells of {step:g} m, got {shape.tolist()}: is depth in the right unit?")
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1) * step + low
    cells = grid.reshape(-1, 3)
    inside = np.ones(len(cells), bool)
    if ground is not None:
        inside &= ground.height(cells) > -step / 4
    width = np.sort(np.ptp(seen, axis=0))[1]
    for camera, mask, behind, depth in zip(cameras, masks, hidden, depths, strict=True):
        pixels, z = camera.project(cells)
        column, row = np.round(np.nan_to_num(pixels, nan=-1, posinf=-1, neginf=-1)).astype(int).T
        within = (z > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
        at = (np.clip(row, 0, camera.height - 1), np.clip(column, 0, camera.width - 1))
        measured = depth[at]
        object_here = mask[at] & ((measured == 0) | ((z > measured - slack) & (z < measured + width)))
        inside &= ~within | object_here | (behind[at] & ((measured == 0) | (z > measured - slack)))
    solid = inside.reshape(shape)
    core = binary_erosion(solid)
    apart = cKDTree(seen).query(cells)[0].reshape(shape) >= step
    surface, interior = grid[solid & ~core & apart], grid[core & apart]
    if len(surface) > surface_count:
        surface = surface[np.random.default_rng(0).choice(len(surface), surface_count, replace=False)]
    return Hull(surface, interior, step)
