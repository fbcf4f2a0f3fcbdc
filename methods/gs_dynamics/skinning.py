"""Moving every particle of a body with the nodes that the network moves."""

from __future__ import annotations

import numpy as np

__all__ = ["node_rotations", "skin"]

CLOSEST = 1e-4  # m: nearer nodes weigh no more
LINE = 1e-4  # second over first singular value below which neighbours lie on a line


def node_rotations(before, after, pairs) -> np.ndarray:
    """(n, 3, 3) rotation of each node: the one that best turns the way to its neighbours ``before`` (n, 3) into that ``after`` (n, 3).

    ``pairs`` (2, E) senders and receivers; a receiver's senders are its neighbours. Neighbours on a line leave the turn about it open:
    then the shortest turn of the line is taken. Without neighbours there is no turn. Source: Kabsch 1976.
    """
    sender, receiver = pairs
    way, way_now = before[sender] - before[receiver], after[sender] - after[receiver]
    products = np.zeros((len(before), 3, 3))
    np.add.at(products, receiver, way[:, :, None] * way_now[:, None])
    u, size, vt = np.linalg.svd(products)
    v = vt.transpose(0, 2, 1)
    flip = np.ones((len(before), 3))
    flip[:, 2] = np.where(np.linalg.det(u) * np.linalg.det(v) < 0, -1.0, 1.0)
    rotations = (v * flip[:, None]) @ u.transpose(0, 2, 1)
    for k in np.flatnonzero(size[:, 1] <= LINE * size[:, 0]):
        rotations[k] = _shortest(u[k, :, 0], v[k, :, 0]) if size[k, 0] > 0 else np.eye(3)
    return rotations


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
