"""What was not seen of a solid: completed down to the ground, or mirrored, where a recording has no points of a shape prior."""

from __future__ import annotations

import warnings

import numpy as np

from ...datasets.scenario import Observed

__all__ = ["complete", "has_depth", "is_one_sided", "shortest_chord", "upwards"]

COLUMN = 1.5  # spacings: side of the columns in which layers are looked for
LAYERS = 0.5  # share of the inner columns with a second layer from which on the underside was seen
RESTING = 0.5  # of its width, below which a gap between what was seen of a body and the ground belongs to the body
LOWEST = 0.05  # quantile of heights that is the rim, and from above the top: single points err
FOLDED = 0.7  # of its length, to which a chord twice as long as a body is high shrinks: solids to 0.85, cloths to 0.3 to 0.65
MOVED = 0.5  # of a chord's length, by which half of the tracks move where it had occasion to shrink
MOST_PAIRS = 3000  # that are looked at
CHORDS = 0.01  # quantile of all chords in all frames that is looked at


def is_one_sided(points, up, spacing: float) -> bool:
    """Whether ``points`` (M, 3) [m], ``spacing`` apart, show one side of the body only, as seen along ``up`` (3,)."""
    height, inner, column = _columns(points, up, spacing)
    deep = np.array([np.ptp(height[column == k]) > COLUMN * spacing for k in inner])
    return bool(len(deep) and deep.mean() < LAYERS)


def has_depth(recording: Observed, points, up, spacing: float, ground: float | None) -> bool:
    """Whether one seen side is a solid's: it stands higher than what its points' spacing tells, and never folds as sharply as a sheet.

    ground: height [m] of the ground along ``up``, None where the body does not lie there; then the motion must say it.
    """
    bottom, top = np.quantile(points @ up, [LOWEST, 1 - LOWEST])
    depth = top - (bottom if ground is None else ground)
    chord = shortest_chord(recording, 2 * depth)
    if not np.isfinite(chord):
        return bool(ground is not None and depth > COLUMN * spacing)
    return bool(depth > COLUMN * spacing and chord > FOLDED)


def shortest_chord(recording: Observed, length: float) -> float:
    """To which share of their distance in frame 0 tracks about ``length`` [m] apart come at times, at the 1 % quantile.

    NaN where nothing says so: there are no such tracks, or they hardly went farther than half that length. A body that is t thick cannot
    be bent to a radius much less than t, which leaves 0.84 of a chord 2 t long.
    """
    from scipy.spatial import cKDTree

    seen = np.flatnonzero(recording.visible[0])
    if len(recording.points) < 2 or not len(seen) or not recording.correspond:
        return float("nan")
    tracks = np.where(recording.visible[:, seen, None], recording.points[:, seen], np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a track that is not seen again
        gone = np.nanmedian(np.nanmax(np.linalg.norm(tracks[1:] - tracks[0], axis=-1), axis=0))
    if not gone > MOVED * length:
        return float("nan")
    pairs = cKDTree(tracks[0]).query_pairs(1.25 * length, output_type="ndarray")
    start = np.linalg.norm(tracks[0, pairs[:, 0]] - tracks[0, pairs[:, 1]], axis=1)
    pairs = pairs[start > 0.8 * length]
    if len(pairs) > MOST_PAIRS:
        pairs = pairs[np.linspace(0, len(pairs) - 1, MOST_PAIRS).astype(int)]
    apart = np.linalg.norm(tracks[:, pairs[:, 0]] - tracks[:, pairs[:, 1]], axis=-1)
    share = (apart[1:] / apart[0]).ravel() if len(pairs) else np.zeros(0)
    share = share[np.isfinite(share)]
    return float(np.quantile(share, CHORDS)) if len(share) else float("nan")


def complete(points, spacing: float, up, ground: float | None) -> tuple[np.ndarray, str]:
    """(points (K, 3) m to add, what was done in words) for the ``points`` (M, 3) of one side of a solid.

    Below each point down to the ``ground`` [m] where the body lies on it, else down to the mirror image of the point at the rim.
    """
    height = points @ up
    rim = np.quantile(height, LOWEST)
    deep = np.maximum(height - ground if ground is not None else 2 * (height - rim), 0.0)
    steps = spacing * np.arange(1, int(deep.max() / spacing) + 1)
    columns = [(points - step * up)[deep > step + spacing / 2] for step in steps]
    what = "the underside was not seen; completed down to the ground"
    if ground is None:
        what = "the far side was not seen; completed by the mirror image of the near side at its rim"
    return np.concatenate([*columns, (points - deep[:, None] * up)[deep > spacing / 2]]), what


def upwards(recording: Observed, points, spacing: float) -> tuple[np.ndarray, float | None]:
    """(the direction (3,) towards which one side would have been seen, height [m] along it of the ground that the body lies on, or None).

    The ground's normal where the body lies on it: no gap below it is wide. Else towards the cameras, or against gravity where these are
    unknown.
    """
    plane = recording.ground
    if plane is not None and np.quantile(plane.height(points), LOWEST) < max(RESTING * _width(points, plane.normal), 2 * spacing):
        return plane.normal, float(plane.offset)
    if recording.cameras:
        way = np.mean([camera.camera_to_world[:3, 3] for camera in recording.cameras], axis=0) - points.mean(0)
    else:
        way = -recording.gravity
    length = np.linalg.norm(way)
    return (way / length if length > 0 else np.array([0.0, 0.0, 1.0])), None


def _columns(points, up, spacing):
    """(M,) heights, numbers of the columns that others surround, and (M,) the column of each point."""
    across = np.linalg.svd(np.reshape(up, (1, 3)))[2][1:]
    cell = np.floor(points @ across.T / (COLUMN * spacing)).astype(int)
    cells, column = np.unique(cell, axis=0, return_inverse=True)
    known = set(map(tuple, cells.tolist()))
    beside = [sum((i + a, j + b) in known for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))) for i, j in cells.tolist()]
    return points @ np.asarray(up), np.flatnonzero(np.array(beside) == 4), column.ravel()


def _width(points, up):
    """The lesser extent [m] of ``points`` across ``up``, of an even spread."""
    across = (points - points.mean(0)) @ np.linalg.svd(np.reshape(up, (1, 3)))[2][1:].T
    return float(np.sqrt(12) * np.linalg.svd(across, compute_uv=False)[1] / np.sqrt(len(points)))
