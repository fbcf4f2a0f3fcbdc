"""Linear blend skinning: points that follow the particles of a roll-out (PhysTwin; Sumner et al., SIGGRAPH 2007).

Every particle is a bone. Its rotation is the one that turns its neighbours of frame 0 into where they are now; a point moves by the
weighted mean of what its nearest bones would do to it, mu' = sum_k w_k (R_k (mu - b_k) + b'_k).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from .config import CORRECTED, Quirks

__all__ = ["NEIGHBOURS", "Pose", "Skinning", "bone_rotations", "quaternions", "rotated"]

NEIGHBOURS = 16  # bones that a bone's rotation is read from, and that a point follows (published)
CLOSE = 1e-6  # m: added to distances, so that a point on a bone has a finite weight (published)
LINE = 1e-4  # of the largest singular value: neighbours less than 1 % as wide as long lie on a line, as in ``rigid_motion``
FLOAT32_LINE = 3 * torch.finfo(torch.float32).eps  # the same where float32 matrices of 3 x 3 lose a rank by default
POINT = 1e-8  # m^2: neighbours within about 0.1 mm have no direction
ALONG_X = 1e-6  # sine of the angle to the x axis below which a line lies on it (published)


@dataclass(frozen=True)
class Pose:
    """Points in one frame: ``positions`` (G, 3) m, ``rotations`` (G, 4) unit quaternions w, x, y, z since frame 0, float64."""

    positions: torch.Tensor
    rotations: torch.Tensor


class Skinning:
    """Points (G, 3) on bones (T, M, 3) m.

    As corrected, which is the default, frame t is skinned from frame 0 directly: any frame costs the same and errors do not add up, and a
    point keeps the bones that it was next to when it was seen. As published, t is skinned from t - 1 by the bones nearest to it there.
    Every table is (M, 16) or (G, 16). Raises ValueError where the bones are not finite.
    """

    def __init__(self, bones, points, *, quirks: Quirks = CORRECTED, device: str = "cpu"):
        bones = np.asarray(bones)
        if bones.ndim != 3 or bones.shape[1] < 1 or bones.shape[2] != 3:
            raise ValueError(f"bones must have shape (frames, at least 1, 3), got {bones.shape}")
        if not np.isfinite(bones).all():
            frame = int(np.flatnonzero(~np.isfinite(bones).all(axis=(1, 2)))[0])
            raise ValueError(f"bones must be finite to carry anything, but are not in frame {frame} of the roll-out")
        self.quirks = quirks
        self.bones = torch.as_tensor(bones, dtype=torch.float64, device=device)
        points = torch.as_tensor(points, dtype=torch.float64, device=device)
        self.neighbours = _nearest(self.bones[0], self.bones[0], apart=True)
        self._start = Pose(points, points.new_tensor([1.0, 0, 0, 0]).repeat(len(points), 1))
        self._links = self._bind(points, 0)
        self._last = (0, self._start)

    def pose(self, frame: int) -> Pose:
        """The points in ``frame``. As published this runs through all frames since the last one asked for, or since frame 0."""
        if frame == 0:
            return self._start
        if not self.quirks.incremental:
            return self._move(self._start, 0, frame, *self._links)
        at, pose = self._last if self._last[0] <= frame else (0, self._start)
        for t in range(at, frame):
            pose = self._move(pose, t, t + 1, *self._bind(pose.positions, t))
        self._last = (frame, pose)
        return pose

    def _bind(self, points, frame):
        """The bones that points follow, (G, 16), and their weights."""
        index = _nearest(self.bones[frame], points)
        weights = 1 / ((points[:, None] - self.bones[frame][index]).norm(dim=2) + CLOSE)
        return index, weights / weights.sum(1, keepdim=True)

    def _move(self, pose, before, now, index, weights):
        old, new = self.bones[before], self.bones[now]
        turns = bone_rotations(old, new, self.neighbours, self.quirks)
        arms = pose.positions[:, None] - old[index]
        moved = torch.einsum("gkij,gkj->gki", turns[index], arms) + new[index]
        mean = _mean(quaternions(turns)[index], weights, aligned=not self.quirks.unaligned_quaternions)
        return Pose((weights[..., None] * moved).sum(1), _product(mean, pose.rotations))


def bone_rotations(old, new, neighbours, quirks: Quirks = CORRECTED) -> torch.Tensor:
    """Rotations (M, 3, 3) of bones ``old`` to ``new`` (M, 3), each from its own ``neighbours`` (M, K): R = U diag(1, 1, det) V^T of
    F = sum_k e'_k e_k^T (Kabsch 1976).

    Where the neighbours lie on a line, it is the smallest rotation of that line; where they lie in a point, none. With ``shared_rank`` one
    such bone takes all bones' rotations away, as published.
    """
    if neighbours.shape[1] == 0:
        return torch.eye(3, dtype=old.dtype, device=old.device).repeat(len(old), 1, 1)
    before, after = old[neighbours] - old[:, None], new[neighbours] - new[:, None]
    covariance = torch.einsum("mki,mkj->mij", after, before)
    u, s, vt = torch.linalg.svd(covariance)
    handed = torch.ones_like(s)
    handed[:, 2] = torch.det(u @ vt).sign()
    turns = (u * handed[:, None]) @ vt
    line, point = (FLOAT32_LINE, 0.0) if quirks.float32_rank else (LINE, POINT)
    rank_none = s[:, 0] <= point
    rank_one = (s[:, 1] <= line * s[:, 0]) & ~rank_none
    swung = _from_x(u[:, :, 0]) if quirks.lines_from_x else _swing(vt[:, 0], u[:, :, 0])
    still = torch.eye(3, dtype=old.dtype, device=old.device)
    if quirks.shared_rank and bool((rank_one | rank_none).any()):
        alone = int(rank_one.sum()) == 1 and not bool(rank_none.any())
        return (swung[rank_one] if alone else still[None]).expand(len(old), 3, 3)
    turns = torch.where(rank_one[:, None, None], swung, turns)
    return torch.where(rank_none[:, None, None], still, turns)


def _from_x(lines):
    """The smallest rotations (M, 3, 3) of the x axis to the unit vectors ``lines`` (M, 3); none to those that lie on it, either way."""
    still = torch.eye(3, dtype=lines.dtype, device=lines.device)
    x = still[0].expand_as(lines)
    across = torch.linalg.cross(x, lines)
    on_it = across.norm(dim=1) < ALONG_X
    across = torch.nn.functional.normalize(across, dim=1)
    after = torch.stack([lines, across, torch.linalg.cross(lines, across)], 2)
    before = torch.stack([x, across, torch.linalg.cross(x, across)], 2)
    return torch.where(on_it[:, None, None], still, after @ before.mT)


def _swing(a, b):
    """The smallest rotations (M, 3, 3) of unit vectors ``a`` to ``b`` (M, 3): I + [v] + [v]^2 / (1 + a.b) with v = a x b; half a turn
    about any axis across where they are opposite."""
    axis, cosine = torch.linalg.cross(a, b), (a * b).sum(1)
    zero = torch.zeros_like(cosine)
    x, y, z = axis.unbind(1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).view(-1, 3, 3)
    eye = torch.eye(3, dtype=a.dtype, device=a.device)
    swing = eye + cross + cross @ cross / (1 + cosine).clamp(min=1e-12)[:, None, None]
    least = torch.nn.functional.one_hot(a.abs().argmin(1), 3).to(a)
    across = torch.nn.functional.normalize(torch.linalg.cross(a, least), dim=1)
    half = 2 * across[:, :, None] * across[:, None] - eye
    return torch.where((cosine < -1 + 1e-9)[:, None, None], half, swing)


def _nearest(bones, points, *, apart=False):
    """(G, K) indices of the nearest bones, at most 16; with ``apart`` the points are the bones and none is its own neighbour."""
    from scipy.spatial import cKDTree

    count = min(NEIGHBOURS, len(bones) - apart)
    found = cKDTree(bones.cpu().numpy()).query(points.cpu().numpy(), k=range(1, count + apart + 1), workers=-1)[1]
    if apart:
        # bones in one place come in any order: leave out the bone itself wherever it is, else the last
        own = found == np.arange(len(found))[:, None]
        own[~own.any(1), -1] = True
        found = found[~own].reshape(len(found), count)
    return torch.as_tensor(np.asarray(found, np.int64), device=bones.device)


def quaternions(rotations: torch.Tensor) -> torch.Tensor:
    """Unit quaternions (M, 4) as w, x, y, z of rotation matrices (M, 3, 3): the eigenvector of the largest eigenvalue of Shepperd's
    symmetric matrix, from whichever of its four columns is longest."""
    m = rotations
    w, x, y, z = (1 + m[:, 0, 0] * i + m[:, 1, 1] * j + m[:, 2, 2] * k for i, j, k in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)))
    wx, wy, wz = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    columns = torch.stack([w, wx, wy, wz, wx, x, xy, xz, wy, xy, y, yz, wz, xz, yz, z], 1).view(-1, 4, 4)
    longest = torch.stack([w, x, y, z], 1).argmax(1)
    return torch.nn.functional.normalize(columns[torch.arange(len(m), device=m.device), longest], dim=1)


def _mean(many, weights, *, aligned):
    """The normalised weighted mean (G, 4) of quaternions (G, K, 4); ``aligned``: each with the sign that is nearer to the first."""
    if aligned:
        sign = torch.where((many * many[:, :1]).sum(2) < 0, -1.0, 1.0).to(many)
        many = many * sign[..., None]
    return torch.nn.functional.normalize((weights[..., None] * many).sum(1), dim=1)


def _product(a, b):
    """Quaternion products (G, 4): first ``b``, then ``a``."""
    (w, v), (s, u) = (a[:, :1], a[:, 1:]), (b[:, :1], b[:, 1:])
    return torch.cat([w * s - (v * u).sum(1, keepdim=True), w * u + s * v + torch.linalg.cross(v, u)], 1)


def rotated(quaternion: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """``vectors`` (G, 3) turned by unit quaternions (G, 4)."""
    w, v = quaternion[:, :1], quaternion[:, 1:]
    t = 2 * torch.linalg.cross(v, vectors)
    return vectors + w * t + torch.linalg.cross(v, t)
