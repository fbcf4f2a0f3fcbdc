"""How the joints of a hanging chain of markers bend otherwise under one command, and which weight or stiffness would do that.

Motors that no twin has (tendons, say) bend a body alike in two recordings of one command. A joint, which is a marker between two parts
of the chain, bends by beta = M / k under the moment M of all that acts beyond it, k its stiffness [N m/rad], about axes that go along with
the part before. So a further weight W at a marker beyond it adds

    d beta = (W / k) r x g,    r [m] from the joint to that marker, g the unit vector of gravity,

at all joints before that marker and at none behind it, and a joint whose stiffness is exp(s) times as large bends by d beta = -s beta. The
mean of all recordings tells r and beta: what runs of one command stray by is then in no way alike in them and in the difference, and both
laws are right to second order. W / k, which is not negative, and s are fitted. How stiff joints are, and so how much W weighs, recordings
of slow motions do not tell. What differs alike all the time (a marker that was fastened elsewhere, a tilted base) is left out by its mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..datasets.scenario import Scenario
from ..methods.continuum.chains import marked_chains
from ..physics.hinges import transport
from .inference.contrast import check_hands, inputs_apart

__all__ = ["BIN", "MASS", "STIFFNESS", "Chain", "Difference", "Explanation", "chain_of", "compared", "hung"]

MASS, STIFFNESS = "added_mass", "stiffness"
ASKED = ((MASS,), (STIFFNESS,), (MASS, STIFFNESS))
BIN = 0.5  # s of which means are taken: a free swing of such a body, over which inertia averages out
APART = 10.0  # s by which the mean recording is shifted in time at least, where it is to tell nothing
SHIFTS = 199  # at most: a p-value goes down to 0.005
ROUNDS = 2  # in which slopes and how errors go on are told from each other
FEWEST = 40  # bins: a dozen for each of the numbers of three joints
MOTORS = 0.2  # of how far a motor's angle varies: measured ones of one command differ by 0.1, of another by more than 1


@dataclass(frozen=True, eq=False)
class Chain:
    """``places`` (B, J + 1, 3) m, means of bins of the markers from the last held one on, NaN where unseen; ``base`` (B, 3), the unit
    vector of the part before; ``down`` (3,) that of gravity. The first of J joints is at the last held marker, the others are at each
    further one but the last."""

    places: np.ndarray
    base: np.ndarray
    down: np.ndarray

    @cached_property
    def ways(self) -> np.ndarray:
        """(B, J + 1, 3), unit vectors of the parts, the one before the first joint first."""
        ways = np.diff(self.places, axis=1)
        return np.concatenate([self.base[:, None], ways / np.linalg.norm(ways, axis=2, keepdims=True)], axis=1)

    @cached_property
    def frames(self) -> np.ndarray:
        """(B, J, 2, 3), the axes about which a joint bends: across the part before it, carried along from part to part without a twist."""
        before, found = np.broadcast_to(self.down, self.base.shape), []
        axes = [np.broadcast_to(axis, self.base.shape) for axis in np.linalg.svd(self.down[None])[2][1:]]
        for way in self.ways[:, :-1].swapaxes(0, 1):
            axes = [transport(axis, before, way) for axis in axes]
            found.append(np.stack(axes, 1))
            before = way
        return np.stack(found, 1)

    @cached_property
    def bends(self) -> np.ndarray:
        """(B, J, 2) rad: the rotation from a part to the next, about the joint's ``frames``."""
        axis = np.cross(self.ways[:, :-1], self.ways[:, 1:])
        size = np.linalg.norm(axis, axis=2, keepdims=True)
        angle = np.arctan2(size, (self.ways[:, :-1] * self.ways[:, 1:]).sum(2, keepdims=True))
        return np.einsum("bji,bjci->bjc", axis * angle / np.maximum(size, 1e-12), self.frames)

    @cached_property
    def levers(self) -> np.ndarray:
        """(B, J, J, 3) m, from each joint to each marker beyond it; 0 where it is not beyond."""
        levers = self.places[:, None, 1:] - self.places[:, :-1, None]
        return levers * np.triu(np.ones(levers.shape[1:3]))[None, :, :, None]

    @cached_property
    def moments(self) -> np.ndarray:
        """(B, J, J, 2) m, r x g about the joint's ``frames``."""
        return np.einsum("bjki,bjci->bjkc", np.cross(self.levers, self.down), self.frames)

    def moved(self, bends: np.ndarray) -> np.ndarray:
        """(B, J, 3) m, how far joints that bend by a little more, ``bends`` (B, J, 2) rad, move the markers beyond the first joint."""
        turns = np.einsum("bjc,bjci->bji", bends, self.frames)
        return np.cross(turns[:, :, None], self.levers).sum(1)


