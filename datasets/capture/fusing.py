"""Tracks of all cameras as one body: thinned in frame 0, and what several cameras see of a place taken together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Fused", "fuse"]


@dataclass(frozen=True)
class Fused:
    """points (T, N, 3) m, visible (T, N) bool, colors (T, N, 3) in [0, 1]; ``sources`` (N,) how many tracks each point was made of."""

    points: np.ndarray
    visible: np.ndarray
    colors: np.ndarray
    sources: np.ndarray


def fuse(points: np.ndarray, known: np.ndarray, colors: np.ndarray, *, spacing: float = 0.005, apart: float = 0.008) -> Fused:
    """Tracks ``points`` (T, P, 3), ``known`` (T, P), ``colors`` (T, P, 3) of all cameras as points ``spacing`` [m] apart in frame 0.

    Each track belongs to the nearest point kept in frame 0, if it is nearer than ``spacing``. In a frame a point is where the tracks that
    belong to it put it: the median of their motions since frame 0, those more than ``apart`` [m] from it left out. Tracks known for longer
    are kept first, so that points live. Tracks that are not known in frame 0 are left out.
    """
    from scipy.spatial import cKDTree

    start = np.flatnonzero(known[0])
    start = start[np.argsort(-known[:, start].sum(0), kind="stable")]
    kept, free = [], np.ones(len(start), bool)
    near = cKDTree(points[0, start]).query_ball_point(points[0, start], spacing)
    for i in range(len(start)):
        if free[i]:
            kept.append(i)
            free[near[i]] = False
    centres = points[0, start[kept]]
    owner = cKDTree(centres).query(points[0, start])[1]
    moved, seen = np.zeros((len(points), len(kept), 3)), np.zeros((len(points), len(kept)), bool)
    shades, sources = np.zeros_like(moved), np.bincount(owner, minlength=len(kept))
    for n in range(len(kept)):
        members = start[owner == n]
        there = known[:, members]
        motion = np.where(there[..., None], points[:, members] - points[0, members], np.nan)
        some = there.any(1)
        middle = np.nanmedian(motion[some], axis=1)
        far = np.linalg.norm(motion[some] - middle[:, None], axis=2) > apart
        far[far.sum(1) == there[some].sum(1)] = False  # two that contradict each other: nobody knows which is right
        moved[some, n] = centres[n] + np.nanmean(np.where(far[..., None], np.nan, motion[some]), axis=1)
        seen[some, n] = True
        shades[some, n] = np.nanmean(np.where(there[some][..., None], colors[some][:, members], np.nan), axis=1)
    return Fused(moved, seen, shades, sources)
