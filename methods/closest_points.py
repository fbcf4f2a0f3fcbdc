"""Closest points as the reference registers them: within a distance, by where points are, or by their colours too."""

from __future__ import annotations

import numpy as np

from ..datasets.needs_open3d import imported
from .registration import rigid_transform

__all__ = ["colored", "point_to_point"]

REACH, ROUNDS, RELATIVE = 0.02, 30, 1e-6  # m, and the library's own criteria
SCALES = ((0.04, 50), (0.02, 30), (0.01, 14))  # voxel and reach [m], rounds
NORMAL_REACH, NORMAL_NEIGHBOURS = 2.0, 30  # of the voxel
FILLER = 0.3  # grey where a colour is unknown
DIGITS = 9  # sums of threads end in another order each time: what they leave open is not kept


def point_to_point(structure, cloud, *, surface: int | None = None) -> np.ndarray:
    """``structure`` (M, 3) moved rigidly, from the difference of centres on, by pairs nearer than 2 cm to ``cloud`` (K, 3), metres.

    The first ``surface`` particles (default all) are paired.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(cloud)
    structure = structure - structure[:surface].mean(0) + np.mean(cloud, 0)
    before = None
    for _ in range(ROUNDS):
        distance, index = tree.query(structure[:surface], distance_upper_bound=REACH)
        near = np.isfinite(distance)
        if not near.any():
            break
        now = np.array([near.mean(), np.sqrt((distance[near] ** 2).mean())])  # share of pairs, and how far they are apart
        if before is not None and (np.abs(now - before) < RELATIVE).all():
            break
        before = now
        rotation, shift = rigid_transform(structure[:surface][near], cloud[index[near]])
        structure = structure @ rotation.T + shift
    return structure


def colored(structure, colors, cloud, cloud_colors) -> np.ndarray:
    """``structure`` (M, 3) [m] moved rigidly onto ``cloud`` (K, 3), from where it is, from coarse to fine.

    Its first particles, of which there are ``colors``, are matched; RGB in [0, 1], NaN where unknown. Source: Park, Zhou and Koltun 2017,
    as open3d has it. A scale at which no points are near enough to each other changes nothing. Raises ImportError where open3d or its
    system library libusb-1.0 is not installed.
    """
    open3d = imported("coloured registration")
    registration = open3d.pipelines.registration
    clouds = [_cloud(open3d, p, c) for p, c in ((structure[: len(colors)], colors), (cloud, cloud_colors))]
    motion = np.eye(4)
    for voxel, rounds in SCALES:
        pair = [one.voxel_down_sample(voxel) for one in clouds]
        for one in pair:
            one.estimate_normals(open3d.geometry.KDTreeSearchParamHybrid(radius=NORMAL_REACH * voxel, max_nn=NORMAL_NEIGHBOURS))
        if not registration.evaluate_registration(*pair, voxel, motion).correspondence_set:
            continue
        criteria = registration.ICPConvergenceCriteria(RELATIVE, RELATIVE, rounds)
        estimation = registration.TransformationEstimationForColoredICP()
        try:
            motion = registration.registration_colored_icp(*pair, voxel, motion, estimation, criteria).transformation
        except RuntimeError:  # raised where a round is left without pairs
            continue
    motion = np.round(motion, DIGITS)
    return structure @ motion[:3, :3].T + motion[:3, 3]


def _cloud(open3d, points, colors):
    one = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.array(points, float)))
    one.colors = open3d.utility.Vector3dVector(np.where(np.isfinite(colors), colors, FILLER).astype(float))
    return one
