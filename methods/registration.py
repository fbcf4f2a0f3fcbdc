"""Placing a body's particles on another recording's frame 0: how it lies there as a whole.

The reference matches image features by a network (SuperGlue) whose licence excludes commercial use. In its place the body is laid on the
target in every orientation of its principal axes, and how well both shapes and colours meet tells which is the right one.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from ..datasets.scenario import Plane

__all__ = ["align", "color_gap", "hues", "lifted", "nearest_alike", "normals", "rigid_transform", "size", "starts"]

ROUNDS = 50
KEPT = 0.8  # share of nearest pairs that a round believes in: the rest may be unseen or occluded
COLOR = 0.3  # distance in RGB that counts as much as the body's own size
NEIGHBOURS = 12  # particles that say how the surface lies around one
ALONG = 0.01  # weight of what is apart along the surface beside what is apart across it
SETTLED = 1e-9  # m: a round that moves no particle farther is the last


def rigid_transform(source, target) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) that take ``source`` (K, 3) closest to ``target`` (K, 3), least squares (Kabsch 1976)."""
    a, b = source.mean(0), target.mean(0)
    u, _, vt = np.linalg.svd((source - a).T @ (target - b))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = vt.T @ turn @ u.T
    return rotation, b - rotation @ a


def align(structure, cloud, *, surface: int | None = None, colors=None, cloud_colors=None, ground: Plane | None = None) -> np.ndarray:
    """``structure`` (M, 3) moved rigidly onto ``cloud`` (K, 3), metres; particles below the ground are lifted onto it.

    The first ``surface`` particles (default all) are those that can be seen. ``colors`` (surface, 3) and ``cloud_colors`` (K, 3) are RGB in
    [0, 1], NaN where unknown. Trimmed iterative closest points (Besl and McKay 1992; Chetverikov 2002) from all ``starts``, closest in
    place and, where colours are known, in colour (Johnson and Kang 1999); the one whose end has the smallest trimmed distance and gap of
    colours wins, earlier ones on ties. From its end on, what is apart along the surface counts little (Chen and Medioni 1992): both are
    sampled, and no particle need have its like in the cloud.
    """
    structure, cloud = np.asarray(structure, float), np.asarray(cloud, float)
    seen = slice(len(structure) if surface is None else surface)
    reach = max(1e-9, size(cloud))
    tints = hues(colors, cloud_colors, reach)
    best, best_cost = structure, np.inf
    for start in starts(structure, cloud, seen=seen):
        moved, index, error = _closest_points(start, cloud, seen, tints)
        cost = error / reach
        if colors is not None and cloud_colors is not None:
            cost += color_gap(np.asarray(colors)[index], cloud_colors)
        if cost < best_cost * 0.98:
            best, best_cost = moved, cost
    return lifted(_closest_surface(best, cloud, seen, tints), ground)


def lifted(structure, ground: Plane | None) -> np.ndarray:
    """``structure`` (M, 3) [m], what is below the ground raised onto it."""
    if ground is None:
        return structure
    return structure + np.maximum(0.0, -ground.height(structure))[:, None] * ground.normal


def size(points) -> float:
    """Root mean square radius [m] of ``points`` (K, 3)."""
    return float(np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean()))


def hues(colors, others, reach: float):
    """``colors`` (M, 3) and ``others`` (K, 3) in metres, black and a pure colour ``reach`` [m] apart; None where none of either is known.

    What is unknown of one has the mean of the others.
    """
    if colors is None or others is None or not all(np.isfinite(c).all(1).any() for c in (colors, others)):
        return None
    colors, others = np.asarray(colors, float), np.asarray(others, float)
    return tuple(np.where(np.isfinite(a), a, np.nanmean(b, axis=0)) * reach for a, b in ((colors, others), (others, colors)))


def nearest_alike(points, others, tints=None) -> np.ndarray:
    """(K,) index of the nearest of ``others`` to each of ``points`` (K, 3) [m]; in colour too, given the ``tints`` of both."""
    from scipy.spatial import cKDTree

    if tints is not None:
        points, others = np.hstack([points, tints[0]]), np.hstack([others, tints[1]])
    return cKDTree(others).query(points)[1]


