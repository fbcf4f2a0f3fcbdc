"""Controllers: points on each hand in frame 0, carried through the recording by the hand's own rigid motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import needs_open3d

__all__ = ["Hands", "find_hands", "rigid"]

COUNT = 30  # controllers of a published case
REACH = 0.08  # m: what is farther from the body holds nothing
GAP = 0.03  # m between two hands
NEAR = (0.01, 0.005)  # m between points of two clouds that are matched, at first and in the end
ROUNDS = 15  # of matching, each
SEEN = 0.4  # share of a hand's first cloud that must be matched
NOISE, INDEPENDENT = 0.002, 1000  # m across the surface, of so many points of a cloud: neighbours share the noise of depth
LEAST, GUESSED = 5e-4, 0.01  # m: what a hand may be off by that rigid tracks tell, at least, and one that went on at its speed


@dataclass(frozen=True)
class Hands:
    """points (T, C, 3) m; ``residual`` (T,) median distance of the tracks from the rigid motion [m], NaN where it was guessed."""

    points: np.ndarray
    residual: np.ndarray


def find_hands(points: np.ndarray, known: np.ndarray, clouds: list[np.ndarray], body: np.ndarray, *, count: int = COUNT) -> Hands:
    """``count`` controllers, farthest points of what is seen of hands near the ``body`` (M, 3) in frame 0.

    points (T, P, 3), known (T, P): tracks on hands. clouds: of each frame, (K, 3) points of hands. Each hand moves rigidly, to where its
    cloud and its tracks are likeliest: tracks slide over skin, together, by degrees, a cloud along what is flat or round. A hand that is
    not seen goes on at its speed.
    Raises ValueError where no hand is near the body in frame 0.
    """
    o3d = needs_open3d.imported("finding hands and surfaces")
    from scipy.spatial import cKDTree

    first = clouds[0]
    near = first[cKDTree(body).query(first)[0] < REACH] if len(first) else first
    if len(near) < 10:
        raise ValueError(f"no hand is within {REACH:g} m of the object in frame 0 ({len(near)} points): nothing would drive it")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(first))
    labels = np.asarray(cloud.cluster_dbscan(eps=GAP, min_points=5))
    labels = labels[cKDTree(first).query(near)[1]]
    hands = [label for label in np.unique(labels[labels >= 0]) if (labels == label).sum() >= 10]
    if not hands:
        raise ValueError("no hand is seen as one piece near the object in frame 0")
    shares = np.full(len(hands), count // len(hands))
    shares[: count - shares.sum()] += 1
    starts = [_farthest(near[labels == label], share) for label, share in zip(hands, shares, strict=True)]
    centres = [near[labels == label].mean(0) for label in hands]
    of = np.argmin([np.linalg.norm(points[0] - centre, axis=1) for centre in centres], axis=0)
    moved, residual = [], []
    for number, start in enumerate(starts):
        mine = (of == number) & known[0]
        poses, left = _follow(points[:, mine], known[:, mine], first, clouds)
        moved.append(np.einsum("tij,nj->tni", poses[:, :3, :3], start) + poses[:, None, :3, 3])
        residual.append(left)
    return Hands(np.concatenate(moved, axis=1), np.max(residual, axis=0))


def _follow(points, known, first, clouds):
    """Poses (T, 4, 4) from frame 0, and the tracks' residuals (T,)."""
    poses, residual = np.repeat(np.eye(4)[None], len(points), 0), np.zeros(len(points))
    for t in range(1, len(points)):
        guess = poses[t - 1] @ np.linalg.inv(poses[t - 2]) @ poses[t - 1] if t > 1 else poses[0]
        both, left, off = known[t], np.nan, GUESSED
        if both.sum() >= 6:
            guess, left = rigid(points[0, both], points[t, both])
            off = max(left, LEAST)
        poses[t], residual[t] = _matched(first, clouds[t], guess, off), left
    return poses, residual


def rigid(start: np.ndarray, end: np.ndarray, rounds: int = 5) -> tuple[np.ndarray, float]:
    """The motion (4, 4) that takes ``start`` (P, 3) to ``end``, by least squares (Kabsch 1976) with Cauchy's weights, and its residual."""
    weights = np.ones(len(start))
    for _ in range(rounds):
        share = weights / weights.sum()
        a, b = share @ start, share @ end
        u, _, v = np.linalg.svd((start - a).T @ ((end - b) * share[:, None]))
        turn = v.T @ np.diag([1, 1, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, b - turn @ a
        miss = np.linalg.norm(start @ turn.T + pose[:3, 3] - end, axis=1)
        weights = 1 / (1 + (miss / max(np.median(miss), 5e-4)) ** 2)
    return pose, float(np.median(miss))


def _matched(first, then, guess, off: float):
    """The likeliest pose where the cloud of frame 0 lies on that of this frame and a ``guess`` is ``off`` [m]; the guess where little of
    the hand is seen. Points lie on planes of their neighbours (Chen and Medioni 1992)."""
    o3d = needs_open3d.imported("finding hands and surfaces")
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

    if len(then) < 50 or len(first) < 50:
        return guess
    target = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(then))
    target.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.012, max_nn=30))
    normals, tree, middle = np.asarray(target.normals), cKDTree(then), first.mean(0)
    size = np.sqrt(((first - middle) ** 2).sum(1).mean())
    precision = np.repeat([(size / off) ** 2, off**-2], 3)  # of turns about the middle, and of the middle
    expected = guess[:3, :3] @ middle + guess[:3, 3]
    turn, at = guess[:3, :3], expected
    for far in NEAR:
        for _ in range(ROUNDS):
            moved = (first - middle) @ turn.T + at
            distance, which = tree.query(moved, distance_upper_bound=far)
            near = np.isfinite(distance)
            if near.mean() < SEEN:
                return guess
            across, arm = normals[which[near]], moved[near] - at
            apart = ((moved[near] - then[which[near]]) * across).sum(1)
            ways = np.c_[np.cross(arm, across), across]
            weight = min(1.0, INDEPENDENT / near.sum()) / NOISE**2
            back = np.r_[Rotation.from_matrix(guess[:3, :3] @ turn.T).as_rotvec(), expected - at]
            step = np.linalg.solve(weight * ways.T @ ways + np.diag(precision), precision * back - weight * ways.T @ apart)
            turn, at = Rotation.from_rotvec(step[:3]).as_matrix() @ turn, at + step[3:]
            if np.linalg.norm(step[:3]) < 2e-5 and np.linalg.norm(step[3:]) < 1e-6:
                break
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, at - turn @ middle
    return pose


def _farthest(points, count):
    """``count`` of ``points`` (K, 3) by farthest-point sampling; where there are fewer, points between them are added."""
    o3d = needs_open3d.imported("finding hands and surfaces")

    if len(points) < count:
        rng = np.random.default_rng(0)
        pairs = rng.integers(0, len(points), (count - len(points), 2))
        return np.concatenate([points, points[pairs].mean(1) + rng.normal(0, 1e-4, (len(pairs), 3))])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    return np.asarray(cloud.farthest_point_down_sample(count).points)
