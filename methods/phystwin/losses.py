"""PhysTwin's fitting losses (its code; paper section 3.3)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch

from ...datasets.scenario import Observed

__all__ = ["FitLoss", "nearest_particles"]

# distances at a time, in float32 16 and 64 MiB: one frame a launch would keep a graphics card waiting for Python
PAIRS = {"cpu": 1 << 22, "cuda": 1 << 24}


class FitLoss:
    """Chamfer and track loss of one recording's train frames.

    chamfer  (1/n) sum over visible points of |x_j - g_i|^2, j the nearest tracked or surface particle, held fixed
    track    (1/(3 n')) sum over points whose last motion is valid of smooth-L1(x_i - g_i), beta 1: |d|^2/6 a point, as |d| << 1 m
    """

    def __init__(self, observed: Observed, *, frame_one_counts: bool, device: str = "cpu", dtype=torch.float32):
        def to(value):
            return torch.tensor(value, device=device)

        self.points = to(observed.points).to(dtype)
        self.visible = to(observed.visible)
        moved = observed.visible.copy()
        moved[1:] &= observed.motion_valid[:-1]
        self.moved = to(moved)
        self.points = torch.where(self.visible[..., None], self.points, torch.zeros((), dtype=dtype, device=device))
        self.surface = sum(observed.counts[:2])
        self.frames = observed.observed_frames
        seen, valid = self.visible.sum(1), self.moved.sum(1)
        if frame_one_counts:
            seen, valid = seen[1].expand_as(seen), valid[1].expand_as(valid)
        self.seen, self.valid = seen.clamp(min=1).to(dtype), valid.clamp(min=1).to(dtype)

    def __call__(self, positions: torch.Tensor, first: int) -> torch.Tensor:
        """Loss (F,) of predicted ``positions`` (F, M, 3) [m] at frames ``first``, ``first`` + 1, ..."""
        span = slice(first, first + len(positions))
        goal, visible, moved = self.points[span], self.visible[span], self.moved[span]
        count = goal.shape[1]
        with torch.no_grad():
            nearest = nearest_particles(goal, positions[:, : self.surface].detach(), plain=goal.is_cuda)
        reached = torch.gather(positions, 1, nearest[..., None].expand(-1, -1, 3))
        chamfer = (((reached - goal) ** 2).sum(2) * visible).sum(1) / self.seen[span]
        apart = torch.nn.functional.smooth_l1_loss(positions[:, :count], goal, reduction="none", beta=1.0).sum(2)
        return chamfer + (apart * moved).sum(1) / (3 * self.valid[span])


def nearest_particles(goal: torch.Tensor, particles: torch.Tensor, *, plain: bool = False) -> torch.Tensor:
    """(F, N) index of the particle of ``particles`` (F, P, 3) nearest to each point of ``goal`` (F, N, 3) [m], frame by frame.

    ``plain`` subtracts coordinate by coordinate: torch's cdist takes a block of threads for each pair on CUDA, some forty times as long.
    No more than ``PAIRS`` distances are in memory at a time: those of 20,000 points to as many particles would be 1.6 GB a frame.
    """
    distances: Callable[..., torch.Tensor] = _squares if plain else partial(torch.cdist, compute_mode="donot_use_mm_for_euclid_dist")
    each, others = goal.shape[1], particles.shape[1]
    frames, rows = (max(1, PAIRS[goal.device.type] // max(1, pairs)) for pairs in (each * others, others))
    nearest = torch.empty(goal.shape[:2], dtype=torch.int64, device=goal.device)
    for goals, there, found in zip(*(t.split(frames) for t in (goal, particles, nearest)), strict=True):
        for some, indices in zip(goals.split(rows, 1), found.split(rows, 1), strict=True):
            indices.copy_(distances(some, there).argmin(2))
    return nearest


def _squares(goal: torch.Tensor, particles: torch.Tensor) -> torch.Tensor:
    """Squared distances (F, N, P) [m^2]."""
    x, y, z = ((goal[:, :, None, k] - particles[:, None, :, k]) ** 2 for k in range(3))
    return x + y + z
