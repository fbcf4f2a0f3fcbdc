"""What was seen of each node of a coarse twin: tracks pooled by local rigid registration, their noise, and tracks that cannot be right."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

__all__ = ["Sightings", "middles", "noise_of", "sight_markers", "sight_nodes"]

NEIGHBOURS = 12  # tracks that share a rigid motion from frame 0
OUTLIER = 4.0  # robust standard deviations from the shared motion
LOST = 0.5  # share of frames in which a track is an outlier that makes it a wrong track


@dataclass(frozen=True)
class Sightings:
    """Where the nodes were seen.

    position   (T, n, 3) m, NaN where a node was not seen
    count      (T, n) tracks behind each
    noise      m, standard deviation of one node's coordinate, white in time
    misfit     (N,) m, median distance of each track from the motion it shares with its neighbours
    wrong      (N,) bool: tracks that leave their neighbours for good (drift, swapped identities)
    slide      by how much more than their neighbours tracks leave these, late over early: log of the ratio of what 1 in 20 exceeds
    """

    position: np.ndarray
    count: np.ndarray
    noise: float
    misfit: np.ndarray
    wrong: np.ndarray
    slide: float = 0.0


@contextmanager
def where_unseen() -> Iterator[None]:
    """Means and medians over what was nowhere seen are NaN, without a warning: the caller asks ``isfinite``."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def noise_of(positions: np.ndarray) -> float:
    """White noise [m] of one coordinate from third differences of (T, n, 3) tracks: a smooth motion leaves only noise in them.

    The variance of a third difference of white noise is 1 + 9 + 9 + 1 = 20 times its own. The lower quartile of the nodes' robust
    deviations is taken, so that fast motion and contacts do not count as noise.
    """
    third = np.diff(positions, 3, axis=0)
    with where_unseen():
        scale = np.nanmedian(np.abs(third), axis=0) / 0.6745 / np.sqrt(20) if len(third) else np.zeros((0, 3))
    scale = scale[np.isfinite(scale)]
    return float(np.quantile(scale, 0.25)) if scale.size else 0.0


def sight_markers(points, visible, *, fitted: int | None = None) -> Sightings:
    """What was seen of nodes that are markers themselves: ``points`` (T, n, 3) [m] where ``visible`` (T, n), as they are.

    The noise is that of the first ``fitted`` frames, all unless given. Markers along a rope share no rigid motion that could tell a
    wrong one.
    """
    position = np.where(np.asarray(visible, bool)[..., None], np.asarray(points, float), np.nan)
    count = np.isfinite(position[..., 0]).astype(int)
    nodes = position.shape[1]
    return Sightings(position, count, noise_of(position[:fitted]), np.full(nodes, np.nan), np.zeros(nodes, bool))


