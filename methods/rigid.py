"""The body is stiff and follows the controllers: what a method must beat to say anything about deformation."""

from __future__ import annotations

import numpy as np

from .base import Trajectory
from .registration import rigid_transform
from .static import Static, StaticTwin

__all__ = ["METHODS", "Rigid", "RigidTwin", "rigid_motion"]


def rigid_motion(source, target, *, tolerance: float = 1e-2) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) [m] with the least squared error of ``R source + t -> target``, both (C, 3) metres.

    The rotation is the identity where the points do not determine one: fewer than three, or all on a line, that is with a second
    singular value below ``tolerance`` times the first. No points give no motion. Source: Kabsch 1976; Umeyama 1991, eq. 40-42.
    """
    source, target = np.asarray(source, float), np.asarray(target, float)
    if not len(source):
        return np.eye(3), np.zeros(3)
    centre, centre_now = source.mean(axis=0), target.mean(axis=0)
    if _spans_a_plane(source - centre, tolerance) and _spans_a_plane(target - centre_now, tolerance):
        return rigid_transform(source, target)
    return np.eye(3), centre_now - centre


def _spans_a_plane(centred, tolerance) -> bool:
    if len(centred) < 3:
        return False
    largest, second = np.linalg.svd(centred, compute_uv=False)[:2]
    return bool(second > tolerance * largest)


class RigidTwin(StaticTwin):
    """Frame 0 moved by the rigid motion that best explains how the controllers moved since frame 0.

    A driven marker is where its controller is: that position is given to every method, not predicted.
    """

    def rollout(self, controllers) -> Trajectory:
        controllers = np.asarray(controllers, float)
        motions = [rigid_motion(controllers[0], now) for now in controllers]
        positions = np.stack([self.structure @ rotation.T + shift for rotation, shift in motions])
        driven = np.flatnonzero(self.grips >= 0)
        positions[:, self.grips[driven]] = controllers[:, driven]
        return Trajectory(positions.astype(np.float32), self.counts)


class Rigid(Static):
    """Moves frame 0 rigidly with the controllers."""

    name = "rigid"
    twin_class = RigidTwin


METHODS = (Rigid,)
