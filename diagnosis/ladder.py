"""Term by term: which physics a twin of several recordings lacks, each step accepted on recordings that were not fitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from ..physics.terms.base import Term
from .fit import Fit, Task, fit
from .model import Knob, Model

__all__ = ["Candidate", "Climb", "Rung", "Step", "believed", "best", "climb", "errors", "led"]

LED = 1.0  # Hz, of the observer that leads simulations in the first steps of a fit
STARTS = 2  # the best of a candidate's, which are tried further
SCOUT = 2  # Gauss-Newton steps after which most candidates are left behind
FINALISTS = 3  # that fit best then, and as many that do best on what is not fitted
WORTH = 0.02  # share of the error that a gain must be: less is no physics that anybody misses
SURE = 2.0  # standard errors that a gain must exceed: the best of several exceeds one by chance
JOINED = " + "  # between the names of what is tried as one
DECADES = np.arange(-2.0, 4.01, 0.5)  # of a typical amplitude, tried as starts


@dataclass(frozen=True)
class Candidate:
    """Physics that may be missing.

    terms     of it; those with laws may be in the twin already, switched off, so that all candidates share their kernels
    values    fixed parameters that it needs to be what it says
    knobs     that it adds; all amplitudes are 0 where it is absent
    starts    (S, K) values of the knobs from which the best is taken
    also      sets of values of knobs that the model has already, tried beside where these are
    needs     name of a candidate without which it means nothing, or "": where the twin lacks that, both are tried as one
    after     name of a candidate that the twin must have before this one is asked, or "": what a body remembers of its bends is told when
              what resists them is
    off       values of what the twin has from the beginning and may turn out not to need, when it is taken out
    """

    name: str
    knobs: tuple[Knob, ...]
    starts: np.ndarray
    terms: tuple[type[Term], ...] = ()
    values: dict[str, float] = field(default_factory=dict)
    also: tuple[dict[str, float], ...] = ()
    needs: str = ""
    after: str = ""
    off: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, term: type[Term], **options) -> Candidate:
        """Of a term that declares an effect: its amplitudes, and its shapes as they are tried, each over several decades."""
        effect, known = term.stands_for(), {p.name: p for p in term.parameters}
        knobs, tried = [], []
        for name in effect.amplitudes:
            p, size = known[name], abs(effect.typical[name]) or max(map(abs, effect.typical.values()))
            if p.low >= 0 and len(effect.amplitudes) == 1:
                values = np.unique(np.clip(size * 10.0 ** DECADES[:: 2 if effect.shapes else 1], None, p.high))
                knobs.append(Knob(name, float(size), 1.0, 1e-6 * size, p.high, log=True, step=0.05))
            else:
                values = np.array([0.0])
                knobs.append(Knob(name, 0.0, size, p.low, p.high, step=0.05))
            tried.append(values)
        for name, shapes in effect.shapes.items():
            p = known[name]
            if p.scale == "log":
                knobs.append(Knob(name, shapes[0], 0.7, p.low, p.high, log=True, step=0.05))
                tried.append(np.array(shapes))
        return cls(term.stands_for().name, tuple(knobs), np.array(list(product(*tried))), (term,), **options)


@dataclass(frozen=True)
class Rung:
    """One candidate refitted.

    error         mean validation error [m]
    gain, spread  mean over the validation recordings, and its standard error, of log(error without it / error with it) at equal budget
    """

    name: str
    error: float
    gain: float
    spread: float


@dataclass(frozen=True)
class Step:
    """What was added: validation errors [m] before and after, the candidates that were refitted for it, and what it made superfluous."""

    name: str
    before: float
    after: float
    spread: float
    rivals: tuple[Rung, ...]
    dropped: tuple[str, ...]
    fit: Fit


@dataclass(frozen=True)
class Climb:
    """The fitted twin without anything, and the steps from there."""

    first: Fit
    error: float
    steps: tuple[Step, ...]
    rivals: tuple[Rung, ...]
    losses: dict[str, tuple[float, float]]

    @property
    def accepted(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.steps)

    @property
    def kept(self) -> tuple[str, ...]:
        """Names of what was accepted and not taken out again."""
        dropped = {name for s in self.steps for name in s.dropped}
        return tuple(name for s in self.steps for name in s.name.split(JOINED) if name not in dropped)

    @property
    def last(self) -> Fit:
        return self.steps[-1].fit if self.steps else self.first


def believed(climbs: Sequence[Climb], alike: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """Names that all of two and more ``climbs`` over other splits of the recordings ended with; of one climb nothing has repeated.

    What a single split accepts may be what its recordings have by chance: of a dozen candidates the best exceeds two standard errors so.
    ``alike``: of laws for the same physics, the name that they count as.
    """
    if len(climbs) < 2:
        return ()
    kept = [dict.fromkeys((alike or {}).get(name, name) for name in climb.kept) for climb in climbs]
    return tuple(name for name in kept[0] if all(name in other for other in kept[1:]))


def errors(task: Task, model: Model, z) -> np.ndarray:
    """(recordings,) mean absolute error per coordinate [m] of the free nodes; infinite where the simulation blew up."""
    found = []
    for k, predicted in enumerate(task.predict(model, [z], task.substeps(model, z))):
        gap = np.abs(predicted[0] - task.seen(k))[1:]
        gap[:, task.simulators[k].replica.driven] = np.nan
        lost = ~np.isfinite(predicted[0]).all()
        found.append(np.inf if lost else float(np.nanmean(gap)))
    return np.array(found)


def climb(
    task: Task,
    validation: Task,
    scouting: Task,
    base: Fit,
    candidates: Sequence[Candidate],
    *,
    iterations: int,
    doubted: Sequence[Candidate] = (),
    most: int = 8,
    report: Callable[[str], None] = lambda text: None,
) -> Climb:
    """Add the candidate that helps ``validation`` most, refit everything, see whether earlier ones are still needed, and go on.

    All fits of a step start from the same twin and take the same number of steps, the twin without anything new too. What needs another
    candidate is tried together with it: stiffness about a shape that is not the body's own may help nobody. A candidate is
    accepted where its gain, paired over the validation recordings, exceeds ``SURE`` standard errors and ``WORTH``, the greatest gain first,
    and one that was accepted stays unless the twin without it is within one standard error, or ``WORTH``, of the twin with it (Breiman et
    al. 1984, section 3.4.3); ``doubted`` parts of the twin are treated as if they had been accepted. ``scouting`` is a part of ``task`` on
    which starts are chosen. Raises ValueError where one is asked after another that is not among them.
    """
    names = {c.name for c in (*candidates, *doubted)}
    for one in candidates:
        if one.after and one.after not in names:
            raise ValueError(f"candidate {one.name} is asked after {one.after}, which must be a candidate, got {', '.join(sorted(names))}")
    steps, found, accepted = [], base, list(doubted)
    first = base
    start_error = float(errors(validation, base.model, base.z).mean())
    rivals: tuple[Rung, ...] = ()
    while len(steps) < most:
        plain = best(task, [found, _fit(task, found.model, found.z, 2 * SCOUT + iterations)])
        before = errors(validation, plain.model, plain.z)
        scouts = _scouts(scouting, found, candidates, {a.name for a in accepted})
        ranks = [sorted(scouts, key=key)[:FINALISTS] for key in (lambda s: s[1].loss, lambda s: _level(validation, s[1]))]
        scouts = [s for s in scouts if any(s is r for rank in ranks for r in rank)]
        tried = []
        for new, scout in scouts:
            full = best(task, [scout, _fit(task, scout.model, scout.z, iterations)])
            after = errors(validation, full.model, full.z)
            gain, spread = _paired(before, after)
            name = JOINED.join(c.name for c in new)
            tried.append((new, full, Rung(name, float(after.mean()), gain, spread)))
            report(f"{name}: {1e3 * before.mean():.2f} -> {1e3 * after.mean():.2f} mm, gain {gain:.3f} +- {spread:.3f}")
        rivals = tuple(t[2] for t in tried)
        good = [t for t in tried if _counts(t[2].gain, t[2].spread)]
        if not good:
            found = plain if _paired(errors(validation, found.model, found.z), before)[0] > 0 else found
            break
        new, found, rung = max(good, key=lambda t: t[2].gain)
        accepted += new
        found, dropped = _ablated(task, validation, found, accepted, iterations)
        accepted = [a for a in accepted if a.name not in dropped]
        after = errors(validation, found.model, found.z)
        steps.append(Step(rung.name, float(before.mean()), float(after.mean()), rung.spread, rivals, dropped, found))
        less = f", without {', '.join(dropped)}" if dropped else ""
        report(f"+ {rung.name}: {1e3 * before.mean():.2f} -> {1e3 * after.mean():.2f} mm{less}")
    losses = {}
    if steps:
        whole = errors(validation, found.model, found.z)
        for one in accepted:
            bare = _without(found, one)
            bare = best(task, [bare, _fit(task, bare.model, bare.z, iterations)])
            losses[one.name] = _paired(errors(validation, bare.model, bare.z), whole)
    return Climb(first, start_error, tuple(steps), rivals, losses)


def _fit(task, model, z, iterations) -> Fit:
    """``fit``, with an infinite loss where the twin is so touchy that its slopes are no numbers."""
    try:
        return fit(task, model, z, iterations=iterations)
    except np.linalg.LinAlgError:
        return Fit(model, np.array(z, float), np.inf, np.full((len(z),) * 2, np.nan), (np.inf,))


def led(task: Task, bandwidth: float = LED) -> Task:
    """The task with simulations that are drawn to what was seen: they cannot run away, so that a fit finds its way from afar."""
    return replace(task, bandwidth=bandwidth)


def _scouts(task, found, candidates, have):
    """((candidate, ...), short fit) of every candidate that the twin lacks, with what it needs where it lacks that too."""
    lacking = {c.name: c for c in candidates if c.name not in have and c.after in ("", *have)}
    alone = {name: _scouted(task, found, c) for name, c in lacking.items() if c.needs in ("", *have)}
    scouts: list[tuple[tuple, Fit]] = [((lacking[name],), scout) for name, scout in alone.items()]
    for c in lacking.values():
        if c.needs in alone:
            scouts.append(((lacking[c.needs], c), _scouted(task, alone[c.needs], c)))
    return scouts


def _scouted(task, found, candidate) -> Fit:
    """A short fit of the model with the candidate from each of its best starts; the one that ended best."""
    model, starts = _started(task, found, candidate)
    return min((_fit(task, model, z, SCOUT) for z in starts), key=lambda f: f.loss)


def _started(task, found, candidate):
    """The model with the candidate, and (z, ...) of its best starts on ``task``."""
    model = found.model
    base = [k for k in model.knobs if k.name not in candidate.values]
    z0 = np.array([u for k, u in zip(model.knobs, found.z, strict=True) if k.name not in candidate.values])
    terms = tuple(sorted({*model.terms, *candidate.terms}, key=lambda t: t.name))
    model = Model(terms, {**model.values, **candidate.values}, (*base, *candidate.knobs))
    trials = []
    for start in candidate.starts:
        own = [k.encode(float(np.clip(v, k.low, k.high))) for k, v in zip(candidate.knobs, start, strict=True)]
        trials.append(np.concatenate([z0, own]))
        for also in candidate.also:
            moved = [k.encode(also[k.name]) if k.name in also else u for k, u in zip(base, z0, strict=True)]
            trials.append(np.concatenate([moved, own]))
    steps = [max(a) for a in zip(*(task.substeps(model, t) for t in trials[:: max(1, len(trials) // 8)]), strict=True)]
    found = task.residuals(task.predict(model, trials, steps))
    costs = [task.by_frame.misfit(r) if np.isfinite(r).all() else np.inf for r in found]
    return model, [trials[i] for i in np.argsort(costs)[:STARTS]]


def _without(found, candidate):
    """The fit with the candidate's knobs taken out; what they turned is at its default, and off."""
    own = {k.name for k in candidate.knobs}
    keep = [k.name not in own for k in found.model.knobs]
    values = {n: v for n, v in found.model.values.items() if n not in candidate.values} | candidate.off
    model = Model(found.model.terms, values, tuple(k for k, kept in zip(found.model.knobs, keep, strict=True) if kept))
    return replace(found, model=model, z=found.z[np.array(keep)])