def sight_nodes(points, visible, nodes, *, fitted: int | None = None, keep: bool = False) -> tuple[np.ndarray, Sightings]:
    """Pool tracks ``points`` (T, N, 3) [m], meaningless where not ``visible`` (T, N), at ``nodes`` (n, 3) of frame 0.

    A track counts for its nearest node. Each node gets the rigid motion that best carries its neighbourhood from frame 0 (Kabsch), and its
    position is where its own tracks say it is, their offsets turned along. Returns the nodes moved to the middle of their tracks, and
    what was seen of them; a node without tracks stays and is never seen, and with ``keep`` all stay.
    What counts as noise and as an outlier is told by the first ``fitted`` frames, all unless given: later ones do not change earlier ones.
    """
    from scipy.spatial import cKDTree

    points, visible = np.asarray(points, float), np.asarray(visible, bool)
    frames, count = visible.shape
    usable = np.flatnonzero(visible[0])
    nodes = np.array(nodes, float)
    home = points[0, usable]
    middle, owner = middles(nodes, home)
    nodes = nodes if keep else middle
    track = np.where(visible[:, usable, None], points[:, usable], np.nan)
    k = min(NEIGHBOURS, len(usable))
    near = np.atleast_2d(cKDTree(home).query(home, k=k)[1].reshape(len(usable), -1))
    residual = _shared_motion_residual(track, home, near)
    with where_unseen():
        scale = max(1e-6, float(np.nanmedian(residual[:fitted])))
    with np.errstate(invalid="ignore"):
        bad = residual > OUTLIER * 1.4826 * scale + 1e-3
    bad &= np.isfinite(residual)
    later = slice(frames // 2, None)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = bad[later].sum(0) / np.maximum(1, np.isfinite(residual[later]).sum(0))
    wrong = np.zeros(count, bool)
    wrong[usable] = share > LOST
    misfit = np.full(count, np.nan)
    with where_unseen():
        misfit[usable] = np.where(
            np.isfinite(residual).any(0), np.nanmedian(np.where(np.isfinite(residual), residual, np.nan), axis=0), np.nan
        )
    track = np.where(bad[..., None] if k > 3 else False, np.nan, track)
    position, held = _pool(track, home, near, owner, nodes)
    noise = noise_of(position[:fitted])
    slide = slide_of(np.where(visible[:, usable, None], points[:, usable], np.nan), near)
    return nodes, Sightings(position, held, noise, misfit, wrong, slide)


def middles(nodes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``nodes`` (n, 3), each in the middle of those of ``points`` (M, 3) that it is nearest to, if any; and (M,) these nearest nodes."""
    from scipy.spatial import cKDTree

    owner = cKDTree(nodes).query(points)[1]
    number = np.bincount(owner, minlength=len(nodes))[:, None]
    total = np.stack([np.bincount(owner, axis, len(nodes)) for axis in points.T], 1)
    return np.where(number > 0, total / np.maximum(1, number), nodes), owner


def slide_of(track, near) -> float:
    """log of what 1 in 20 tracks has changed its distance to neighbours by, beyond what these have, in the last quarter over in the first.

    A body that stretches, yields or tears moves neighbours apart from all of theirs alike; a track that slides is alone. It is 0 where
    nothing slides.
    ``track`` (T, N, 3) m, NaN where not seen, ``near`` (N, k) its neighbours in frame 0, itself first.
    """
    near = near[:, 1:6]
    if len(track) < 8 or near.shape[1] < 3:
        return 0.0
    start = np.linalg.norm(track[0][:, None] - track[0][near], axis=-1)

    def spread(frame):
        change = np.abs(np.linalg.norm(track[frame][:, None] - track[frame][near], axis=-1) - start)
        own = np.where(np.isfinite(change).sum(1) >= 3, np.nanmedian(change, axis=1), np.nan)
        beyond = own - np.nanmedian(own[near], axis=1)
        beyond = beyond[np.isfinite(beyond)]
        return np.quantile(beyond, 0.95) if len(beyond) else np.nan

    quarter = len(track) // 4
    with where_unseen():
        quarters = range(2, quarter + 1), range(len(track) - quarter, len(track))
        early, late = (float(np.nanmedian([spread(f) for f in frames])) for frames in quarters)
    return float(np.log(late / early)) if early > 0 and late > 0 else 0.0


def _rotations(track, home, near):
    """Rigid rotations (T, N, 3, 3) that carry each track's seen neighbourhood from frame 0, and its middles then and now."""
    now = track[:, near]  # (T, N, k, 3)
    there = np.isfinite(now[..., 0])
    weight = there / np.maximum(1, there.sum(-1, keepdims=True))
    now = np.where(there[..., None], now, 0.0)
    before = home[near]
    mid_now = (weight[..., None] * now).sum(2)
    mid_before = np.einsum("tnk,nkc->tnc", weight, before)
    a = before[None] - mid_before[:, :, None]
    b = (now - mid_now[:, :, None]) * weight[..., None]
    covariance = np.einsum("tnkc,tnkd->tncd", a, b)
    u, _s, vt = np.linalg.svd(covariance)
    flip = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    vt[..., 2, :] *= np.where(flip == 0, 1, flip)[..., None]
    return np.einsum("tncd,tnde->tnec", u, vt), mid_before, mid_now, there.sum(-1)


def _shared_motion_residual(track, home, near):
    """(T, N) distance of each track from where its neighbourhood's rigid motion puts it [m]; NaN where fewer than 4 tracks tell."""
    rotation, before, now, number = _rotations(track, home, near)
    predicted = np.einsum("tnec,tnc->tne", rotation, home[None] - before) + now
    residual = np.linalg.norm(track - predicted, axis=-1)
    return np.where(number >= 4, residual, np.nan)


def _pool(track, home, near, owner, nodes):
    """Positions (T, n, 3) of the nodes and how many tracks speak for each."""
    if near.shape[1] >= 4:
        rotation, _before, _now, _number = _rotations(track, home, near)
        offset = np.einsum("tnec,nc->tne", rotation, nodes[owner] - home)
    else:
        offset = np.broadcast_to(nodes[owner] - home, track.shape)
    guess = track + offset
    there = np.isfinite(guess[..., 0])
    guess = np.where(there[..., None], guess, 0.0)
    frames, n = len(track), len(nodes)
    flat = (np.arange(frames)[:, None] * n + owner).ravel()
    held = np.bincount(flat, there.ravel(), frames * n).reshape(frames, n)
    total = np.stack([np.bincount(flat, guess[..., c].ravel(), frames * n).reshape(frames, n) for c in range(3)], -1)
    with np.errstate(invalid="ignore", divide="ignore"):
        position = np.where(held[..., None] > 0, total / held[..., None], np.nan)
    return position, held.astype(int)