@dataclass(frozen=True, eq=False)
class Explanation:
    """names    of what acts; ``marker`` the one that is heavier, the first beyond the first joint is 0, or -1
    nats        by which it is likelier than nothing, less half the log of the number of bins for each number (Schwarz 1978)
    values      (2, J): W / k [1/m] and s, a logarithm, of each joint, 0 where not asked, with standard deviations ``sds`` (2, J)
    bends       (B, J, 2) rad, how it says that the joints bend otherwise
    """

    names: tuple[str, ...]
    marker: int
    nats: float
    values: np.ndarray
    sds: np.ndarray
    bends: np.ndarray


@dataclass(frozen=True, eq=False)
class Difference:
    """differ   (B, J, 3) m between the markers beyond the first joint, and ``bends`` (B, J, 2) rad between the joints; ``seen``, ``fitted``
                (B,) bins
    explanations  the likeliest first; ``p`` that a motion which has nothing to do with the difference explains as much of it, and
                  ``usual``, the nats that 97 of 100 such motions stay below
    chain, order  the mean of all recordings, and the markers of the chain from the last held one on
    """

    differ: np.ndarray
    bends: np.ndarray
    seen: np.ndarray
    fitted: np.ndarray
    explanations: tuple[Explanation, ...]
    p: float
    usual: float
    chain: Chain
    order: np.ndarray

    def best(self, *names: str) -> Explanation:
        """The likeliest of these names."""
        return next(one for one in self.explanations if one.names == names)

    def gain(self, one: Explanation) -> float:
        """The share that an explanation predicts of how joints differ on frames held out, around the mean of those that were fitted."""
        rows, used = self.seen & ~self.fitted, self.seen & self.fitted
        whole = ((self.bends[rows] - self.bends[used].mean(0)) ** 2).sum()
        return float(1 - ((self.bends[rows] - one.bends[rows]) ** 2).sum() / whole) if whole > 0 else 0.0

    def off(self, one: Explanation | None = None) -> np.ndarray:
        """(B, J, 3) m between the markers of both recordings, beside what is explained."""
        return self.differ - (self.chain.moved(one.bends) if one else 0.0)

    def left(self, one: Explanation | None = None, *, fitted: bool = False) -> float:
        """m, the mean distance between them on frames held out, or ``fitted``."""
        rows = self.seen & (self.fitted if fitted else ~self.fitted)
        return float(np.linalg.norm(self.off(one)[rows], axis=2).mean()) if rows.any() else np.nan


def hung(recording: Scenario) -> tuple[np.ndarray, int]:
    """(The markers of a recording from its held end on, how many of them are held).

    Raises ValueError where they are no single chain that hangs from one end, two of them held.
    """
    where = f" (scenario {recording.name})"
    chains = marked_chains(recording.points[0], np.asarray(recording.interior), _tracks(recording))
    if len(chains) != 1:
        raise ValueError(f"joints are told of one chain of markers, got {len(chains)}{where}")
    order = np.asarray(chains[0])
    order = order[::-1] if order[-1] in recording.grips else order
    held = np.isin(order, recording.grips)
    count = int(held.sum())
    if count < 2 or not held[:count].all() or len(order) < count + 2:
        said = ", ".join("held" if one else "free" for one in held)
        raise ValueError(f"a chain must be held at one end by two markers or more, and two or more be free; got {said}{where}")
    return order, count


