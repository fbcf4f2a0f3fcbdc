"""Distance to the annotated ground-truth tracks."""

from __future__ import annotations

import numpy as np

from .base import Metric

__all__ = ["METRIC", "TrackError", "match_tracks"]


def match_tracks(tracks, particles) -> tuple[np.ndarray, np.ndarray]:
    """Tracks annotated in frame 0, and for each the nearest of ``particles`` (M, 3) [m]: two index arrays (K',).

    ``tracks`` (K, 3) metres are the annotations of frame 0, NaN where there is none.

    >>> match_tracks([[0, 0, 0], [np.nan] * 3, [2, 0, 0]], [[1.9, 0, 0], [0.1, 0, 0]])
    (array([0, 2]), array([1, 0]))
    """
    from scipy.spatial import cKDTree

    tracks = np.asarray(tracks, float)
    annotated = np.flatnonzero(np.isfinite(tracks).all(axis=1))
    if not (len(annotated) and np.isfinite(particles).all()):
        return annotated[:0], annotated[:0]
    return annotated, cKDTree(particles).query(tracks[annotated])[1]


class TrackError(Metric):
    """Mean Euclidean distance between annotated tracks and the particles that they were matched with in frame 0 [m].

    Each track annotated in frame 0 is matched once with the nearest of all particles, interior ones too (PhysTwin's evaluation).
    A frame in which no matched track is annotated is NaN and counted; the published script counts it as 0, which lowers the mean.
    """

    name, unit, direction, version = "track_error", "m", "lower", 1

    def per_frame(self, prediction, scenario, frames):
        if scenario.tracks is None:
            return [np.nan] * len(frames)
        rows, particles = match_tracks(scenario.tracks[0], prediction.positions[0])
        return [_mean_distance(scenario.tracks[t][rows], prediction.positions[t][particles]) for t in frames]

    def reason(self, prediction, scenario, frame):
        if scenario.tracks is None:
            return "the recording has no annotated tracks"
        return f"frame {frame}: no track that was annotated in frame 0 is annotated"


def _mean_distance(tracks, predicted) -> float:
    annotated = np.isfinite(tracks).all(axis=1)
    if not (annotated.any() and np.isfinite(predicted).all()):
        return float("nan")
    return float(np.linalg.norm(tracks[annotated] - predicted[annotated], axis=1).mean())


METRIC = TrackError()
