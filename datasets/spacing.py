"""How far apart points lie."""

from __future__ import annotations

import numpy as np

__all__ = ["spacing"]


def spacing(points, *, alone: float = 0.0) -> float:
    """Median distance from one of ``points`` (N, d) to its nearest neighbour, in their unit; ``alone`` where there are fewer than two."""
    from scipy.spatial import cKDTree

    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1])) if len(points) > 1 else alone