def chain_of(recording: Scenario) -> tuple[Chain, np.ndarray]:
    """(The chain of a recording's markers, which of them it is made of, from the last held one on). Raises ValueError as ``hung``."""
    order, count = hung(recording)
    places, gravity = _binned(_tracks(recording)[:, order], recording.fps), np.asarray(recording.gravity, float)
    base = places[:, count - 1] - places[:, count - 2]
    base = base / np.linalg.norm(base, axis=1, keepdims=True)
    return Chain(places[:, count - 1 :], base, gravity / np.linalg.norm(gravity)), order[count - 1 :]


def _tracks(recording):
    return np.where(recording.visible[..., None], recording.points, np.nan)


def _binned(tracks, fps):
    """(B, n, 3), means of bins of which half is seen at least."""
    each = max(1, round(BIN * fps))
    bins = tracks[: len(tracks) // each * each].reshape(-1, each, *tracks.shape[1:])
    seen = np.isfinite(bins).all(3)
    count = seen.sum(1)[..., None]
    return np.where(2 * count >= each, np.where(seen[..., None], bins, 0.0).sum(1) / np.maximum(count, 1), np.nan)


def compared(case: Scenario, sound: Sequence[Scenario], *, seed: int = 0) -> Difference:
    """How ``case`` differs from the mean of ``sound`` recordings of the same command.

    Numbers are fitted to the bins of the train frames. p is the rank of the largest evidence among those of the mean recording shifted in
    time against the difference, in which either goes on from bin to bin as it does (Theiler and others 1992). From itself a recording does
    not differ, and p is 1. Raises ValueError as ``chain_of``; for recordings of other markers, rate or length, whose hands or motors go
    otherwise; and where fewer than ``FEWEST`` bins of the train frames show all markers in all of them.
    """
    for one in sound:
        _check_command(case, one)
    own, order = chain_of(case)
    chains = [chain_of(one)[0] for one in sound]
    chain = replace(own, **{name: np.mean([getattr(c, name) for c in (own, *chains)], 0) for name in ("places", "base")})
    differ = own.bends - np.mean([c.bends for c in chains], 0)
    fitted = np.arange(len(differ)) < case.split.train_end // max(1, round(BIN * case.fps))
    seen = np.isfinite(differ).all((1, 2))
    if (count := int((seen & fitted).sum())) < FEWEST:
        said = f"recordings of one command must show all markers in {FEWEST} bins of {BIN:g} s that are fitted, got {count}"
        raise ValueError(f"{said} (scenario {case.name})")
    found, p, usual = _explained(differ, chain.bends, chain.moments, seen & fitted), 1.0, 0.0
    if np.any(differ[seen]):
        least = min(round(APART / BIN), len(differ) // 4)
        shifts = np.random.default_rng(seed).permutation(np.arange(least, len(differ) - least))[:SHIFTS]
        parts = (chain.bends, chain.moments, seen)
        rolled = (tuple(np.roll(one, by, axis=0) for one in parts) for by in shifts)
        others = np.array([_explained(differ, bends, moments, there & seen & fitted)[0].nats for bends, moments, there in rolled])
        p, usual = float((1 + np.sum(others >= found[0].nats)) / (1 + len(others))), float(np.quantile(others, 0.97))
    far = own.places - np.mean([c.places for c in chains], 0)
    return Difference(far[:, 1:], differ, seen, fitted, tuple(found), p, usual, chain, order)


def _check_command(case: Scenario, sound: Scenario) -> None:
    where = f" (scenario {sound.name})"
    if case.fps != sound.fps or case.points.shape != sound.points.shape or case.controllers.shape != sound.controllers.shape:
        told = f"{case.points.shape} at {case.fps:g} Hz and {sound.points.shape} at {sound.fps:g} Hz"
        raise ValueError(f"recordings of one command must have the same markers, hands, frames and rate, got {told}{where}")
    check_hands(case, sound)
    one, other = case.actuation, sound.actuation
    if one is None or other is None or one.shape != other.shape:
        told = [None if a is None else a.shape for a in (one, other)]
        raise ValueError(f"motors must be told alike in recordings of one command, got {told[0]} and {told[1]}{where}")
    share = inputs_apart(one, other)
    if (most := float(share.max(initial=0.0))) > MOTORS:
        said = f"motor {int(share.argmax())} differs by {most:.2f} of how far it varies"
        raise ValueError(f"motors must go within {MOTORS:g} of how far they vary, got {said}{where}")


def _explained(differ, bends, moments, used) -> list[Explanation]:
    """All explanations of ``differ`` (B, J, 2) by a chain's ``bends`` and ``moments`` in bins that are ``used``, the likeliest first."""
    found = []
    for names in ASKED:
        for marker in range(differ.shape[1]) if MASS in names else (-1,):
            heavy = moments[:, :, marker] if MASS in names else None
            found.append(_explanation(names, marker, differ, heavy, -bends if STIFFNESS in names else None, used))
    return sorted(found, key=lambda one: -one.nats)


def _explanation(names, marker: int, differ, heavy, stiff, used) -> Explanation:
    """By what a weight at the ``marker`` (``heavy``, of joints before it) and stiffness (``stiff``) add, (B, J, 2) each or None."""
    count = differ.shape[1]
    values, sds, nats, free = np.zeros((2, count)), np.zeros((2, count)), 0.0, 0
    bends = np.broadcast_to(differ[used].mean(0), differ.shape).copy()
    for j in range(count):
        ways = {0: heavy[:, j]} if heavy is not None and j <= marker else {}
        ways |= {1: stiff[:, j]} if stiff is not None else {}
        free += len(ways)
        if found := _pulling(differ[:, j], ways, used):
            rows = found[0]
            values[rows, j], sds[rows, j], gained, bends[:, j] = found[1]
            nats += gained
    nats -= free / 2 * np.log(max(2, int(used.sum())))
    return Explanation(tuple(names), marker, float(nats), values, sds, bends)


def _pulling(differ, ways: dict[int, np.ndarray], used):
    """(Rows of ``values`` that act, what ``_regressed`` returns of them), or None; no weight acts where it would have to pull upwards."""
    if not ways:
        return None
    found = _regressed(differ, np.stack(list(ways.values()), 2), used)
    if 0 in ways and found[0][0] < 0:
        return _pulling(differ, {row: way for row, way in ways.items() if row}, used)
    return list(ways), found


def _regressed(differ, ways, used) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """(slopes (k,), standard deviations, nats that they gain, (B, 2) what they predict) of ``differ`` (B, 2) on ``ways`` (B, 2, k).

    One slope for both components. Errors go on from bin to bin, by a coefficient that is fitted (Cochrane and Orcutt 1949).
    """
    middle, zero = ways[used].mean(0), differ[used].mean(0)
    y, x = np.where(used[:, None], differ - zero, 0.0), np.where(used[:, None, None], ways - middle, 0.0)
    pairs, rho = used[1:] & used[:-1], 0.0
    for _ in range(ROUNDS):
        rho = _goes_on(y - x @ _slopes(x, y, pairs, rho), pairs)
    slopes, (target, given) = _slopes(x, y, pairs, rho), _whitened(x, y, pairs, rho)
    left, nothing = float(((target - given @ slopes) ** 2).mean()), float((target**2).mean())
    nats = len(target) / 2 * np.log(nothing / max(left, 1e-12 * nothing)) if nothing > 0 else 0.0
    return slopes, np.sqrt(np.diag(np.linalg.pinv(given.T @ given)) * left), float(nats), zero + (ways - middle) @ slopes


def _whitened(x, y, pairs, rho: float):
    """((2n,), (2n, k)): of ``y`` (B, 2) and ``x`` (B, 2, k) what does not go on from the bin before, for both components of n ``pairs``."""
    target, given = ((a[1:] - rho * a[:-1])[pairs] for a in (y, x))
    return target.ravel(), given.reshape(-1, x.shape[2])


def _slopes(x, y, pairs, rho: float) -> np.ndarray:
    target, given = _whitened(x, y, pairs, rho)
    return np.linalg.lstsq(given.T @ given, given.T @ target, rcond=None)[0]


def _goes_on(off, pairs) -> float:
    """The share of ``off`` (B, 2) that goes on from a bin to the next."""
    power = float((off[:-1][pairs] ** 2).sum())
    return float(np.clip((off[1:][pairs] * off[:-1][pairs]).sum() / power, 0.0, 0.95)) if power > 0 else 0.0
