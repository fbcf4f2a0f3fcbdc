"""Placing a body's particles on another recording's frame 0: how it is bent there."""

from __future__ import annotations

import numpy as np

from .registration import hues, nearest_alike, normals, size

__all__ = ["bend", "bend_once", "deform", "is_sheet"]

ROUNDS = 60
SETTLED = 3e-3  # of the spacing: a round that moves no particle farther is the last
HELD = 1e6  # weight of a particle's goal beside one edge: it arrives
SOUGHT = 1.0  # the same for a match, which is where the surface goes and need not be where that particle goes
SLID = 0.05  # share of the way along the surface that a match asks for: where samples lie on it says little
WITHIN = 0.5  # of the body's size (root mean square radius): farther matches are none
FEWEST = 3  # far matches beside each other that are no accident
NEAR, ASKED = 0.02, 3  # m and nearest matches: what the reference takes to be in place, and whom it asks whether a far match is wrong
PATCH, FLAT = 30, 1 / 3  # particles of a patch, and its thickness over its width where it is a sheet


def is_sheet(structure) -> bool:
    """Whether ``structure`` (M, 3) is a sheet, however folded: patches of 30 particles are on median a third as thick as wide, or less.

    Thickness and width are the standard deviations along a patch's third and second principal axes. Markers along a line are no sheet.
    """
    from scipy.spatial import cKDTree

    structure = np.asarray(structure, float)
    if len(structure) < 4:
        return False
    near = cKDTree(structure).query(structure, k=min(PATCH, len(structure)))[1]
    patches = structure[near] - structure[near].mean(1, keepdims=True)
    thin, wide, long = np.sqrt(np.maximum(np.linalg.eigvalsh(np.swapaxes(patches, 1, 2) @ patches), 0)).T
    return bool(np.median(thin / np.maximum(wide, 1e-12)) <= FLAT and np.median(wide / np.maximum(long, 1e-12)) > FLAT)


def deform(points, edges, goals, weights, *, rounds: int = 1, now=None) -> np.ndarray:
    """``points`` (M, 3) moved as rigidly as possible: positions (M, 3) [m] that lower, from ``now`` (M, 3) on,

    sum over ``edges`` (E, 2), both ways, of |(x_i - x_j) - R_i (p_i - p_j)|^2, R_i the best rotation of i's edges,
    plus sum over particles of 2 weights_i |x_i - goals_i|^2, with ``weights`` (M,), 0 where a particle has no goal.

    Source: Sorkine and Alexa 2007, one of the ``rounds`` being rotations, then positions. A piece without any goal stays where it is.
    """
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import splu

    points, now = np.asarray(points, float), np.array(points if now is None else now, float)
    count, (i, j) = len(points), np.asarray(edges).T
    joined = coo_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), (count, count)).tocsr()
    joined.data[:] = 1.0  # an edge given twice is one
    i, j = joined.nonzero()
    bare = 1e-6  # weight that keeps pieces without goals in place
    matrix = (diags(np.bincount(i, minlength=count) + weights + bare) - joined).tocsc()
    solve = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0).solve  # the order for symmetric ones: half the time
    span = points[i] - points[j]
    for _ in range(rounds):
        turned = _rotations(span, now[i] - now[j], i, count)
        # each edge is turned by both its ends: (R_i + R_j) / 2 (p_i - p_j)
        pull = np.einsum("eab,eb->ea", (turned[i] + turned[j]) / 2, span)
        right = np.stack([np.bincount(i, pull[:, k], count) for k in range(3)], 1)
        now = solve(right + weights[:, None] * np.where(weights[:, None] > 0, goals, 0.0) + bare * now)
    return now


def _rotations(before, after, owner, count):
    """(count, 3, 3) rotation that takes the edges ``before`` of each owner closest to those ``after``."""
    products = (before[:, :, None] * after[:, None, :]).reshape(-1, 9)
    covariance = np.stack([np.bincount(owner, products[:, k], count) for k in range(9)], 1).reshape(-1, 3, 3)
    u, _, vt = np.linalg.svd(covariance)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return np.swapaxes(u @ vt, 1, 2)


