"""Controllers: points on each hand in frame 0, carried through the recording by the hand's own rigid motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import needs_open3d

__all__ = ["Hands", "find_hands", "rigid"]

COUNT = 30  # controllers of a published case
REACH = 0.08  # m: what is farther from the body holds nothing
GAP = 0.03  # m between two hands
TRUSTED = 0.004  # m: tracks that miss a rigid motion by less say more of it than a cloud, which slides along flat and round parts


@dataclass(frozen=True)
class Hands:
    """points (T, C, 3) m; ``residual`` (T,) median distance of the tracks from the rigid motion [m], NaN where it was guessed."""

    points: np.ndarray
    residual: np.ndarray


def find_hands(points: np.ndarray, known: np.ndarray, clouds: list[np.ndarray], body: np.ndarray, *, count: int = COUNT) -> Hands:
    """``count`` controllers, farthest points of what is seen of hands near the ``body`` (M, 3) in frame 0.

    points (T, P, 3), known (T, P): tracks on hands. clouds: of each frame, (K, 3) points of hands. Each hand moves rigidly: by its tracks,
    or, where those miss it, by its cloud (ICP), frame after frame; a hand that is not seen goes on at its speed.
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
        both = known[t]
        left = np.nan
        if both.sum() >= 6:
            guess, left = rigid(points[0, both], points[t, both])
        poses[t], residual[t] = guess if left < TRUSTED else _icp(first, clouds[t], guess), left
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


def _icp(first, then, guess):
    """``guess`` refined so that the cloud of frame 0 lies on that of this frame; left as it is where little of it is seen."""
    o3d = needs_open3d.imported("finding hands and surfaces")

    if len(then) < 50 or len(first) < 50:
        return guess
    source, target = (o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud)) for cloud in (first, then))
    target.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.012, max_nn=30))
    method = o3d.pipelines.registration.TransformationEstimationPointToPlane()
    found = o3d.pipelines.registration.registration_icp(source, target, 0.01, guess, method)
    shift = np.linalg.norm(found.transformation[:3, 3] + (found.transformation[:3, :3] - guess[:3, :3]) @ first.mean(0) - guess[:3, 3])
    return found.transformation if found.fitness > 0.4 and shift < 0.01 else guess


def _farthest(points, count):
    """``count`` of ``points`` (K, 3) by farthest-point sampling; where there are fewer, points between them are added."""
    o3d = needs_open3d.imported("finding hands and surfaces")

    if len(points) < count:
        rng = np.random.default_rng(0)
        pairs = rng.integers(0, len(points), (count - len(points), 2))
        return np.concatenate([points, points[pairs].mean(1) + rng.normal(0, 1e-4, (len(pairs), 3))])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    return np.asarray(cloud.farthest_point_down_sample(count).points)
