"""Farthest-first traversal: few points that lie in all of a cloud."""

from __future__ import annotations

import numpy as np

__all__ = ["farthest_points"]


def farthest_points(points, *, start: int = 0, most: int | None = None, radius: float = 0.0) -> np.ndarray:
    """Indices of farthest points of ``points`` (N, 3) m from ``start`` on, until there are ``most`` or the rest lies within ``radius`` [m].

    Source: Gonzalez 1985, farthest-first traversal.

    >>> farthest_points(np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0], [2.9, 0, 0]]), radius=0.5)
    array([0, 2, 1])
    """
    points = np.asarray(points, float)
    most = len(points) if most is None else most
    chosen, nearest = [start], ((points - points[start]) ** 2).sum(axis=1)
    while len(chosen) < most and nearest[farthest := int(nearest.argmax())] > radius**2:
        chosen.append(farthest)
        np.minimum(nearest, ((points - points[farthest]) ** 2).sum(axis=1), out=nearest)
    return np.array(chosen)
