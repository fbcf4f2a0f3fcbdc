"""The error figure of the cable literature: mean absolute difference of coordinates."""

from __future__ import annotations

import numpy as np

from .base import Metric

__all__ = ["METRIC", "CoordinateError", "corresponds", "mean_absolute_difference"]


def mean_absolute_difference(observed, predicted) -> float:
    """``mean |observed - predicted|`` over all points and the three coordinates [m], for (K, 3) arrays. NaN where empty or not finite.

    >>> mean_absolute_difference([[0, 0, 0], [1, 1, 1]], [[0, 0, 0.5], [1, 1, 2.0]])
    0.25
    """
    difference = np.abs(np.subtract(observed, predicted, dtype=float))
    return float(difference.mean()) if difference.size and np.isfinite(difference).all() else float("nan")


class CoordinateError(Metric):
    """Mean absolute error per coordinate over the visible tracked points, driven ones included [m].

    The figure that DEFORM reports (Chen et al., CoRL 2024, arXiv 2406.05931). It compares point i with predicted particle i, so it is
    NaN for a twin whose tracked particles are not the recording's points (a twin brought over from another recording of a
    textured body): where the numbers of points differ, or most points of frame 0 lie nearer to another's particle than to their own;
    and for clouds, whose points do not correspond.
    """

    name, unit, direction, version = "coordinate_error", "m", "lower", 1

    def per_frame(self, prediction, scenario, frames):
        if not (scenario.correspond and corresponds(prediction.tracked[0], scenario.points[0], scenario.visible[0])):
            return [np.nan] * len(frames)
        seen = scenario.visible
        return [mean_absolute_difference(scenario.points[t][seen[t]], prediction.tracked[t][seen[t]]) for t in frames]

    def reason(self, prediction, scenario, frame):
        if not scenario.correspond:
            return "the recording has clouds, whose points do not correspond"
        if not corresponds(prediction.tracked[0], scenario.points[0], scenario.visible[0]):
            return "the twin's particles are not the recording's points"
        return super().reason(prediction, scenario, frame)


def corresponds(particles, points, visible) -> bool:
    """Whether particle i stands for point i, judged in frame 0."""
    from scipy.spatial import cKDTree

    if len(particles) != len(points) or not visible.any() or not np.isfinite(particles).all():
        return False
    nearest = cKDTree(particles).query(points[visible])[0]
    own = np.linalg.norm(particles[visible] - points[visible], axis=1)
    return float(np.mean(own <= nearest + 1e-9)) > 0.5


METRIC = CoordinateError()
