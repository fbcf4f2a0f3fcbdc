"""The few that the screening left: fitted in full, with the same budget as the baseline, and judged on what was held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .fit import Fit, Task, fit, mean_error
from .hypotheses import Hypothesis
from .model import Model
from .screen import Part, Score, _with

__all__ = ["Verdictable", "evaluate", "refit"]


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
        start = [k.encode(np.clip(0.7 * a, k.low, k.high)) for k, a in zip(h.knobs, score.amplitude, strict=True)]
        start = np.clip(start, -4, 4)
        free = np.zeros(len(model.knobs) - len(base.z) - len(start))
        fits.append(fit(task, model, np.concatenate([base.z, start, free]), iterations=iterations))
    return fits


def evaluate(task: Task, found: Fit, score: Score | None, parts: Sequence[Part], *, carry=None) -> Verdictable:
    """Errors of a fit on all parts: under the task's observer, and running free."""
    carry = carry or (lambda values, index: values)
    observed, free = {}, {}
    runs = {}
    for part in parts:
        simulator = task.simulators[part.index]
        if part.index not in runs:
            last = max(p.last for p in parts if p.index == part.index)
            rows = [{**carry(found.values, part.index), "observer_bandwidth": b} for b in (task.bandwidth, 0.0)]
            runs[part.index] = simulator.run(found.model.terms, rows, last)
        watched, alone = runs[part.index]
        replica = simulator.replica
        seen = replica.sightings.position[part.first : part.last]
        gap = ((seen - watched[part.first : part.last]) ** 2).sum(-1)
        held = replica.system.grips
        gap[:, held[held >= 0]] = np.nan
        gap = np.where(np.isfinite(seen[..., 0]) & ~np.isfinite(gap), np.inf if not len(held[held >= 0]) else gap, gap)
        observed[part.name] = float(np.nanmean(gap)) if np.isfinite(gap).any() else float("inf")
        free[part.name] = mean_error(simulator, alone, part.first, part.last)
    return Verdictable(found, score, observed, free)
