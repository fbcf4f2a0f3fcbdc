"""A candidate fitted in full: its amounts, its place, its shape and all that a sound twin's fit may change, weighed by the error of sound
twins.

Where much of an effect leads is not told by what a little of it does beside a twin whose fit has made up for it as well as it can: a rope
in a soft hand is fitted by one that holds less of it elsewhere, which a softer hand makes worse. So a refit begins at the best of some
sizes (``begun``), and effects are refitted in the order of what is known of them there.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from ..config import DiagnosisConfig
from ..effects import Candidate
from .amounts import Scale
from .forward import Forward
from .likelihood import Likelihood
from .scan import Signature
from .search import FARTHEST, Asked, Place, Search, normal
from .slopes import corrected

__all__ = ["Gain", "Refit", "Start", "begun", "gained", "refitted"]

TRIALS = (1.0, 0.4, 0.1, 0.03)  # of a Gauss-Newton step, one after the other until one is better: what swings falls elsewhere beyond
TRUSTED = 0.2  # of what slopes promised: a step that gains less says that they are those of elsewhere
ARRIVED = 0.05  # nats: evidences that differ by less say nothing of names
LED = 2  # starts that are run once more with what the fit would change of the twin there
FORMS = (-2.0, 0.0, 2.0)  # prior standard deviations of a shape, at which an effect that hides is begun
WAYS = (1.0, 2.0)  # prior standard deviations of each of several amounts, both ways, at which their effect is begun


@dataclass(frozen=True)
class Gain:
    """Share of the squared error of block means that were not fitted which a refit removes, each error over what sound twins are off by
    there, and its standard error, by a jackknife."""

    share: float
    error: float


@dataclass(frozen=True, eq=False)
class Refit:
    """``candidate`` where its place ended, or None; ``shift`` (n,) of the unknowns in prior standard deviations; ``amounts`` (m,) of the
    effect with standard deviations ``sd`` (m,), in its parameters' units; ``prediction`` (B,) m; ``log_evidence`` by Laplace's
    approximation; the ``search`` that ended at ``numbers`` (N,), where one did.

    Standard deviations are those of the curvature, or what sound twins would be said to have of the effect by the same slopes (RMS), where
    that is more: of a covariance from a few members the curvature promises too much (Huber 1967; Mueller 2013, whose sandwich this is)."""

    candidate: Candidate | None
    shift: np.ndarray
    amounts: np.ndarray
    sd: np.ndarray
    prediction: np.ndarray
    log_evidence: float
    search: Search | None = None
    numbers: np.ndarray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class Start:
    """Where a refit of ``signature``'s candidate begins: ``numbers`` (N,) as ``Place`` has them, amounts on a ``scale``; ``log_evidence``
    there."""

    signature: Signature
    scale: Scale
    numbers: np.ndarray
    log_evidence: float


def begun(forward: Forward, asked: Asked, signatures: Sequence[Signature], config: DiagnosisConfig) -> list[Start]:
    """The best of some sizes of the candidates of ``signatures``, one effect in its shapes, each beside the twin where its fit ended, the
    most promising also beside one that has changed as the reference's slopes ask for; other arguments as ``refitted`` has them.

    Of an effect that hides (``Effect.hides``) there are two: the other is the most promising of these sizes where what it hides in is as it
    was told. What a fit has made up for leaves no sign of where the truth is: a start there may be far worse than none, and lead to it.
    Where its shapes are not tried one by one, they are tried beside the one that is asked.
    None of a fault of what was measured, which is nearly linear.
    """
    effect, alone = signatures[0].candidate.effect, forward.fitted_alone(asked.reference)
    if effect.seen:
        return []
    told, searches = _told(forward, effect.hides), [Search.of(alone, asked, one, config) for one in signatures]
    shapes = list(product(FORMS if effect.hides and len(signatures) == 1 else (0.0,), repeat=len(effect.forms)))

    def tried(bend) -> list[_Size]:
        """The most promising first."""
        found = [one for search in searches for one in _tried(search, _sizes(search, bend, shapes))]
        return sorted(found, key=lambda one: one.promised)

    nothing, here = (searches[0], searches[0].place(np.zeros(searches[0].size), asked.reference)), tried(np.zeros_like(told))
    starts = [[nothing, *(one.end for one in here), *(one.led() for one in here[:LED])]]
    starts += [[one.end, one.led()] for one in (tried(told)[:1] if told.any() else ())]
    return [_start(*min(ends, key=lambda end: end[1].cost)) for ends in starts]


def _start(search: Search, at: Place) -> Start:
    assert search.signature is not None and search.scale is not None  # as of all that is begun
    return Start(search.signature, search.scale, at.numbers, search.evidence(at, search.slopes)[0])


@dataclass(frozen=True, eq=False)
class _Size:
    """One that was run, at a place, and a ``step`` of the twin's own numbers from there that promises a cost of ``promised``."""

    search: Search
    at: Place
    step: np.ndarray
    promised: float

    @property
    def end(self) -> tuple[Search, Place]:
        return self.search, self.at

    def led(self) -> tuple[Search, Place]:
        """A step further."""
        search = self.search
        return search, search.places([np.clip(self.at.numbers + self.step, search.low, search.high)])[0]


