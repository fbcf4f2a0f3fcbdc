"""How far the worst of the tracked points is off."""

from __future__ import annotations

import numpy as np
from twinbench.metrics.base import Metric

__all__ = ["WorstTrack", "farthest"]


def farthest(observed, predicted) -> float:
    """Largest distance [m] of a point of ``observed`` (K, 3) to the nearest of ``predicted`` (P, 3); NaN where one is empty or not finite.

    >>> farthest([[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [1, 2, 0]])
    1.0
    """
    from scipy.spatial import cKDTree

    if not (len(observed) and len(predicted) and np.isfinite(observed).all() and np.isfinite(predicted).all()):
        return float("nan")
    return float(cKDTree(predicted).query(observed)[0].max())


class WorstTrack(Metric):
    """Largest Euclidean distance from a visible tracked point to the nearest predicted surface particle [m]."""

    name, unit, direction, version = "worst_track", "m", "lower", 1

    def per_frame(self, prediction, scenario, frames):
        return [farthest(scenario.points[t][scenario.visible[t]], prediction.surface[t]) for t in frames]
