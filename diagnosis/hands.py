"""What hands hold, and what they and the points beside them say without any simulation: hands that are reported late."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..datasets.scenario import Observed
from ..methods.continuum.hands import labels_of
from ..methods.registration import rigid_transform
from ..physics.topology import controller_springs
from .sightings import where_unseen

__all__ = ["Held", "hand_ties", "held_points", "rope_exits"]

GRIP_REACH = 1.6  # how far a hand point holds nodes, in node spacings
GRIP_MOST = 4
CARRIED = 0.25  # share of its way by which what a hand carries may stay behind
GONE = 0.06  # m: a hand's way while one sees what it carries
IN_HAND = 0.007  # m: what a node of a rope strays at most from where its hand would carry it
WHILE = 1.0  # s since a hand set off, in which that is looked at
EXIT = 0.6  # of the way to the next node, either way, within which a rope may leave a hand from the last node that is held
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


def carried(hand, now, points):
    """(K, n, 3) m, where ``points`` (n, 3) beside a ``hand`` (C, 3) would be were they carried to where it is ``now`` (K, C, 3)."""
    moves = [rigid_transform(hand, there) for there in now]
    return np.array([points @ rotation.T + shift for rotation, shift in moves]).reshape(-1, *np.shape(points))


def hand_ties(recording: Observed, positions, seen, spacing: float, hands, *, rope: bool = False) -> np.ndarray:
    """(L, 2) springs between nodes and hand points: within reach of each other in frame 0, and at first carried along by that hand.

    positions  (n, 3) m, nodes in frame 0, ``spacing`` [m] apart; seen (T, n, 3) m, where they were seen, NaN where not
    hands      which of the recording's controllers are points of hands

    Of a ``rope`` only what is in the hand: a node beyond where it leaves the hand, if that held it too, would keep it from turning there.
    """
    from scipy.spatial import cKDTree

    ties = controller_springs(recording.controllers[0, hands], positions, radius=GRIP_REACH * spacing, max_neighbours=GRIP_MOST).astype(int)
    if not len(hands):
        return np.zeros((0, 2), int)
    if not len(ties):
        near = cKDTree(positions).query(recording.controllers[0, hands])[1]
        ties = np.stack([np.arange(len(hands)), near], 1)
    hand_of = labels_of(recording.controllers[:1, hands])
    kept = np.ones(len(ties), bool)
    for label in np.unique(hand_of):
        mine = np.flatnonzero(hand_of[ties[:, 0]] == label)
        nodes = np.unique(ties[mine, 1])
        hand = recording.controllers[:, hands[hand_of == label]]
        behind = _left_behind(hand, seen[:, nodes], positions[nodes])
        held = nodes[behind <= max(CARRIED, np.sort(behind)[:2].max())]
        if rope:
            held = held[_in_hand(hand, seen[:, held], positions[held], recording.fps)]
        kept[mine] = np.isin(ties[mine, 1], held)
    ties = ties[kept]
    ties[:, 0] = len(positions) + hands[ties[:, 0]]
    return ties


def rope_exits(recording: Observed, positions, seen, chains, ties) -> np.ndarray:
    """``positions`` (n, 3) of a rope's nodes [m], the last that a hand holds by ``ties`` moved to where the rope leaves the hand.

    That is the point from which the first free node of its ``chains`` keeps its distance along the rope, however the rope turns there, as
    it was ``seen`` (T, n, 3). All controllers are hands.
    """
    found = positions.copy()
    hand_of = labels_of(recording.controllers[:1])
    holder = dict(zip(ties[:, 1].tolist(), hand_of[ties[:, 0] - len(positions)].tolist(), strict=True))
    steps = [step for chain in chains for step in (*pairwise(chain.tolist()), *pairwise(chain[::-1].tolist()))]
    for last, free in steps:
        if last not in holder or free in holder:
            continue
        hand = recording.controllers[:, hand_of == holder[last]]
        first = _first_while(hand, len(seen), recording.fps)
        step = positions[free] - positions[last]
        share = np.linspace(-EXIT, EXIT, 21)
        exits = positions[last] + share[:, None] * step
        apart = np.linalg.norm(seen[first, free][:, None] - carried(hand[0], hand[first], exits), axis=-1)
        stretch = apart - (1 - share) * np.linalg.norm(step)
        if np.isfinite(stretch).any():
            found[last] = exits[np.nanmean(stretch**2, axis=0).argmin()]
    return found


def _way(hand):
    """(T,) m, how far a hand (T, C, 3) is from where it was in frame 0."""
    return np.linalg.norm(hand - hand[0], axis=-1).mean(1)


def _first_while(hand, frames, fps) -> slice:
    """Which of so many ``frames`` are the first ``WHILE`` in which a hand (T, C, 3) moves."""
    way = _way(hand)[:frames]
    begun = int(np.argmax(way > SET_OFF))
    return slice(begun, min(len(way), begun + round(WHILE * fps)))


def _left_behind(hand, seen, start):
    """(n,) how far nodes at ``start`` (n, 3), ``seen`` (T, n, 3), stay behind a hand (T, C, 3) while it first moves, over its way."""
    way = _way(hand)
    moving = np.flatnonzero((way > SET_OFF) & (np.arange(len(way)) < (np.argmax(way > GONE) or len(way))))
    moving = moving[moving < len(seen)][:12]
    if not len(moving):
        return np.zeros(len(start))
    shares = np.linalg.norm(seen[moving] - carried(hand[0], hand[moving], start), axis=-1) / way[moving, None]
    with where_unseen():
        stray = np.nanmedian(shares, axis=0)
    return np.where(np.isfinite(stray), stray, 0.0)


def _in_hand(hand, seen, start, fps):
    """(n,) bool: which nodes of a rope at ``start`` (n, 3), ``seen`` (T, n, 3), a hand (T, C, 3) holds; two at least: it turns them.

    A node that was not seen is in the hand if it is no farther from the middle of the hand's points than these are.
    """
    first = _first_while(hand, len(seen), fps)
    with where_unseen():
        stray = np.nanmedian(np.linalg.norm(seen[first] - carried(hand[0], hand[first], start), axis=-1), axis=0) / IN_HAND
    middle = hand[0].mean(0)
    radius = np.sqrt(np.mean(np.sum((hand[0] - middle) ** 2, axis=1)))
    far = np.linalg.norm(start - middle, axis=1)
    beyond = np.where(np.isfinite(stray), stray, far / max(radius, far.min()))
    return beyond <= max(1.0, np.sort(beyond)[:2].max())


def held_points(recording: Observed) -> list[Held]:
    """One entry for every hand (not: driven marker) of ``recording`` with at least three points within ``NEAR`` of it in frame 0."""
    from scipy.spatial import cKDTree

    free = np.flatnonzero(recording.grips < 0)
    frames = min(len(recording.points), len(recording.controllers))
    seen = np.where(recording.visible[:frames, :, None], recording.points[:frames], np.nan)
    usable = np.flatnonzero(recording.visible[0])
    found = []
    hand_of = labels_of(recording.controllers[:1, free])
    for label in np.unique(hand_of):
        hand = recording.controllers[:, free[hand_of == label]]
        if len(hand[0]) < 3 or not len(usable):
            continue
        distance = cKDTree(hand[0]).query(recording.points[0, usable])[0]
        near = usable[np.argsort(distance)[: min(MOST, int((distance < NEAR).sum()))]]
        moving = np.flatnonzero(_way(hand[:frames]) > SET_OFF)
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
    return np.linalg.norm(seen[moving] - carried(hand[0], shifted, seen[0]), axis=-1)
