"""What hands and the points beside them say without any simulation: hands that are reported late."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datasets.scenario import Observed
from ..methods.registration import rigid_transform
from .replica import fists
from .sightings import where_unseen

__all__ = ["Held", "held_points"]

NEAR = 0.05  # m from a hand's points in frame 0: what it may hold
MOST = 12  # points looked at beside a hand, the nearest ones
SET_OFF = 0.008  # m: a hand that went less far has not said when it moved
LAGS = np.arange(-6.0, 6.01, 0.25)  # frames
BLUR = 5e-4  # m, added to distances whose logs are compared


@dataclass(frozen=True)
class Held:
    """How the points beside one hand move with it.

    lag    frames that the body moves after the reported hand; negative: the hand is reported late
    told   log of the ratio of their distances from the hand's rigid motion, as reported and so shifted
    """

    lag: float
    told: float


def held_points(recording: Observed) -> list[Held]:
    """One entry for every hand (not: driven marker) of ``recording`` with at least three points within ``NEAR`` of it in frame 0."""
    from scipy.spatial import cKDTree

    free = np.flatnonzero(recording.grips < 0)
    frames = min(len(recording.points), len(recording.controllers))
    seen = np.where(recording.visible[:frames, :, None], recording.points[:frames], np.nan)
    usable = np.flatnonzero(recording.visible[0])
    found = []
    fist = fists(recording.controllers[0, free]) if len(free) else np.zeros(0, int)
    for label in np.unique(fist):
        hand = recording.controllers[:, free[fist == label]]
        if len(hand[0]) < 3 or not len(usable):
            continue
        distance = cKDTree(hand[0]).query(recording.points[0, usable])[0]
        near = usable[np.argsort(distance)[: min(MOST, int((distance < NEAR).sum()))]]
        moving = np.flatnonzero(np.linalg.norm(hand[:frames] - hand[0], axis=-1).mean(1) > SET_OFF)
        if len(near) < 3 or len(moving) < 8:
            continue
        found.append(_held(hand, seen[:, near], moving))
    return found


def _held(hand, seen, moving):
    with where_unseen():
        strays = np.array([np.nanmedian(_strays(hand, seen, moving, lag), axis=1) for lag in LAGS])  # (L, moving)
        size = np.nanmean(strays, axis=1)
    if not np.isfinite(size).all():
        return Held(0.0, 0.0)
    best = int(size.argmin())
    asis = int(np.abs(LAGS).argmin())
    return Held(float(LAGS[best]), float(np.log((size[asis] + BLUR) / (size[best] + BLUR))))


def _strays(hand, seen, moving, lag):
    """(frames, points) m from where the rigid motion of the hand, ``lag`` frames earlier, would have carried the points."""
    when = np.clip(moving - lag, 0, len(hand) - 1)
    before = np.minimum(when.astype(int), len(hand) - 2)
    share = (when - before)[:, None, None]
    shifted = (1 - share) * hand[before] + share * hand[before + 1]
    out = np.empty((len(moving), seen.shape[1]))
    for row, (frame, points) in enumerate(zip(moving, shifted, strict=True)):
        rotation, shift = rigid_transform(hand[0], points)
        out[row] = np.linalg.norm(seen[frame] - seen[0] @ rotation.T - shift, axis=1)
    return out
