"""Moving every particle of a body with the nodes that the network moves."""

from __future__ import annotations

import numpy as np

from .config import CORRECTED, Quirks

__all__ = ["node_rotations", "skin"]

CLOSEST = 1e-4  # m: nearer nodes weigh no more
LINE = 1e-4  # second over first singular value up to which neighbours lie on a line: they are 1 % as wide as long
FLOAT32_LINE = 3 * np.finfo(np.float32).eps  # the same where float32 matrices of 3 x 3 lose a rank by default
ALONG_X = 1e-6  # sine of the angle to the x axis below which a line lies on it (published)


def node_rotations(before, after, pairs, quirks: Quirks = CORRECTED) -> np.ndarray:
    """(n, 3, 3) rotation of each node: the one that best turns the way to its neighbours ``before`` (n, 3) into that ``after`` (n, 3).

    ``pairs`` (2, E) senders and receivers; a receiver's senders are its neighbours. Neighbours on a line leave the turn about it open:
    then the shortest turn of the line is taken. Without neighbours there is no turn. Source: Kabsch 1976.
    """
    sender, receiver = pairs
    way, way_now = before[sender] - before[receiver], after[sender] - after[receiver]
    products = np.zeros((len(before), 3, 3))
    np.add.at(products, receiver, way_now[:, :, None] * way[:, None])
    u, size, vt = np.linalg.svd(products)
    rank = (size > (FLOAT32_LINE if quirks.float32_rank else LINE) * size[:, :1]).sum(axis=1)
    mirrored = np.linalg.det(u @ vt) < 0
    u[mirrored, :, 2] *= -1
    rotations = u @ vt
    for k in np.flatnonzero(rank == 1):
        now = u[k, :, 0]
        rotations[k] = _from_x(now) if quirks.lines_from_x else _shortest(vt[k, 0], now)
    still = (rank == 0) | ((rank == 3) & mirrored & quirks.mirrored_still)
    rotations[still] = np.eye(3)
    return rotations


def _from_x(line):
    """The rotation by the smallest angle that takes the x axis to the unit vector ``line``; none where it lies on that axis, either way."""
    x = np.array([1.0, 0.0, 0.0])
    across = np.cross(x, line)
    if (sine := np.linalg.norm(across)) < ALONG_X:
        return np.eye(3)
    across /= sine
    return np.stack([line, across, np.cross(line, across)], axis=1) @ np.stack([x, across, np.cross(x, across)])


def _shortest(a, b):
    """The rotation by the smallest angle that takes the unit vector ``a`` to ``b``: Rodrigues' formula."""
    axis, cosine = np.cross(a, b), float(a @ b)
    if cosine < -1 + 1e-12:  # half a turn, about any axis across
        across = np.cross(a, np.eye(3)[np.abs(a).argmin()])
        across /= np.linalg.norm(across)
        return 2 * np.outer(across, across) - np.eye(3)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)


def skin(points, before, after, rotations) -> np.ndarray:
    """``points`` (M, 3) m moved by linear blend skinning while all nodes go from ``before`` to ``after`` (n, 3).

    x -> sum over nodes of w (R (x - before) + after), w = 1 / max(|x - before|, 0.1 mm), normalised.
    """
    apart = np.sqrt(np.maximum((points**2).sum(1)[:, None] + (before**2).sum(1) - 2 * points @ before.T, 0.0))
    weights = 1 / np.maximum(apart, CLOSEST)
    weights /= weights.sum(axis=1, keepdims=True)
    turns = (weights @ rotations.reshape(-1, 9)).reshape(-1, 3, 3)
    shifts = weights @ (after - np.einsum("nij,nj->ni", rotations, before))
    return np.einsum("mij,mj->mi", turns, points) + shifts