def _tried(search: Search, numbers: np.ndarray) -> list[_Size]:
    """Of ``numbers`` (K, N), those that do not diverge."""
    found = []
    for at in search.places(numbers):
        if np.isfinite(at.cost):
            step, gain = search.step(at, search.slopes, search.low, search.high, search.parts[0])
            found.append(_Size(search, at, step, at.cost - gain))
    return found


def _sizes(search: Search, bend: np.ndarray, shapes: Sequence[Sequence[float]]) -> np.ndarray:
    """(K, N) numbers: sizes of each amount, on its sides, in all ``shapes``, where the twin's numbers are off by ``bend`` (n,)."""
    assert search.signature is not None and search.scale is not None
    candidate, knots = search.signature.candidate, search.scale.knots
    if knots is None:
        sizes = [side * way * one for one in np.eye(len(candidate.effect.amounts)) for way in WAYS for side in (1.0, -1.0)]
    else:
        sizes = [np.array([number]) for number in knots[0] if number]
    found = [np.concatenate([bend, size, np.zeros(len(candidate.coordinates)), shape]) for size, shape in product(sizes, shapes)]
    return np.clip(found, search.low, search.high)


def _told(forward: Forward, prefix: str) -> np.ndarray:
    """(n,) prior standard deviations from where the fit ended to what was told of the unknowns with a ``prefix``; 0 of others."""
    found = np.zeros(len(forward.unknowns))
    for k, unknown in enumerate(forward.unknowns):
        if prefix and re.search(rf"(^|_){prefix}\d*_", unknown.name):
            found[k] = (unknown.encode(unknown.value) - forward.scaled[k]) / forward.sds[k]
    return found


def refitted(
    forward: Forward,
    asked: Asked,
    signature: Signature | None,
    config: DiagnosisConfig,
    sound: Sequence[tuple[Likelihood, np.ndarray]] = (),
    start: Start | None = None,
    reach: float = -np.inf,
) -> Refit:
    """Of ``signature``'s candidate, or of the sound twin alone (None), to what is ``asked``, from ``start`` or, without one, from where the
    fit ended.

    sound  what sound twins leave of the rows, each with the likelihood by the others
    reach  log evidence of a rival: what stays ``config.behind`` nats short of it where its slopes lead is given up where it is, with the
           density there as its evidence

    All refits of a recording have the same budget of steps. Slopes are the shared ones at first, or such as are measured at its start,
    corrected after each step by what it missed (``slopes``), and measured again where a step gained less than a fifth of what they
    promised: an effect that moves a body by centimetres leads far from where the sound twin's fit ended. A refit has arrived where fresh
    slopes lead nowhere. Shapes stay as they were tried until all else has arrived: what they lead to is better than without. A place has a
    prior of ``config.astray`` around the one that was tried, the logarithm of a shape one of ``config.reshaped``, amounts one by the motion
    that they make (``amounts``). What would take more than ``config.dearest`` times the steps is not run. Runs end with the fitted frames,
    but one where the refit arrived; where that diverges, all frames are run all along, from where the fit ended.
    """
    alone = forward.fitted_alone(asked.reference)
    found = _searched(alone, asked, signature, config, sound, start, reach)
    if alone is forward:
        return found
    twins, more = (
        (forward, {}) if found.candidate is None else (forward.with_effects([found.candidate]), found.candidate.values(found.amounts))
    )
    whole = twins.rows([{**forward.values(found.shift), **more}])[0]
    return (
        replace(found, prediction=whole) if np.isfinite(whole).all() else _searched(forward, asked, signature, config, sound, None, reach)
    )


