"""Which points a hand holds, and how firmly: those near it that move as it does."""

from __future__ import annotations

import warnings

import numpy as np

from ...datasets.scenario import Observed

__all__ = ["agreement", "falloff", "firmness_of"]

MOVED = 0.01  # m: a hand that has gone less far has not said what it holds
LEFT = 0.25  # of its way, by which what a hand holds stays behind it at most
STRAY = 2.0  # times the noise of the tracks, by which what a hand holds may stray from its motion
NEIGHBOURS = 6  # tracks that speak for a point that was not seen
LEAST = 0.02  # firmness: less is nothing


def falloff(distance, radius: float) -> np.ndarray:
    """Firmness at a ``distance`` [m] from a hand's controllers: 1 up to half the ``radius``, a half there, 0 from one and a half on.

    Smooth (3 s^2 - 2 s^3), so that gradients by the radius exist.
    """
    s = np.clip(1.5 - np.asarray(distance, float) / radius, 0, 1)
    return s * s * (3 - 2 * s)


def agreement(strays, way, noise: float) -> np.ndarray:
    """(n,) in [0, 1]: whether points that ``strays`` (F, n) [m] from a hand's rigid motion are held; NaN where not seen while it moved.

    way    (F,) m, how far the hand has gone; noise [m] of a track

    A half where the RMS of the strays is ``STRAY`` times the noise and what the nearest points stray, which share the errors of the hand.
    """
    moving = np.asarray(way) > MOVED
    if not moving.any():
        return np.full(np.shape(strays)[1], np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        rms = np.sqrt(np.nanmean(np.square(strays[moving]), axis=0))
    return 1 / (1 + (rms / (STRAY * noise)) ** 4)


def firmness_of(recording: Observed, number: int, hand, radius: float) -> tuple[np.ndarray, tuple[str, ...]]:
    """((M,) firmness of the structure points in ``hand``, notes). ``number`` names it in the error where it holds nothing near it."""
    from scipy.spatial import cKDTree

    structure = recording.structure
    firmness = np.zeros(len(structure))
    driven = recording.grips[hand.controllers]
    free = hand.controllers[driven < 0]
    firmness[driven[driven >= 0]] = 1.0
    if not len(free):
        return firmness, ()
    known = recording.known
    distance = cKDTree(recording.controllers[0, free]).query(structure)[0]
    near = known & (distance < 1.5 * radius)
    moves, notes = _moves_along(recording, hand, np.flatnonzero(near), radius, distance)
    firmness[near] = np.maximum(firmness[near], falloff(distance[near], radius) * moves)
    firmness[firmness < LEAST] = 0.0
    if not firmness.any():
        notes = _nothing_held(recording, number, free, distance[known].min(initial=np.inf))
    return firmness, notes


def _moves_along(recording, hand, near, radius, distance):
    """((n,) in [0, 1], whether the points ``near`` move as the hand does, notes)."""
    from scipy.spatial import cKDTree

    seen = np.flatnonzero(recording.visible[0])
    seen = seen[distance[seen] < 3 * radius]
    way = _way(hand, recording.observed_frames)
    if not recording.correspond:
        return np.ones(len(near)), ("points do not correspond from frame to frame: what it holds is told by distance alone",)
    if not len(near) or not len(seen) or not (way > MOVED).any():
        return np.ones(len(near)), ("it does not move, or nobody was seen near it: what it holds is told by distance alone",)
    tracks = np.where(recording.visible[:, seen, None], recording.points[:, seen], np.nan)
    carried = hand.carried(recording.points[0, seen])[: len(tracks)]
    strays = np.linalg.norm(tracks - carried, axis=-1)
    agrees = agreement(strays, way, _noise(strays, way, distance[seen]))
    speaks = np.isfinite(agrees)
    if not speaks.any():
        return np.ones(len(near)), ("nobody was seen near it while it moved: what it holds is told by distance alone",)
    structure = recording.structure
    speakers, agrees = seen[speaks], agrees[speaks]
    far, who = cKDTree(structure[speakers]).query(structure[near], k=min(NEIGHBOURS, len(speakers)))
    far, who = far.reshape(len(near), -1), who.reshape(len(near), -1)
    weight = 1 / (far + 0.1 * radius) ** 2
    return (weight * agrees[who]).sum(1) / weight.sum(1), ()


def _way(hand, frames):
    """(F,) m, how far the hand is from where it was in frame 0, by moving or turning an arm of 3 cm."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_matrix(hand.rotation[:frames]).magnitude()
    return np.hypot(np.linalg.norm(hand.centre[:frames] - hand.centre[0], axis=1), 0.03 * turned)


def _noise(strays, way, distance):
    """What a held point strays [m]: the lower quartile of the tracks nearest to the hand, but at most ``LEFT`` of its way."""
    moving = way > MOVED
    nearest = np.argsort(distance)[:12]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        rms = np.sqrt(np.nanmean(np.square(strays[moving][:, nearest]), axis=0))
    rms = rms[np.isfinite(rms)]
    most = LEFT * np.sqrt(np.mean(way[moving] ** 2))
    return float(np.clip(np.quantile(rms, 0.25), 1e-4, most / 2)) if len(rms) else most / 2


def _nothing_held(recording, number, free, start):
    """A note where a hand that holds nothing never comes near the body; ValueError where it does."""
    from scipy.spatial import cKDTree

    nearest = start
    for frame in range(recording.observed_frames):
        seen = recording.points[frame, recording.visible[frame]]
        if len(seen):
            nearest = min(nearest, float(cKDTree(seen).query(recording.controllers[frame, free])[0].min()))
    if nearest > recording_reach(recording):
        return (f"it never comes nearer to the body than {1e3 * nearest:.0f} mm, and holds nothing",)
    raise ValueError(
        f"hand {number} (controllers {_listed(free)}) holds nothing: the nearest point of the body is {1e3 * start:.1f} mm away in "
        f"frame 0, and none near it moves along (scenario {recording.name})"
    )


def recording_reach(recording: Observed) -> float:
    """m, within which a hand is near the body: three spacings of its points, at least 2 cm."""
    return max(0.02, 3 * recording.spacing)


def _listed(indices):
    return ", ".join(map(str, indices[:6].tolist())) + (", ..." if len(indices) > 6 else "")
