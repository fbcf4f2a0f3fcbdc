"""From points to a body: anchors on a lattice, their springs, what the hands hold, and which anchors a Gaussian follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["FINE", "Body", "bind", "build", "lattice", "pulls", "springs", "voxels"]

VOXEL, FINE = 0.01, 0.001  # m: side of a voxel, and where that gives too few
REACH, MOST_PULLS = 0.04, 50  # m, and springs of one control point: PhysTwin's defaults, which the augmentation took over
COINCIDENT = 1e-9  # m: a rest length of zero has no strain, so such a pair is left out


@dataclass(frozen=True)
class Body:
    """The topology, fixed for a whole run. A anchors with K springs each, M Gaussians, P pulls.

    anchors     (A, 3) m, centres of voxels
    neighbours  (A, K) the other end of each spring that an anchor owns, nearest first
    rest        (A, K) m
    pulls       (P, 2) anchor and control point
    pull_rest   (P,) m
    gaussians   (M, 3) m, frame 0
    bound       (M, 16) the anchors that a Gaussian follows
    weights     (M, 16) and how much, rows sum to one
    """

    anchors: np.ndarray
    neighbours: np.ndarray
    rest: np.ndarray
    pulls: np.ndarray
    pull_rest: np.ndarray
    gaussians: np.ndarray
    bound: np.ndarray
    weights: np.ndarray


def build(points, hands, *, anchors: int, neighbours: int, bound: int, least: int, random: np.random.Generator) -> Body:
    """The body of ``points`` (M, 3), one Gaussian each, held by the control points ``hands`` (C, 3), metres, in frame 0.

    Raises ValueError where there are fewer than ``least`` voxels, which must be more than ``neighbours``.
    """
    points = np.asarray(points, float)
    centres = lattice(points, anchors, least=least, random=random)
    owned, rest = springs(centres, neighbours)
    held, pull_rest = pulls(centres, hands)
    followed, weights = bind(points, centres, bound)
    return Body(centres, owned, rest, held, pull_rest, points, followed, weights)


def voxels(points, side: float) -> np.ndarray:
    """(V, 3) centres [m] of the voxels of a ``side`` [m] that hold one of ``points``.

    >>> voxels([[0.001, 0, 0], [0.009, 0, 0], [0.011, 0, 0]], 0.01)
    array([[0.005, 0.005, 0.005],
           [0.015, 0.005, 0.005]])
    """
    return (np.unique(np.floor(np.asarray(points, float) / side), axis=0) + 0.5) * side


def lattice(points, count: int, *, least: int, random: np.random.Generator) -> np.ndarray:
    """(A, 3) at most ``count`` voxel centres [m], drawn at random. Raises ValueError where there are fewer than ``least``."""
    centres = voxels(points, VOXEL)
    if len(centres) < count:
        centres = voxels(points, FINE)
    if len(centres) < least:
        raise ValueError(f"too few voxels: at least {least} are needed, and the body occupies {len(centres)} of {FINE * 1e3:g} mm")
    if len(centres) > count:
        centres = centres[random.choice(len(centres), count, replace=False)]
    return centres


def springs(anchors, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(A, K) indices of the ``count`` nearest other anchors of each, nearest first, and (A, K) the distances [m].

    Directed: that j is among i's neighbours does not make i one of j's. Ties are broken as the tree finds them.
    """
    apart, near = cKDTree(anchors).query(anchors, k=count + 1)
    return near[:, 1:], apart[:, 1:]


def pulls(anchors, hands) -> tuple[np.ndarray, np.ndarray]:
    """(P, 2) anchor and control point of every control spring, and its rest length (P,) [m]: those within reach, the nearest first."""
    if not len(hands):
        return np.zeros((0, 2), np.int64), np.zeros(0)
    apart, near = cKDTree(anchors).query(hands, k=range(1, min(MOST_PULLS, len(anchors)) + 1), distance_upper_bound=REACH)
    hand, column = np.nonzero(np.isfinite(apart) & (apart > COINCIDENT))
    return np.stack([near[hand, column], hand], axis=1).astype(np.int64), apart[hand, column]


def bind(points, anchors, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(M, ``count``) the nearest anchors of each point, and their weights: distance to the power -1/2, rows sum to one."""
    apart, near = cKDTree(anchors).query(points, k=count)
    weights = (apart + 1e-14) ** -0.5
    return near, weights / weights.sum(axis=1, keepdims=True)
