"""The published Chamfer distance: one-sided, in the Manhattan norm."""

from __future__ import annotations

import numpy as np

from .base import Metric

__all__ = ["METRIC", "Chamfer", "one_sided_chamfer"]


def one_sided_chamfer(observed, predicted, *, norm: int = 1) -> float:
    """Mean distance [m] from each point of ``observed`` (K, 3) to the nearest of ``predicted`` (P, 3), in the L-``norm``.

    ``(1/K) sum_i min_j ||observed_i - predicted_j||``. NaN where either set is empty or holds a number that is not finite.

    >>> one_sided_chamfer([[0, 0, 0], [1, 0, 0]], [[0, 0.5, 0.25], [1, 0, 0]])
    0.375
    """
    from scipy.spatial import cKDTree

    observed, predicted = np.reshape(observed, (-1, 3)), np.reshape(predicted, (-1, 3))
    if not (len(observed) and len(predicted) and np.isfinite(observed).all() and np.isfinite(predicted).all()):
        return float("nan")
    return float(cKDTree(predicted).query(observed, p=norm)[0].mean())


class Chamfer(Metric):
    """Mean Manhattan distance from each visible tracked point to the nearest predicted surface particle [m].

    Nearest is meant in the Manhattan norm too, interior particles are left out, and only this direction counts, as in
    PhysTwin's evaluation (arXiv 2503.17973, section 5, as executed). It is up to sqrt(3) times the Euclidean figure.
    """

    name, unit, direction, version = "chamfer", "m", "lower", 1
    norm = 1

    def per_frame(self, prediction, scenario, frames):
        return [one_sided_chamfer(scenario.points[t][scenario.visible[t]], prediction.surface[t], norm=self.norm) for t in frames]

    def reason(self, prediction, scenario, frame):
        return f"frame {frame}: no tracked point is visible"


METRIC = Chamfer()
