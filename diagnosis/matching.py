"""Which particle of one recording is which of another: what lets a place on the body be spoken of in both."""

from __future__ import annotations

from itertools import product

import numpy as np

from ..methods.registration import rigid_transform

__all__ = ["material_coordinates"]

ROUNDS = 30
KEPT = 0.8  # share of the nearest pairs that a round believes in
CLEARLY = 0.7  # of the misfit so far: a body that looks the same from several sides stays as it lies
COLOR = 0.3  # distance in RGB that counts as much as the body's own size


def material_coordinates(structure, reference, *, colors=None, reference_colors=None) -> np.ndarray:
    """Where each of ``structure`` (M, 3) [m] lies on a ``reference`` (K, 3) of the same body: positions (M, 3) in the reference's frame.

    Rigid, by trimmed closest points from the principal axes in every orientation; where both have colours (M, 3), (K, 3) in [0, 1], NaN
    where unknown, they decide between orientations that geometry cannot tell apart.
    """
    structure, reference = np.asarray(structure, float), np.asarray(reference, float)
    size = max(1e-9, float(np.sqrt(((reference - reference.mean(0)) ** 2).sum(1).mean())))
    best, best_cost = structure, np.inf
    for start in _starts(structure, reference):
        moved, index, error = _closest(start, reference)
        cost = error / size
        if colors is not None and reference_colors is not None:
            gap = np.linalg.norm(colors - reference_colors[index], axis=1)
            if np.isfinite(gap).any():
                cost += float(np.nanmean(gap)) / COLOR
        if cost < best_cost * CLEARLY:
            best, best_cost = moved, cost
    return best


def _starts(structure, reference):
    a, b = structure.mean(0), reference.mean(0)
    axes_a, axes_b = (np.linalg.svd(p - p.mean(0), full_matrices=False)[2] for p in (structure, reference))
    yield structure
    yield structure - a + b
    for swap in ((0, 1, 2), (1, 0, 2)):
        for signs in product((1, -1), repeat=3):
            turn = axes_b.T @ np.diag(signs) @ axes_a[list(swap)]
            if np.linalg.det(turn) > 0:
                yield (structure - a) @ turn.T + b


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
