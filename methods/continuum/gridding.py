"""The grid around what a body fills, and points spread over its skin."""

from __future__ import annotations

import numpy as np

from ...physics.grids import Grid, embed, principal_axes
from .inside import Inside

__all__ = ["box_axes", "grid_of", "spread_over"]

CELLS = 48  # that a body has at least, about: a chunky one in cells as thick as itself would be too coarse
SLIVER = 0.1  # see ``embed``
MOST_CELLS = 20_000  # that are simulated at all
LAYERS = 4  # samples across a cell
LESS = 0.98  # of the box around a body along its principal axes, that is worth turning them
CROWD = 10  # random points on the skin for each that is kept


def grid_of(inside: Inside, pitch: float | None = None, where: str = "") -> tuple[Grid, np.ndarray]:
    """The grid and the (P, 3) samples [m] of the inside that it was built from.

    pitch  edge of a cell [m]; unless given about the thickness, since one layer bends right, or what makes 48 cells if that is less. Cells
           are about as large: whole ones span the body, so that none at its ends is a sliver. ``where`` ends the message of a ValueError
           for a pitch that is far too small or too large
    """
    pitch = min(inside.thickness, (inside.volume / CELLS) ** (1 / 3)) if pitch is None else pitch
    if (count := inside.volume / pitch**3) > MOST_CELLS:
        raise ValueError(f"pitch must be larger: {count:.0f} cells of {1e3 * pitch:g} mm are more than {MOST_CELLS}{where}")
    axes = box_axes(inside.corners)
    samples = inside.lattice(pitch / LAYERS, axes)
    if len(samples) < 2 * LAYERS**2:
        raise ValueError(f"pitch must be smaller: cells of {1e3 * pitch:g} mm are larger than the body{where}")
    extent = np.ptp(samples @ axes.T, axis=0) + (inside.volume / len(samples)) ** (1 / 3)  # a sample is the middle of its share
    size = extent / np.maximum(np.rint(extent / pitch), 1)
    return embed(samples, inside.volume, size, axes=axes, sliver=SLIVER), samples


def box_axes(points) -> np.ndarray:
    """(3, 3) rows, the principal axes of ``points`` (P, 3), turned about the first such that the box around them is the least.

    Only where that saves 2 %: principal axes of a square section say nothing.
    """
    axes = principal_axes(points)
    across = points @ axes[1:].T
    angles = np.radians(np.arange(90))
    turned = [(np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])) for a in angles]
    area = np.array([np.ptp(across @ turn.T, axis=0).prod() for turn in turned])
    best = turned[int(area.argmin())]
    if area.min() > LESS * area[0]:
        return axes
    second, third = best @ axes[1:]
    if np.ptp(points @ second) < np.ptp(points @ third):
        second, third = third, -second
    return np.stack([axes[0], second, third])


def spread_over(inside: Inside, distance: float) -> np.ndarray:
    """(S, 3) m, points on the skin that are at least ``distance`` [m] apart and leave no gap."""
    from scipy.spatial import cKDTree

    points = inside.skin(int(CROWD * max(20, inside.area / distance**2)))
    free, kept = np.ones(len(points), bool), []
    for i, near in enumerate(cKDTree(points).query_ball_point(points, distance)):
        if free[i]:
            kept.append(i)
            free[near] = False
    return points[kept]
