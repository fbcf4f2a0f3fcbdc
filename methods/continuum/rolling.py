"""How the skin of a filmed rope goes about its axis: with the hands that hold it, and as its tracks tell.

A rope's twist is at rest: its skin turns with the hand that holds it, is without twist from there to the ends, and evenly twisted between
two hands. What rolls it beside that, the table and a twist that it has by itself, an axis does not tell, and points on a skin are a radius
off for it. A dozen tracks show it to some degrees, so it is measured, and not predicted.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...datasets.scenario import Observed
from ...physics.hinges import Ropes, rolled, transport, unit
from .hands import frames_of, groups_of, steadied

__all__ = ["Rolling"]

EACH = 20  # tracks of a window along the rope
MOST = 24  # windows
OVERLAP = 1.5  # of the way from window to window, that one is long
FEWEST = 8  # tracks seen in a window, three more than a fit has columns
SURE = 0.05  # rad, standard deviation of an angle, at least: frame 0, in which it is known, must not outweigh its neighbours
UNSURE = 0.5  # rad, of one that tells nothing any more
NOISE = 2e-4  # m of a track, at least
HOLDS = 0.05  # m, from the axis to a hand's nearest controller in frame 0, at most: a hand that turns elsewhere turns no rope
NEAR = (2.0, 1.0), (8.0, 2.0), (32.0, 8.0)  # frames and windows over which angles are averaged; the farther where nearer ones say nothing
FADED = 1e-2  # what the next farther count beside the nearer


@dataclass(frozen=True, eq=False)
class Rolling:
    """Of K windows along a rope in T frames that were observed.

    share    (K,) of the rope's length, where each is
    home     (K, 3) a unit vector across the axis there in frame 0
    seen     (T, K, 3) where that points to later, by the tracks
    weight   (T, K) 1 / rad^2, how well they tell it; 0 where they do not
    held     (H,) of its length, where hands hold it whose turning is told, and their ``turns`` (H, T', 3, 3) since frame 0, the last of
             which lasts
    """

    share: np.ndarray
    home: np.ndarray
    seen: np.ndarray
    weight: np.ndarray
    held: np.ndarray
    turns: np.ndarray

    @classmethod
    def of(cls, recording: Observed, axis) -> Rolling | None:
        """Of the tracks around ``axis`` (n, 3) m in frame 0, and of the hands; None where points do not correspond from frame to frame, or
        are too few.

        In a window tracks are a polynomial of second order in their place along the rope, and linear in where they are across it in frame
        0: the two slopes of the latter are where its directions across went (least squares).
        """
        count = recording.points.shape[1]
        if not recording.correspond or count < EACH:
            return None
        axis = np.asarray(axis, float)
        ropes = Ropes.of([np.arange(len(axis))])
        middle, tangent, across = (axis[1:] + axis[:-1]) / 2, unit(np.diff(axis, axis=0)), ropes.directors(axis)
        arc = np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))
        start = np.nan_to_num(recording.points[0])
        near = np.linalg.norm(start[:, None] - middle, axis=2).argmin(1)
        aside = start - middle[near]
        along = np.where(recording.visible[0], (arc[near] + (aside * tangent[near]).sum(1)) / arc[-1], np.nan)
        sides = np.stack([(aside * d[near]).sum(1) for d in (across, np.cross(tangent, across))], 1)
        windows = int(np.clip(count // EACH, 1, MOST))
        share = (np.arange(windows) + 0.5) / windows
        found = [_window(recording, along - s, OVERLAP / windows, sides) for s in share]
        own = np.minimum((share * len(middle)).astype(int), len(middle) - 1)
        held, turns = [], []
        for hand in groups_of(recording.controllers):
            turn, centre, told = frames_of(recording.controllers[:, hand])
            gap = np.linalg.norm(recording.controllers[0, hand][:, None] - middle, axis=2).min()
            if told != "point" and gap < HOLDS:
                held.append(arc[np.linalg.norm(middle - centre[0], axis=1).argmin()] / arc[-1])
                turns.append(steadied(turn, recording.fps))
        seen, weight = (np.stack(parts, 1) for parts in zip(*found, strict=True))
        return cls(share, across[own], seen, weight, np.array(held), np.array(turns))

    def turned(self, ways, home) -> np.ndarray:
        """(T', S, 3, 3), how what is at each of S segments has turned since frame 0, in which they pointed along ``home`` (S, 3), while
        they point along ``ways`` (T', S, 3)."""
        start = _carried_along(home[None], 0, _beside(np.eye(3)[np.abs(home[0]).argmin()], home[0])[None])[0]  # without twist
        across, before = self._with_hands(ways, start), np.swapaxes(_axes(home, start), -1, -2)
        angles = self._angles(_axes(ways, across) @ before, ways)
        return _axes(ways, rolled(across, ways, angles)) @ before

    def _with_hands(self, ways, across):
        """(T', S, 3) where directions ``across`` (S, 3) segments go if hands alone turn the rope about itself; of one that nobody holds its
        middle turns least."""
        count = len(across)
        at = np.minimum((self.held * count).astype(int), count - 1)
        if not len(at):
            found = [across[count // 2]]
            for before, now in pairwise(ways[:, count // 2]):
                found.append(transport(found[-1][None], before[None], now[None])[0])
            return _carried_along(ways, count // 2, np.array(found))
        kept = np.minimum(np.arange(len(ways)), self.turns.shape[1] - 1)
        own = [turns[kept] @ across[k] for k, turns in zip(at, self.turns, strict=True)]
        found, middles = _carried_along(ways, at[0], _beside(own[0], ways[:, at[0]])), np.arange(count)
        for k, turned in zip(at[1:], own[1:], strict=True):
            angle = np.unwrap(_angle(found[:, k], turned, ways[:, k]))
            if k != at[0]:
                twist = angle[:, None] * np.clip((middles - at[0]) / (k - at[0]), 0, 1)
                found = rolled(found, ways, twist)
        return found

    def _angles(self, turned, ways):
        """(T', S) rad by which segments have rolled beside what has ``turned`` (T', S, 3, 3) and points along ``ways`` (T', S, 3): averaged
        over neighbours in place and time, the last that was observed from there on."""
        from scipy.ndimage import gaussian_filter

        frames, count = min(len(ways), len(self.seen)), ways.shape[1]
        own = np.minimum((self.share * count).astype(int), count - 1)
        told = np.einsum("tkij,kj->tki", turned[:frames, own], self.home)
        heard = self.weight[:frames] * np.exp(1j * _angle(told, self.seen[:frames], ways[:frames, own]))
        total, share = np.zeros(heard.shape, complex), 1.0
        for spread in NEAR:
            total += share * (gaussian_filter(heard.real, spread) + 1j * gaussian_filter(heard.imag, spread))
            share *= FADED
        middles = (np.arange(count) + 0.5) / count
        rolled = np.stack([np.interp(middles, self.share, row.real) + 1j * np.interp(middles, self.share, row.imag) for row in total])
        found = np.angle(rolled)
        found[0] = 0.0
        return np.concatenate([found, np.repeat(found[-1:], len(ways) - frames, 0)])


def _angle(before, after, about):
    """(...) rad from ``before`` to ``after`` (..., 3) about unit vectors (..., 3)."""
    return np.arctan2((np.cross(about, before) * after).sum(-1), (before * after).sum(-1))


def _beside(vectors, ways):
    """(..., 3) ``vectors`` without what lies along ``ways``, at length 1."""
    return unit(vectors - (vectors * ways).sum(-1, keepdims=True) * ways)


def _axes(ways, across):
    """(..., 3, 3) with columns along, across, and across both."""
    return np.stack([ways, across, np.cross(ways, across)], -1)


def _carried_along(ways, first, start):
    """(T, S, 3) directions across ``ways`` (T, S, 3) without twist from ``start`` (T, 3) at segment ``first`` on."""
    found = np.zeros_like(ways)
    found[:, first] = start
    for k in range(first + 1, ways.shape[1]):
        found[:, k] = transport(found[:, k - 1], ways[:, k - 1], ways[:, k])
    for k in range(first - 1, -1, -1):
        found[:, k] = transport(found[:, k + 1], ways[:, k + 1], ways[:, k])
    return found


def _window(recording, off, length, sides):
    """((T, 3) where the first direction across points to, (T,) weights) in a window, ``off`` (N,) its middle and ``length`` long, both as
    shares of the rope's, by tracks that are at ``sides`` (N, 2) m across it in frame 0."""
    own = np.flatnonzero(np.abs(off) < length / 2)
    seen, points = recording.visible[:, own], np.nan_to_num(recording.points[:, own])
    x = off[own] / length
    radius = max(float(np.sqrt(np.mean(np.square(sides[own])))), NOISE) if len(own) else NOISE
    columns = np.stack([np.ones(len(own)), x, x * x, *(sides[own].T / radius)], 1)
    enough = seen.sum(1) >= FEWEST
    square = np.einsum("tn,ni,nj->tij", seen.astype(float), columns, columns) + 1e-9 * np.eye(5)
    inverse = np.linalg.inv(square)
    slopes = np.einsum("tij,tjc->tic", inverse, np.einsum("tn,ni,tnc->tic", seen.astype(float), columns, points))
    left = np.where(seen[..., None], points - np.einsum("ni,tic->tnc", columns, slopes), 0.0)
    freedom = 3 * np.maximum(seen.sum(1) - 5, 1)
    noise = max(float(np.sqrt(np.median((left**2).sum((1, 2))[enough] / freedom[enough]))), NOISE) if enough.any() else NOISE
    tangent, first, second = unit(slopes[:, 1]), slopes[:, 3], slopes[:, 4]
    way = first - (first * tangent).sum(1, keepdims=True) * tangent + np.cross(second, tangent)
    size = np.linalg.norm(way, axis=1)
    error = noise * np.sqrt(inverse[:, 3, 3] + inverse[:, 4, 4]) / np.maximum(size, 1e-12)
    weight = np.where(enough & (error < UNSURE), 1 / np.maximum(error, SURE) ** 2, 0.0)
    return unit(way), weight