def _searched(forward, asked, signature, config, sound, start, reach) -> Refit:
    """As ``refitted``, all runs by ``forward``."""
    search = Search.of(forward, asked, signature, config, start.scale if start else None)
    low, high, (unknowns, amounts, _, forms) = search.low.copy(), search.high.copy(), search.parts
    at, jacobian, fresh = search.place(np.zeros(search.size), asked.reference), search.slopes, False
    held = np.zeros(search.size, bool)
    held[forms] = True
    if start is not None and start.numbers.any():
        [there] = search.places([start.numbers])
        if np.isfinite(there.cost):
            at = there
            jacobian, fresh = search.measured(at, jacobian, low, high, ~held), True
    first, given_up = forward.cost.runs, -np.inf
    low[held], high[held] = at.numbers[held], at.numbers[held]
    for _ in range(config.steps):
        if forward.cost.runs - first >= config.runs:
            break
        step, promised = search.step(at, jacobian, low, high)
        led = -search.place(at.numbers + step, at.prediction + jacobian @ step).cost  # at most so much evidence, if slopes are right
        if led < reach - config.behind:
            given_up = led
            break
        for part in TRIALS:
            [found] = search.places([np.clip(at.numbers + part * step, low, high)])
            if np.isfinite(found.cost):
                jacobian = corrected(jacobian, found.numbers - at.numbers, found.prediction - at.prediction)
            if found.cost < at.cost:
                break
        gained, at = at.cost - found.cost, found if found.cost < at.cost else at
        measured = ~held
        if fresh and not gained > ARRIVED:
            if not held.any():
                break
            low[held], high[held] = -FARTHEST, FARTHEST
            measured, held = held, np.zeros_like(held)
        fresh = not gained > max(ARRIVED, TRUSTED * promised)
        if fresh:
            jacobian = search.measured(at, jacobian, low, high, measured)
    evidence, inverse = search.evidence(at, jacobian)
    evidence = max(evidence, given_up)
    if search.scale is None:
        return Refit(None, at.numbers, np.zeros(0), np.zeros(0), at.prediction, evidence)
    mistaken = [normal(one, left, jacobian[asked.rows]) for one, left in sound]
    spread = np.sqrt(np.mean([np.linalg.solve(*equations) ** 2 for equations in mistaken], axis=0)) if mistaken else 0.0
    own, sd = (one[amounts] for one in (at.numbers, np.maximum(np.sqrt(np.diag(inverse)), spread)))
    sizes, sd = search.scale.amounts(own), sd * search.scale.slope(own)
    return Refit(search.candidate(at.numbers), at.numbers[unknowns], sizes, sd, at.prediction, evidence, search, at.numbers)


def gained(data, sound, other, cells: Sequence | np.ndarray, variances: np.ndarray | float = 1.0) -> Gain:
    """What ``other`` (B,) m removes of ``sound``'s (B,) m squared error in ``data`` (B,) m; ``cells`` (B,): what a jackknife leaves out.

    variances (B,) m^2, of sound twins: where these are off by centimetres, as where a rope is whipped, an error says little
    """
    before, after = np.square(data - sound) / variances, np.square(data - other) / variances
    if not len(before) or not np.isfinite(after).all():
        return Gain(np.nan, np.nan)
    share = 1 - after.sum() / before.sum()
    names = np.unique(cells)
    parts = [1 - after[cells != c].sum() / before[cells != c].sum() for c in names] if len(names) > 1 else [share]
    return Gain(float(share), float(np.sqrt((len(parts) - 1) * np.var(parts))))