def bend(structure, edges, cloud, *, surface: int, spacing: float, colors=None, cloud_colors=None) -> np.ndarray:
    """``structure`` (M, 3) bent along its ``edges`` (E, 2) until its first ``surface`` particles lie on ``cloud`` (K, 3), metres.

    Rounds of matching and ``deform``. A match is a pair of mutually nearest points, in place and in ``colors`` (surface, 3) and
    ``cloud_colors`` (K, 3) where there are any (RGB in [0, 1], NaN where unknown), no farther apart than half the body's size; it draws its
    particle across the surface rather than along it. Far is what is more than ``spacing`` [m] off across the surface; a far match with no
    other beside it is wrong, and a body with fewer than three others lies there already and is not bent.
    """
    structure, cloud = np.asarray(structure, float), np.asarray(cloud, float)
    reach = size(structure)
    tints = hues(colors, cloud_colors, reach)
    now = structure
    for k in range(ROUNDS):
        index, apart = _matches(now[:surface], cloud, WITHIN * reach, tints)
        normal = normals(now[:surface])[index]
        across = (apart * normal).sum(1, keepdims=True) * normal
        far = np.linalg.norm(across, axis=1) > spacing
        alone = _alone(now[index], far)
        if k == 0 and (far & ~alone).sum() < FEWEST:
            return structure
        index, way = index[~alone], (across + SLID * (apart - across))[~alone]
        goals, weights = now.copy(), np.zeros(len(now))
        goals[index] += way
        weights[index] = SOUGHT
        moved = deform(structure, edges, goals, weights, now=now, rounds=2)
        done = np.abs(moved - now).max() < SETTLED * spacing
        now = moved
        if done:
            break
    return now


def bend_once(structure, edges, cloud, *, surface: int) -> np.ndarray:
    """The same as published: matches within 2 cm hold their particles where they are, far ones put theirs in place, in one round.

    A far match is discarded as wrong where one of its three nearest matches is near. Mutually nearest points no farther apart than half the
    body's size stand in for matched image features, and the particles with their springs for the mesh that the reference bends.
    """
    structure, cloud = np.asarray(structure, float), np.asarray(cloud, float)
    index, apart = _matches(structure[:surface], cloud, WITHIN * size(structure))
    far = np.linalg.norm(apart, axis=1) > NEAR
    kept = ~far | ~_beside(structure[index], far, ~far)
    if not (far & kept).any():
        return structure
    goals, weights = structure.copy(), np.zeros(len(structure))
    goals[index[far & kept]] += apart[far & kept]
    weights[index[kept]] = HELD
    return deform(structure, edges, goals, weights)


def _matches(points, cloud, within, tints=None):
    """Indices of ``points`` that have a mutually nearest point in ``cloud`` not farther than ``within`` [m], and the way there."""
    there, back = nearest_alike(points, cloud, tints), nearest_alike(cloud, points, tints and tints[::-1])
    apart = cloud[there] - points
    index = np.flatnonzero((back[there] == np.arange(len(points))) & (np.linalg.norm(apart, axis=1) <= within))
    return index, apart[index]


def _nearest(points):
    """(K, at most ASKED) the points nearest to each, itself not among them."""
    from scipy.spatial import cKDTree

    most = min(ASKED + 1, len(points))
    return cKDTree(points).query(points, k=most)[1].reshape(len(points), most)[:, 1:]


def _beside(points, who, whom):
    """Which of ``who`` (K,) have one of ``whom`` (K,) among their nearest matches."""
    return who & whom[_nearest(points)].any(1) if len(points) > 1 else np.zeros(len(points), bool)


def _alone(points, far):
    """Which far matches have no far one among their nearest matches: they are wrong."""
    return far & ~_beside(points, far, far)
