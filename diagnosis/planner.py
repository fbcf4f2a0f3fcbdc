"""Which motion would tell two readings apart, and what each outcome would mean.

Both readings are twins that fit what was recorded. A motion separates them by as much as their predictions differ that nothing which the
fits left open can close: T-optimality (Atkinson and Fedorov 1975), linear in what is open, for both sides. With columns J of one standard
deviation of the knobs of either fit, and R the variance of what is observed,

    D^2 = min_u (y_A - y_B - J u)' R^-1 (y_A - y_B - J u) + u' u

In R are the noise, the error that such twins are known to make, and what a start that is only known as well as it was seen grows to: a
motion after which nobody can say where the body is tells nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np

from ..methods.continuum.hands import labels_of
from .fit import INDEPENDENT, Fit, floor_of
from .inquiry import Inquiry
from .model import Simulator
from .motions import TELLING, VISIBLE, Motion, Setting, figures, motions, outcome_words
from .parts import MARGIN
from .refit import Verdictable
from .replica import Replica
from .verdict import Decision

__all__ = ["Plan", "experiment", "plan", "setting_of"]

MODES = 6  # directions in which a fit is least sure, that may close the gap
SHARE = 0.5  # of a standard deviation: step of finite differences
TRIED = 6  # motions whose gap is looked into


@dataclass(frozen=True)
class Side:
    """One side: its name, the clause after "if", and its twin."""

    name: str
    says: str
    fit: Fit


@dataclass(frozen=True)
class Look:
    """Where the outcome shows best: how far a node is from a hand along ``axis`` (3,), by either reading [m], give or take ``within``."""

    frame: int
    node: int
    hand: int
    axis: np.ndarray
    offsets: tuple[float, float]
    within: float


@dataclass(frozen=True)
class Plan:
    """The motion that tells two readings apart best.

    separation  D of it; telling: whether that is enough, and eyes can see it
    others      D of every other motion that was looked into, or its bound: no nuisance may widen a gap
    predicted   (2, T, n, 3) m, nodes by the first and the second reading
    look        where and when, or None where nothing is far enough apart to be seen
    says        what to do, where to look, and what each outcome means
    """

    motion: Motion
    separation: float
    others: dict[str, float]
    predicted: np.ndarray
    look: Look | None
    says: str

    @property
    def telling(self) -> bool:
        return self.separation >= TELLING and self.look is not None


def setting_of(replica: Replica) -> Setting:
    """The hands around a replica: points of one fist are one hand, and so are markers that follow each other along a rope."""
    start, system = replica.recording.controllers[0], replica.system
    label = labels_of(start[None])
    moved_by = {int(node): c for c, node in enumerate(system.grips) if node >= 0}
    for chain in system.chains:
        for a, b in zip(chain[:-1].tolist(), chain[1:].tolist(), strict=True):
            if a in moved_by and b in moved_by:
                label[label == label[moved_by[b]]] = label[moved_by[a]]
    return Setting.of(replica.recording, replica.nodes, label)


def plan(simulator: Simulator, rivals: Sequence[Side], *, error: float = 0.0, finest: float = 0.0) -> Plan | None:
    """The best motion to tell two ``rivals`` apart on the body of ``simulator``, or None where none can be simulated.

    error   m, by which such twins are off in free runs; finest: that nobody asks them for
    Raises ValueError where nobody holds the body.
    """
    setting = setting_of(simulator.replica)
    steps = [ceil(MARGIN * simulator.substeps(one.fit.model.terms, one.fit.values)) for one in rivals]
    found = []
    for motion in motions(setting):
        moved = _moving(simulator, motion)
        predicted = np.concatenate([_free(moved, one.fit, [one.fit.values], n) for one, n in zip(rivals, steps, strict=True)])
        if np.isfinite(predicted).all():
            found.append((motion, moved, predicted))
    if not found:
        return None
    noise = floor_of(simulator.replica, finest) + error**2
    free = np.setdiff1d(np.arange(len(simulator.replica.nodes)), simulator.replica.driven)
    bounds = [_gap(p[0] - p[1], p[:0], noise, free) for _, _, p in found]
    order, others = np.argsort(bounds)[::-1], {found[k][0].name: float(bounds[k]) for k in range(len(found))}
    best: Any = None
    for k in order[:TRIED]:
        motion, moved, predicted = found[k]
        if best is not None and bounds[k] <= best[0]:
            break  # no nuisance widens a gap
        columns, spread = _open(moved, rivals, predicted, steps)
        variance = noise + spread
        separation = _gap(predicted[0] - predicted[1], columns, variance, free)
        others[motion.name] = separation
        if best is None or separation > best[0]:
            best = (separation, motion, predicted, columns, variance)
    separation, motion, predicted, columns, variance = best
    others.pop(motion.name)
    look = _look(setting, simulator.replica, motion, predicted, columns, variance, free)
    says = _words(setting, simulator.replica, rivals, motion, look if separation >= TELLING else None)
    return Plan(motion, separation, others, predicted, look, says)


def experiment(inquiry: Inquiry, decision: Decision) -> tuple[str | None, dict | None]:
    """What to record next where a recording leaves something open, in words; and the plan's figures, if motions could be simulated.

    Of two effects between which it cannot decide, the motion that tells them apart; where it cannot tell whether there is any, the one that
    tells the likeliest from none.
    """
    names = [n for n in (decision.effect, *decision.alternatives) if n]
    if decision.verdict not in ("ambiguous", "cannot_tell", "unknown") or not names:
        return None, None
    words = {s.hypothesis.effect: s.hypothesis.term.stands_for().motion for s in inquiry.scores}
    shown = "; ".join(f"{words[n]} ({n.replace('_', ' ')})" for n in names if words.get(n))
    by_word = f"What shows each: {shown}." if shown else None
    found = _planned(inquiry, names, decision.verdict) if decision.verdict != "unknown" else None
    if found is None:
        return by_word, None
    said = found.says if found.telling else " ".join(filter(None, (found.says, by_word)))
    return said, figures(found.motion, found.separation, found.others, float(inquiry.case.recording.fps))


def _planned(inquiry, names, verdict) -> Plan | None:
    """The plan for the two likeliest of ``names``, or the likeliest and nothing; None where a twin of one is wanting or nobody holds it."""
    rivals, twins = [], []
    for name in names[: 2 if verdict == "ambiguous" else 1]:
        mine = [r for r in inquiry.refits if r.score.hypothesis.effect == name and np.isfinite(r.found.fit.loss)]
        mine = [r for r in mine if r.score.hypothesis.term.stage != "observer"]  # which only says how things were, not how they will be
        if not mine:
            return None
        one = max(mine, key=lambda r: r.promise)
        rivals.append(Side(name.replace("_", " "), one.score.hypothesis.term.stands_for().says, one.found.fit))
        twins.append(one.found)
    if verdict != "ambiguous":
        rivals.append(Side("nothing", "nothing is missing", inquiry.base.fit))
        twins.append(inquiry.base)
    if len(rivals) < 2 or not len(inquiry.case.recording.controllers[0]):
        return None
    return plan(inquiry.simulators[0], rivals, error=_error(twins), finest=inquiry.finest)


def _error(twins: Sequence[Verdictable]) -> float:
    """m, the error of the better twin's free runs where it was not fitted."""
    return min(float(np.mean([e for name, e in t.free.items() if name != "train"] or [t.free["train"]])) for t in twins)


