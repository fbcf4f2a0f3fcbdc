"""Placing a body's particles on another recording's frame 0."""

from __future__ import annotations

from itertools import product

import numpy as np

from ..datasets.scenario import Plane

__all__ = ["align", "rigid_transform"]

ROUNDS = 50
KEPT = 0.8  # share of nearest pairs that a round believes in: the rest may be unseen or occluded


def rigid_transform(source, target) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) that take ``source`` (K, 3) closest to ``target`` (K, 3), least squares (Kabsch 1976)."""
    a, b = source.mean(0), target.mean(0)
    u, _, vt = np.linalg.svd((source - a).T @ (target - b))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = vt.T @ turn @ u.T
    return rotation, b - rotation @ a


def align(structure, cloud, *, ground: Plane | None = None) -> np.ndarray:
    """``structure`` (M, 3) moved rigidly onto ``cloud`` (K, 3), metres; particles below the ground are lifted onto it.

    Trimmed iterative closest points (Besl and McKay 1992; Chetverikov 2002) from where it is, from the cloud's centre, and from the cloud's
    principal axes in every orientation; the start whose end has the smallest trimmed distance wins, earlier ones on ties.
    """
    structure, cloud = np.asarray(structure, float), np.asarray(cloud, float)
    best, best_error = structure, np.inf
    for start in _starts(structure, cloud):
        moved, error = _closest_points(start, cloud)
        if error < best_error * 0.98:
            best, best_error = moved, error
    if ground is not None:
        best = best + np.maximum(0.0, -ground.height(best))[:, None] * ground.normal
    return best


def _starts(structure, cloud):
    a, b = structure.mean(0), cloud.mean(0)
    yield structure
    yield structure - a + b
    axes_a, axes_b = (np.linalg.svd(p - p.mean(0), full_matrices=False)[2] for p in (structure, cloud))
    for signs in product((1, -1), repeat=3):
        turn = axes_b.T @ np.diag(signs) @ axes_a
        if np.linalg.det(turn) > 0:
            yield (structure - a) @ turn.T + b


def _closest_points(structure, cloud):
    """ICP on cloud -> structure pairs: the cloud is what was seen, the structure may hold unseen parts."""
    from scipy.spatial import cKDTree

    error = np.inf
    for _ in range(ROUNDS):
        distance, index = cKDTree(structure).query(cloud)
        keep = distance <= np.quantile(distance, KEPT)
        now = float(distance[keep].mean())
        if now > error * (1 - 1e-4):
            break
        error = now
        rotation, shift = rigid_transform(structure[index[keep]], cloud[keep])
        structure = structure @ rotation.T + shift
    return structure, error
