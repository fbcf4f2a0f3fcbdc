"""Which particle of one recording is which of another: what lets a place on the body be spoken of in both."""

from __future__ import annotations

import numpy as np

from ..methods.registration import color_gap, rigid_transform, starts

__all__ = ["material_coordinates"]

ROUNDS = 30
KEPT = 0.8  # share of the nearest pairs that a round believes in
CLEARLY = 0.7  # of the misfit so far: a body that looks the same from several sides stays as it lies


def material_coordinates(structure, reference, *, colors=None, reference_colors=None) -> np.ndarray:
    """Where each of ``structure`` (M, 3) [m] lies on a ``reference`` (K, 3) of the same body: positions (M, 3) in the reference's frame.

    Rigid, by trimmed closest points from the principal axes in every orientation; where both have colours (M, 3), (K, 3) in [0, 1], NaN
    where unknown, they decide between orientations that geometry cannot tell apart.
    """
    structure, reference = np.asarray(structure, float), np.asarray(reference, float)
    size = max(1e-9, float(np.sqrt(((reference - reference.mean(0)) ** 2).sum(1).mean())))
    best, best_cost = structure, np.inf
    for start in starts(structure, reference):
        moved, index, error = _closest(start, reference)
        cost = error / size
        if colors is not None and reference_colors is not None:
            cost += color_gap(colors, reference_colors[index])
        if cost < best_cost * CLEARLY:
            best, best_cost = moved, cost
    return best


def _closest(moved, reference):
    from scipy.spatial import cKDTree

    tree, error = cKDTree(reference), np.inf
    for _ in range(ROUNDS):
        distance, index = tree.query(moved)
        keep = distance <= np.quantile(distance, KEPT)
        now = float(distance[keep].mean())
        if now > error * (1 - 1e-4):
            break
        error = now
        rotation, shift = rigid_transform(moved[keep], reference[index[keep]])
        moved = moved @ rotation.T + shift
    return moved, tree.query(moved)[1], error