def _ablated(task, validation, found, accepted, iterations):
    """The fit without those of the earlier ones that it no longer needs, and their names."""
    dropped = []
    for one in accepted[:-1]:
        if any(one.name in (other.needs, other.after) for other in accepted if other.name not in dropped):
            continue
        bare = _without(found, one)
        bare = best(task, [bare, _fit(task, bare.model, bare.z, iterations)])
        loss, spread = _paired(errors(validation, bare.model, bare.z), errors(validation, found.model, found.z))
        if loss < max(spread, WORTH):
            found = bare
            dropped.append(one.name)
    return found, tuple(dropped)


def _level(task, found):
    """Mean log error."""
    return float(np.log(errors(task, found.model, found.z)).mean()) if np.isfinite(found.loss) else np.inf


def best(task, fits):
    """The fit with the least mean log error: least squares listen to the worst moments, which are not what counts here."""
    return min(fits, key=lambda f: _level(task, f))


def _counts(gain, spread):
    return gain > max(SURE * spread, WORTH)


def _paired(before, after):
    """Mean and standard error over recordings of log(before / after): the hard ones do not outvote the others."""
    if not np.isfinite(after).all():
        return -np.inf, 0.0
    if not np.isfinite(before).all():
        return np.inf, 0.0
    gain = np.log(before / after)
    return float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(len(gain)))
