"""The few that the screening left: fitted in full, with the same budget as the baseline, and judged on what was held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .fit import Fit, Task, fit
from .hypotheses import Hypothesis
from .model import Model
from .replica import Replica
from .screen import Part, Score, _with

__all__ = ["Verdictable", "evaluate", "refit"]

STARTS = (0.02, 0.2, 0.6, 1.2)  # shares of the linear estimate from which a refit may begin
TYPICAL = (0.5, 2.0)  # shares of a noticeable size
SOFTER = (1.0, 0.3)  # factors on the body's stiffness


@dataclass(frozen=True)
class Verdictable:
    """A fitted model and its errors.

    fit       where its fit ended
    score     the linear score it came from; None for the baseline
    observed  by part, mean squared innovation under the observer [m^2]
    free      by part, mean error of the free-running simulation [m]
    """

    fit: Fit
    score: Score | None
    observed: dict[str, float]
    free: dict[str, float]

    @property
    def hypothesis(self) -> Hypothesis | None:
        return self.score.hypothesis if self.score else None

    def gain(self, base: Verdictable, part: str) -> float:
        """Share of the baseline's squared innovation that is gone."""
        return 1 - self.observed[part] / max(base.observed[part], 1e-300)


def refit(task: Task, base: Fit, scores: Sequence[Score], *, iterations: int, spacing: float) -> list[Fit]:
    """The baseline and each scored hypothesis, all from ``base`` with the same number of steps; shapes and places may move."""
    fits = [fit(task, base.model, base.z, iterations=iterations)]
    for score in scores:
        h = score.hypothesis
        model = _with(base.model, {h.term})
        model = Model(model.terms, {**model.values, **h.values}, base.model.knobs + h.knobs + h.free_knobs(spacing))
        fits.append(fit(task, model, _best(task, model, _starts(base, model, score)), iterations=iterations))
    return fits


def _starts(base: Fit, model: Model, score: Score) -> list[np.ndarray]:
    """Where a refit may begin: at shares of the linear estimate and at noticeable sizes; a law of the material with a softer body, too.

    A twin that was fitted without the effect has taken some of it for stiffness: far from there its linear estimate means little.
    """
    h, names = score.hypothesis, model.names
    sizes = [share * np.asarray(score.amplitude) for share in STARTS]
    effect = h.term.effect
    softer = (1.0,)
    if effect and h.term.stage in ("axial", "strand"):
        signs = np.where(np.asarray(score.amplitude) < 0, -1.0, 1.0)
        typical = np.array([abs(effect.typical[k.name]) for k in h.knobs])
        sizes += [share * typical * signs for share in TYPICAL]
        softer = SOFTER
    starts = []
    for size in sizes:
        for factor in softer:
            z = np.concatenate([base.z, np.zeros(len(model.knobs) - len(base.z))])
            for k, amplitude in zip(h.knobs, size, strict=True):
                z[names.index(k.name)] = k.encode(np.clip(amplitude, k.low, k.high))
            at = names.index("body_stiffness")
            z[at] = model.knobs[at].encode(max(model.knobs[at].low, factor * model.knobs[at].decode(z[at])))
            starts.append(z)
    return starts


def _best(task, model, starts):
    """The start with the least squared innovation: what is linear near nothing need not be so at its full size."""
    steps = [max(of) for of in zip(*(task.substeps(model, z) for z in starts), strict=True)]
    found = task.residuals(task.predict(model, starts, steps))
    costs = [float(r @ r) if np.isfinite(r).all() else np.inf for r in found]
    return starts[int(np.argmin(costs))]


def evaluate(
    task: Task, found: Fit, score: Score | None, parts: Sequence[Part], *, leave: Callable[[Replica], np.ndarray] | None = None
) -> Verdictable:
    """Errors of a fit on all parts: under the task's observer, and running free; nodes that ``leave`` names do not count."""
    observed, free = {}, {}
    runs = {}
    for part in parts:
        simulator = task.simulators[part.index]
        if part.index not in runs:
            last = max(p.last for p in parts if p.index == part.index)
            rows = [{**found.values, "observer_bandwidth": b} for b in (task.bandwidth, 0.0)]
            runs[part.index] = simulator.run(found.model.terms, rows, last)
        watched, alone = runs[part.index]
        replica = simulator.replica
        judged = np.ones(len(replica.nodes), bool)
        judged[replica.system.grips[replica.system.grips >= 0]] = False
        if leave is not None:
            judged[leave(replica)] = False
        seen = replica.sightings.position[part.first : part.last, judged]
        there = np.isfinite(seen[..., 0])
        squares, lengths = (((seen - x[part.first : part.last, judged]) ** 2).sum(-1)[there] for x in (watched, alone))
        observed[part.name] = float(squares.mean()) if len(squares) else float("nan")
        free[part.name] = float(np.sqrt(lengths).mean()) if len(lengths) else float("nan")
    return Verdictable(found, score, observed, free)
