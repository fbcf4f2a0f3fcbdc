"""Which patches need a force, and when, that no twin supplies: a group lasso, and no name."""

from __future__ import annotations

import numpy as np

from ....diagnosis.inquiry import BANDWIDTH
from ....diagnosis.locate import missing_acceleration
from ....diagnosis.replica import spread_out
from .base import Entrant, answer, mean_of

__all__ = ["ENTRANT", "VirtualForce", "group_lasso"]

PATCHES, WINDOW = 12, 8  # patches of a body, frames of a window
STRICT = 3.0  # robust standard deviations above the median norm of a group below which it is put to nothing


def group_lasso(values: np.ndarray, weights: np.ndarray, penalty: float) -> np.ndarray:
    """The minimiser f (G, 3) of 1/2 sum_g w_g |y_g - f_g|^2 + penalty sum_g sqrt(w_g) |f_g|, for y (G, 3) and w (G,).

    Groups share no data, so each shrinks by itself (Yuan and Lin 2006, orthonormal case): f_g = (1 - penalty / (sqrt(w_g) |y_g|))_+ y_g.

    >>> group_lasso(np.array([[3.0, 4.0, 0.0], [0.1, 0.0, 0.0]]), np.ones(2), 1.0).tolist()
    [[2.4000000000000004, 3.2, 0.0], [0.0, 0.0, 0.0]]
    """
    norm = np.sqrt(weights) * np.linalg.norm(values, axis=1)
    return np.maximum(0.0, 1 - penalty / np.maximum(norm, 1e-300))[:, None] * values


class VirtualForce(Entrant):
    """What the observer had to push with, as one force for each patch and window, most of them nothing. A patch that needs one in both
    recordings is where something "unknown" acts; without such a patch the twin is adequate.
    """

    name = "virtual_force"

    def answer(self, given):
        inquiry, floor = given.inquiry, given.diagnosis.result["evidence"]["noise_floor"]
        replicas = [s.replica for s in inquiry.simulators[: 1 + inquiry.transfers]]
        centres = replicas[0].nodes[spread_out(replicas[0].nodes, PATCHES)]
        ends = [inquiry.train_end, *(r.frames for r in replicas[1:])]
        forces = [_forces(r, x[:end], centres) for r, x, end in zip(replicas, inquiry.watched, ends, strict=True)]
        strength = np.array([np.linalg.norm(f, axis=2).sum(0) for f in forces])  # (recordings, patches)
        both = (strength > 0).all(0)
        fit = mean_of(inquiry, inquiry.base, None, floor)
        if not both.any():
            return answer("adequate", fit=fit)
        patch = int(np.argmax(np.where(both, strength[0], -1)))
        nodes = np.flatnonzero(_nearest(replicas[0].nodes, centres) == patch)
        middle = replicas[0].nodes[nodes].mean(0)
        radius = float(np.linalg.norm(replicas[0].nodes[nodes] - middle, axis=1).max())
        windows = np.flatnonzero(np.linalg.norm(forces[0][:, patch], axis=1) > 0)
        return answer(
            "unknown",
            where={"points": replicas[0].particles(nodes), "centroid": middle.tolist(), "radius": radius},
            when={"frames": [int(windows[0]) * WINDOW, min(replicas[0].frames, (int(windows[-1]) + 1) * WINDOW)]},
            fit=fit,
        )


def _nearest(nodes, centres):
    return np.linalg.norm(nodes[:, None] - centres[None], axis=2).argmin(1)


def _forces(replica, watched, centres):
    """(windows, patches, 3) m/s^2 after the group lasso."""
    push = missing_acceleration(replica, watched, BANDWIDTH)
    owner = _nearest(replica.nodes if replica.system.home is None else replica.system.home, centres)
    windows = np.arange(len(push)) // WINDOW
    group = (windows[:, None] * len(centres) + owner).ravel()
    flat = push.reshape(-1, 3)
    good = np.isfinite(flat).all(1)
    size = (windows[-1] + 1) * len(centres)
    count = np.bincount(group[good], minlength=size)
    mean = np.stack([np.bincount(group[good], flat[good, c], size) for c in range(3)], 1) / np.maximum(count, 1)[:, None]
    norm = np.sqrt(count) * np.linalg.norm(mean, axis=1)
    seen = norm[count > 0]
    middle = np.median(seen) if len(seen) else 0.0
    penalty = middle + STRICT * 1.4826 * np.median(np.abs(seen - middle)) if len(seen) else 0.0
    return group_lasso(mean, count, penalty).reshape(windows[-1] + 1, len(centres), 3)


ENTRANT = VirtualForce()
