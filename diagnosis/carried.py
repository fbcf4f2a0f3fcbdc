"""How well what a hand holds goes with it, told by tracks alone: what is held firmly is carried as one with its hand.

Tracks beside a hand are compared with where its rigid motion would carry them. What they stray from there is told in the hand's own strays,
its points' from that motion, which noise and soft fingers make, or in the noise of tracks: a hand that gives way, lets slip, or is reported
late or in other axes, leaves more. That a twin's fit makes up for it by a grip that holds less, or elsewhere, does not touch it.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..datasets.scenario import Observed
from ..methods.continuum.hands import carry, frames_of, groups_of, steadied
from .sightings import noise_of

__all__ = ["Beside", "beside", "stray_of"]

NEAR = 0.02  # m, from a hand's points in frame 0: a finger's width, in which most is held
MOST, FEWEST = 16, 4  # tracks of a hand that are looked at, the nearest ones
GONE = 0.02  # m, that a hand must have carried a track: before, nothing strays
SEEN = 4  # frames in which a track must be seen there


@dataclass(frozen=True, eq=False)
class Beside:
    """Tracks beside one hand: how far it would have ``carried`` them from frame 0 (T, n, 3) m, and how far they went, ``gone`` (T, n, 3) m,
    NaN where they were not seen or it had not carried them far; ``own`` m, RMS of the hand's points from its rigid motion, or the noise of
    tracks where that is more, as of a hand whose path a robot tells."""

    carried: np.ndarray
    gone: np.ndarray
    own: float


def beside(recording: Observed, within: float = NEAR, most: int = MOST) -> Iterator[Beside]:
    """Of each hand whose points tell how it moves and turns, and that drives no marker, the ``most`` tracks that are nearest to it in frame
    0 and ``within`` m of its points, if there are enough."""
    from scipy.spatial import cKDTree

    frames = recording.observed_frames
    points = np.where(recording.visible[:frames, :, None], recording.points[:frames], np.nan)
    begun, noise = np.flatnonzero(recording.visible[0]), np.sqrt(3) * noise_of(points)
    for members in groups_of(recording.controllers) if len(begun) else ():
        hand = recording.controllers[:frames, members]
        rotation, centre, told = frames_of(hand)
        if told != "all" or (recording.grips[members] >= 0).any():
            continue
        rotation = steadied(rotation, recording.fps)
        far = cKDTree(hand[0]).query(points[0, begun])[0]
        near = begun[[k for k in np.argsort(far)[:most] if far[k] < within]]
        if len(near) < FEWEST:
            continue
        there, own = (carry(rotation, centre, at) for at in (points[0, near], hand[0]))
        carried, gone = there - points[0, near], points[:, near] - points[0, near]
        gone[np.linalg.norm(carried, axis=2) < GONE] = np.nan
        yield Beside(carried, gone, max(float(np.sqrt(np.mean(np.sum((hand - own) ** 2, 2)))), noise))


def stray_of(recording: Observed, floor: float) -> float | None:
    """Logarithm of how far tracks beside a hand stray from where it would carry them, of the hand where that is most, over its own strays
    and the ``floor`` [m] that anything may be off by: of the median track, RMS over frames. None where no hand tells."""
    found = []
    for one in beside(recording):
        square = np.sum((one.gone - one.carried) ** 2, 2)
        seen = np.isfinite(square).sum(0) >= SEEN
        if seen.sum() < FEWEST:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of frames in which no track is seen
            strays = np.sqrt(np.nanmean(square[:, seen], 0))
        found.append(np.log(max(float(np.median(strays)), 1e-9) / np.hypot(one.own, floor)))
    return max(found, default=None)
