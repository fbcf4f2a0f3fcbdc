"""Where and when a twin and a recording part: what an observer has to push, as accelerations, and clusters of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .model import Simulator
from .replica import Replica
from .sightings import where_unseen

__all__ = ["Cluster", "clusters", "missing_acceleration", "peaks"]

DAMPING = 0.7
SMOOTH = 5  # frames


def missing_acceleration(replica: Replica, predicted: np.ndarray, bandwidth: float) -> np.ndarray:
    """(F, n, 3) m/s^2: what the observer of ``bandwidth`` [Hz] pushed each node with, averaged over five frames; NaN where unseen.

    An observer that follows slowly supplies just the acceleration that the model lacks, low-passed at its bandwidth: the momentum observer
    of robot collision detection (De Luca; Haddadin et al. 2017), on a simulator.
    """
    seen, fps = replica.sightings.position[: len(predicted)], replica.recording.fps
    w = 2 * np.pi * bandwidth
    gap = seen - predicted
    rate = np.gradient(gap, 1 / fps, axis=0) if len(gap) > 1 else np.zeros_like(gap)
    push = w * w * gap + 2 * DAMPING * w * rate
    return _smoothed(push, SMOOTH)


def _smoothed(values, width):
    """Running mean over ``width`` frames that leaves NaN out."""
    good = np.isfinite(values)
    total = np.cumsum(np.concatenate([np.zeros((1, *values.shape[1:])), np.where(good, values, 0.0)]), 0)
    count = np.cumsum(np.concatenate([np.zeros((1, *values.shape[1:])), good]), 0)
    half = width // 2
    first = np.maximum(0, np.arange(len(values)) - half)
    last = np.minimum(len(values), np.arange(len(values)) + half + 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (total[last] - total[first]) / (count[last] - count[first])
    return np.where(good, mean, np.nan)


def peaks(replica: Replica, push: np.ndarray, count: int) -> np.ndarray:
    """Indices of up to ``count`` nodes where the mean square push, pooled with the nearest neighbours, is largest; well apart."""
    from scipy.spatial import cKDTree

    with where_unseen():
        energy = np.nanmean((push**2).sum(-1), axis=0)
    energy = np.where(np.isfinite(energy), energy, np.nan)
    tree = cKDTree(replica.nodes)
    near = tree.query(replica.nodes, k=min(7, len(replica.nodes)))[1]
    with where_unseen():
        pooled = np.nanmean(energy[near].reshape(len(energy), -1), axis=1)
    pooled = np.where(np.isfinite(pooled), pooled, -np.inf)
    chosen = []
    for node in np.argsort(-pooled):
        if np.isfinite(pooled[node]) and all(np.linalg.norm(replica.nodes[node] - replica.nodes[c]) > 3 * replica.spacing for c in chosen):
            chosen.append(int(node))
        if len(chosen) == count:
            break
    return np.array(chosen, int)


@dataclass(frozen=True)
class Cluster:
    """A patch of nodes over a run of frames in which twin and recording part.

    nodes     indices
    frames    [first, last)
    strength  mean error there over the mean error elsewhere
    p         share of sign-flipped maps whose largest cluster is as heavy: family-wise
    """

    nodes: np.ndarray
    frames: tuple[int, int]
    strength: float
    p: float


def clusters(
    simulator: Simulator, predicted: np.ndarray, *, floor: float, window: int = 6, flips: int = 200, seed: int = 0
) -> list[Cluster]:
    """Contiguous space-time clusters of innovations above three times ``floor`` [m], heaviest first.

    Their p is family-wise, by sign flips of whole blocks. Innovations are averaged over windows of frames and neighbouring nodes before
    they are compared, so noise shrinks and a common push adds.
    """
    from scipy.spatial import cKDTree

    replica = simulator.replica
    seen = replica.sightings.position[: len(predicted)]
    gap = seen - predicted
    near = cKDTree(replica.nodes).query(replica.nodes, k=min(5, len(replica.nodes)))[1].reshape(len(replica.nodes), -1)
    blocks = [slice(a, min(a + window, len(gap))) for a in range(0, len(gap), window)]
    with where_unseen():
        mean = np.stack([np.nanmean(gap[b], axis=0) for b in blocks])  # (W, n, 3)
    mean = np.where(np.isfinite(mean), mean, 0.0)
    rng = np.random.default_rng(seed)

    def labelled(signed):
        pooled = np.linalg.norm(signed[:, near].mean(2), axis=-1)
        return pooled, _components(pooled > 3 * floor, near)

    pooled, found = labelled(mean)
    masses = [pooled[tuple(np.array(c).T)].sum() for c in found]
    null = []
    for _ in range(flips):
        signs = rng.choice([-1.0, 1.0], size=(len(blocks), len(replica.nodes), 1))
        p2, c2 = labelled(mean * signs)
        null.append(max([p2[tuple(np.array(c).T)].sum() for c in c2], default=0.0))
    null = np.array(null)
    out = []
    for order in np.argsort(masses)[::-1]:
        cells = np.array(found[order])
        nodes = np.unique(cells[:, 1])
        frames = (blocks[cells[:, 0].min()].start, blocks[cells[:, 0].max()].stop)
        rest = np.ones_like(pooled, bool)
        rest[tuple(cells.T)] = False
        elsewhere = pooled[rest].mean() if rest.any() else floor
        strength = float(pooled[tuple(cells.T)].mean() / max(elsewhere, 1e-9))
        out.append(Cluster(nodes, frames, strength, float((1 + (null >= masses[order]).sum()) / (1 + flips))))
    return out


def _components(mask, near):
    """Lists of (window, node) cells that hang together over neighbouring nodes and windows."""
    left, found = set(map(tuple, np.argwhere(mask))), []
    while left:
        stack = [left.pop()]
        group = []
        while stack:
            w, i = stack.pop()
            group.append((w, i))
            for cell in [(w - 1, i), (w + 1, i), *((w, int(j)) for j in near[i])]:
                if cell in left:
                    left.remove(cell)
                    stack.append(cell)
        found.append(group)
    return found