def _moving(simulator: Simulator, motion: Motion) -> Simulator:
    """The body of frame 0, at rest, in hands that make another motion."""
    body = replace(simulator.replica.system, controllers=motion.controllers, velocities=None, seen=None, sight=None)
    return Simulator(replace(simulator.replica, system=body), device=simulator.device, double=simulator.double)


def _free(moved: Simulator, fit: Fit, rows, substeps: int) -> np.ndarray:
    """(B, T, n, 3) free runs of a fit's model with ``rows`` of values."""
    rows = [{**row, "observer_bandwidth": 0.0} for row in rows]
    return moved.run(fit.model.terms, rows, len(moved.replica.system.controllers), substeps=substeps)


def _open(moved: Simulator, rivals, predicted, substeps) -> tuple[np.ndarray, np.ndarray]:
    """Columns (K, T, n, 3) m, one standard deviation of what either fit left open; and (T,) m^2, what a start as it was seen grows to."""
    columns = [predicted[:0]]
    for one, origin, n in zip(rivals, predicted, substeps, strict=True):
        if not len(one.fit.z):
            continue
        values, ways = np.linalg.eigh(np.nan_to_num(one.fit.covariance))
        widest = np.argsort(values)[::-1][:MODES]
        turns = SHARE * np.sqrt(np.maximum(values[widest], 0))[:, None] * ways[:, widest].T
        found = (_free(moved, one.fit, [one.fit.model.decode(one.fit.z + turn) for turn in turns], n) - origin) / SHARE
        columns.append(found[np.isfinite(found).all((1, 2, 3))])
    system, noise = moved.replica.system, moved.replica.sightings.noise
    aside = np.random.default_rng(0).normal(0, noise, system.positions.shape)
    aside[moved.replica.driven] = 0
    shaken = replace(moved.replica, system=replace(system, positions=system.positions + aside))
    moved = Simulator(shaken, device=moved.device, double=moved.double)
    grown = _free(moved, rivals[0].fit, [rivals[0].fit.values], substeps[0])[0] - predicted[0]
    spread = (grown**2).sum(-1).mean(-1)
    return np.concatenate(columns), np.where(np.isfinite(spread), spread, np.inf)