def color_gap(colors, others) -> float:
    """Mean distance of paired ``colors`` and ``others`` (K, 3) in units of ``COLOR``; 0 where none is known of both."""
    gap = np.linalg.norm(np.asarray(colors) - others, axis=1)
    return float(gap[np.isfinite(gap)].mean()) / COLOR if np.isfinite(gap).any() else 0.0


def starts(structure, cloud, *, seen: slice = slice(None)) -> Iterator[np.ndarray]:
    """Where ``structure`` (M, 3) [m] may lie on ``cloud`` (K, 3): where it is, about the cloud's centre, and on the cloud's principal axes
    in every orientation, also with the first two exchanged. Centre and axes are those of the particles ``seen``."""
    a, b = structure[seen].mean(0), cloud.mean(0)
    axes_a, axes_b = (np.linalg.svd(p - p.mean(0), full_matrices=False)[2] for p in (structure[seen], cloud))
    yield structure
    yield structure - a + b
    if min(len(structure[seen]), len(cloud)) < 3:
        return
    for order in ((0, 1, 2), (1, 0, 2)):
        for signs in product((1, -1), repeat=3):
            turn = axes_b.T @ np.diag(signs) @ axes_a[list(order)]
            if np.linalg.det(turn) > 0:
                yield (structure - a) @ turn.T + b


def normals(points) -> np.ndarray:
    """(K, 3) unit normals, of either sign, of the surface that ``points`` (K, 3) lie on: across the plane through the nearest of them."""
    from scipy.spatial import cKDTree

    near = cKDTree(points).query(points, k=min(NEIGHBOURS, len(points)))[1].reshape(len(points), -1)
    patches = points[near] - points[near].mean(1, keepdims=True)
    return np.linalg.eigh(np.swapaxes(patches, 1, 2) @ patches)[1][:, :, 0]


def _closest_points(structure, cloud, seen, tints):
    """Moved structure, nearest particle (K,) of each point, trimmed distance.

    Pairs go from cloud to structure: the cloud is what was seen, and the structure may hold unseen parts.
    """
    back, error = tints and tints[::-1], np.inf
    for _ in range(ROUNDS):
        index = nearest_alike(cloud, structure[seen], back)
        distance = np.linalg.norm(cloud - structure[seen][index], axis=1)
        keep = distance <= np.quantile(distance, KEPT)
        now = float(distance[keep].mean())
        if now > error * (1 - 1e-4):
            break
        error = now
        rotation, shift = rigid_transform(structure[seen][index[keep]], cloud[keep])
        structure = structure @ rotation.T + shift
    return structure, index, error


def _closest_surface(structure, cloud, seen, tints):
    """Rounds of the least-squares motion with (n . d)^2 + ALONG |d|^2 for each kept pair that is d apart, n the surface's normal."""
    from scipy.spatial.transform import Rotation

    back = tints and tints[::-1]
    for _ in range(ROUNDS):
        surface = structure[seen]
        index = nearest_alike(cloud, surface, back)
        apart = cloud - surface[index]
        distance = np.linalg.norm(apart, axis=1)
        keep = distance <= np.quantile(distance, KEPT)
        index, apart = index[keep], apart[keep]
        centre = surface[index].mean(0)
        normal = normals(surface)[index]
        weight = ALONG * np.eye(3) + normal[:, :, None] * normal[:, None, :]
        arm = surface[index] - centre
        # a small turn w about the centre and a shift u move a particle by w x arm + u
        lever = np.concatenate([np.cross(np.eye(3)[None], arm[:, None]).swapaxes(1, 2), np.broadcast_to(np.eye(3), (len(arm), 3, 3))], 2)
        weighed = np.swapaxes(lever, 1, 2) @ weight
        motion = np.linalg.lstsq((weighed @ lever).sum(0), (weighed @ apart[:, :, None]).sum(0)[:, 0], rcond=1e-9)[0]
        moved = (structure - centre) @ Rotation.from_rotvec(motion[:3]).as_matrix().T + centre + motion[3:]
        done = np.abs(moved - structure).max() < SETTLED
        structure = moved
        if done:
            break
    return structure
