"""The few that the screening left: fitted in full, with the same budget as the baseline, and judged on what was held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .fit import Fit, Frames, Task, counted, fit, floor_of, remoteness, slopes_at
from .foresight import foreseen
from .model import JUDGED, Model
from .parts import Part, nobody
from .replica import Replica
from .screen import Score

__all__ = ["Verdictable", "evaluate", "foresighted", "refit"]

STARTS = (0.02, 0.2, 0.6, 1.2)  # shares of the linear estimate from which a refit may begin
TRIAL = 2  # steps after which the better of a near and a far start goes on
DECADES = (0.5, 2.0, 8.0, 40.0)  # of a noticeable size, where one number is the effect's whole size
ELSEWHERE = 8  # further places and shapes of a term, the best by their scores, at which far starts are looked for
DAMPED = {"drag_damping": 0.03, "air_drag": 0.03, "dashpot_damping": 0.5}
USUAL = {"drag_damping": None, "air_drag": None}
RELEASES = ({}, {"body_stiffness": 0.3}, DAMPED, USUAL)  # of what the fit had to put in its place: by factors, None to what is expected


@dataclass(frozen=True)
class Verdictable:
    """A fitted model and its errors.

    fit       where its fit ended
    observed  by part, squared innovation under the observer in the (geometric) mean frame, its floor included [m^2]
    free      by part, mean error of the free-running simulation [m]
    foreseen  by part that was not fitted, like observed, with what the fit left open left open (``foresight``) [m^2]; empty if not asked
    """

    fit: Fit
    observed: dict[str, float]
    free: dict[str, float]
    foreseen: dict[str, float] = field(default_factory=dict)


def refit(task: Task, base: Fit, scores: Sequence[Score], *, iterations: int, spacing: float, others: Sequence[Score] = ()) -> list[Fit]:
    """The baseline and each scored hypothesis, all from ``base`` with the same number of steps; shapes and places may move.

    Among ``others`` are those of the same term at other places and with other shapes, best first: an effect far larger than what is linear
    may have its best score in a wrong place, so that far starts are looked for there too.
    """
    fits = [fit(task, base.model, base.z, iterations=iterations)]
    known = slopes_at(task, base) if scores else None  # of what is the same in all of them
    for score in scores:
        near, far = _starts(base, _extended(base, score, spacing), score)
        ways = [(_extended(base, score, spacing), starts) for starts in (near, far) if starts]
        if far and score.hypothesis.term.stands_for().place:
            same = [s for s in others if s.hypothesis.term is score.hypothesis.term and s is not score][:ELSEWHERE]
            ways[-1] = min([ways[-1], *(_far(base, s, spacing) for s in same)], key=lambda way: _costs(task, *way).min())
        begun = [(model, starts[int(np.argmin(_costs(task, model, starts)))]) for model, starts in ways]
        tried = [fit(task, model, z, iterations=TRIAL, known=known) for model, z in begun]
        first = min(tried, key=lambda f: f.cost)
        fits.append(fit(task, first.model, first.z, iterations=iterations - TRIAL))
    return fits


def _extended(base, score, spacing):
    h = score.hypothesis
    return base.model.extended({h.term}, h.values, h.knobs + h.free_knobs(spacing))


def _far(base, score, spacing):
    """The model at the score's place, and noticeable sizes there as starts."""
    model, knob = _extended(base, score, spacing), score.hypothesis.knobs[0]
    sign = -1.0 if score.amplitude[0] < 0 or knob.high <= 0 else 1.0
    return model, [_at(base, model, {knob.name: sign * share * knob.spread}, {}) for share in DECADES]


def _starts(base: Fit, model: Model, score: Score) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Where a refit may begin: at shares of the linear estimate, and far from it.

    A twin that was fitted without the effect has taken it for stiffness or drag, and its linear estimate then means little: where one
    number is the effect's whole size, the far starts have it at noticeable sizes, with what had to stand in for it taken back.
    """
    h = score.hypothesis
    near = [_at(base, model, {k.name: share * a for k, a in zip(h.knobs, score.amplitude, strict=True)}, {}) for share in STARTS]
    far = []
    if len(h.knobs) == 1 and h.term.effect and h.term.stage != "observer":
        knob = h.knobs[0]
        sign = -1.0 if score.amplitude[0] < 0 or knob.high <= 0 else 1.0
        far = [_at(base, model, {knob.name: sign * share * knob.spread}, release) for share in DECADES for release in RELEASES]
    return near, far


def _at(base, model, amplitudes, release):
    """The baseline's z with amplitudes set and nuisances moved by factors, or back to where they were expected."""
    z = np.concatenate([base.z, np.zeros(len(model.knobs) - len(base.z))])
    for k, knob in enumerate(model.knobs):
        if knob.name in amplitudes:
            z[k] = knob.encode(np.clip(amplitudes[knob.name], knob.low, knob.high))
        elif knob.name in release:
            factor = release[knob.name]
            z[k] = 0.0 if factor is None else knob.encode(np.clip(factor * knob.decode(z[k]), knob.low, knob.high))
    return z


def _costs(task, model, starts):
    """(S,) costs of the starts (``Fit.cost``), infinite where the twin blows up: what is linear near nothing need not be so in full."""
    steps = [max(of) for of in zip(*(task.substeps(model, z) for z in starts), strict=True)]
    found = task.residuals(task.predict(model, starts, steps))
    far = [remoteness(z / model.wide) for z in starts]
    return np.array([task.by_frame.misfit(r) + d if np.isfinite(r).all() else np.inf for r, d in zip(found, far, strict=True)])


def evaluate(task: Task, found: Fit, parts: Sequence[Part], *, leave: Callable[[Replica], np.ndarray] = nobody) -> Verdictable:
    """Errors of a fit on all parts, the first of which it was fitted to; nodes that ``leave`` names do not count."""
    observed, free = {}, {}
    runs = {}
    for part in parts:
        simulator = task.simulators[part.index]
        if part.index not in runs:
            last = max(p.last for p in parts if p.index == part.index)
            rows = [{**found.values, "observer_bandwidth": b} for b in (task.bandwidth, 0.0)]
            substeps = simulator.substeps(found.model.terms, found.values, most=JUDGED)
            runs[part.index] = simulator.run(found.model.terms, rows, last, substeps=substeps)
        watched, alone = runs[part.index]
        replica = simulator.replica
        there = counted(replica, part.first, part.last)
        there[:, leave(replica)] = False
        seen = replica.sightings.position[part.first : part.last]
        gaps = [np.where(there[..., None], seen - x[part.first : part.last], 0.0) for x in (watched, alone)]
        if not there.any():
            observed[part.name] = free[part.name] = float("nan")
            continue
        by_frame = Frames.of_seen([there], [floor_of(replica, task.finest)])
        observed[part.name] = float(np.exp(by_frame.misfit(gaps[0].ravel() / np.sqrt(there.sum()))))
        free[part.name] = float(np.linalg.norm(gaps[1], axis=-1)[there].mean())
    return Verdictable(found, observed, free)


def foresighted(task: Task, found: Verdictable, parts: Sequence[Part], *, leave: Callable[[Replica], np.ndarray] = nobody) -> Verdictable:
    """The same with what it foresees."""
    return replace(found, foreseen=foreseen(task, found.fit, parts, leave=leave))