def _gap(difference, columns, variance, free) -> float:
    """D of a ``difference`` (T, n, 3) that ``columns`` (K, T, n, 3) may close; ``variance`` [m^2] of a vector, for all or (T,) by frame."""
    weight = np.broadcast_to(np.sqrt(INDEPENDENT / variance), (len(difference),))[1:, None, None]
    weight = weight / np.sqrt((len(difference) - 1) * len(free))
    target = (difference[1:, free] * weight).ravel()
    matrix = (columns[:, 1:, free] * weight).reshape(len(columns), target.size).T
    u = np.linalg.solve(matrix.T @ matrix + np.eye(len(columns)), matrix.T @ target)
    return float(np.sqrt(((target - matrix @ u) ** 2).sum() + u @ u))


def _look(setting, replica, motion, predicted, columns, variance, free) -> Look | None:
    """The node, frame and direction in which the readings differ most for how sure they are."""
    hands = np.stack([motion.controllers[:, setting.hand == h].mean(1) for h in range(len(setting.centre))], 1)  # (T, H, 3)
    axes = np.stack([setting.up, setting.face, setting.line])
    gap = np.abs((predicted[0] - predicted[1]) @ axes.T)[:, free]
    noise = np.broadcast_to(variance, (len(gap),))[:, None, None] / 3
    unsure = np.sqrt(noise + ((columns @ axes.T)[:, :, free] ** 2).sum(0))
    clear = np.where(gap >= VISIBLE, gap / unsure, 0.0)
    if not clear.max() > 0:
        return None
    frame, k, axis = (int(i) for i in np.unravel_index(int(clear.argmax()), clear.shape))
    node = int(free[k])
    hand = int(np.linalg.norm(hands[0] - replica.nodes[node], axis=1).argmin())
    first, second = (float((p[frame, node] - hands[frame, hand]) @ axes[axis]) for p in predicted)
    return Look(frame, node, hand, axes[axis], (first, second), float(unsure[frame, k, axis]))


def _words(setting, replica, rivals, motion, look) -> str:
    """What to do, where to look, and what each outcome means; without ``look``, that no motion helps."""
    a, b = rivals
    if look is None:
        return f"None of the motions that were simulated tells {a.name} from {b.name}: what either leaves open would make up for it."
    at = _place(replica, setting, look.node)
    return outcome_words(rivals, motion, at, look.frame / setting.fps, look.axis, setting.up, look.offsets, look.within)


def _place(replica, setting, node):
    """A node in words."""
    far = np.linalg.norm(replica.nodes[:, None] - setting.centre[None], axis=2).min(1)
    if far[node] > 0.9 * far.max():
        return "the point farthest from the hands"
    at = ", ".join(f"{c:.3f}" for c in replica.nodes[node])
    return f"the point that was at ({at}) m in frame 0"
