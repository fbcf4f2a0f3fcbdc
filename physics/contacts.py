"""Which particles might touch during a frame: every pair of one system closer than its contact distance at the frame's start."""

from __future__ import annotations

import numpy as np
import torch

__all__ = ["candidates"]


def candidates(batch, x: torch.Tensor, table: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(row, near): particle i of the union may meet ``near[row[i]:row[i+1]]``, in ascending order. int32 tensors on the batch's device.

    Both directions of a pair are listed. Controllers do not collide. Lists are as long as they need to be; nothing overflows.
    """
    from scipy.spatial import cKDTree

    positions = x.detach().cpu().numpy()
    column = batch.laws.start("contact")
    distances = table[:, column].detach().cpu().numpy()
    neighbours = table[:, column + 3].detach().cpu().numpy() > 0
    first, second = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for system, start, size, distance, joined in zip(batch.systems, batch.starts[:-1], batch.sizes, distances, neighbours, strict=True):
        points = positions[start : start + size]
        if np.isfinite(points).all():
            # slightly wide, because the kernel compares in its own precision
            pairs = cKDTree(points).query_pairs(float(distance) * (1 + 1e-6), output_type="ndarray")
            if not joined:
                apart = np.linalg.norm(system.positions[pairs[:, 0]] - system.positions[pairs[:, 1]], axis=1)
                pairs = pairs[apart >= distance]
            first.append(start + pairs[:, 0])
            second.append(start + pairs[:, 1])
    first, second = np.concatenate(first), np.concatenate(second)
    here, other = np.concatenate([first, second]), np.concatenate([second, first])
    order = np.lexsort((other, here))
    row = np.concatenate([[0], np.cumsum(np.bincount(here, minlength=batch.node_count))])
    near = other[order] if len(order) else np.zeros(1)
    return tuple(torch.as_tensor(np.asarray(a, np.int32), device=batch.device) for a in (row, near))
