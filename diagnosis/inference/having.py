"""Twins that have what was named: how far they are off where it is right.

What a name leaves is judged by what sound twins leave. But twins that have the effect may differ by more than sound ones: where an obstacle
folds a rope, or a hand lets it go, a millimetre of another mesh becomes a centimetre. So a name that leaves more than sound twins do is
judged once more, by the members of the recording with the effect in them: predicted by the hypothesis that is asked, not by that of nothing
missing (a predictive check under each model: Gelman et al. 2013, section 6.3).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..config import DiagnosisConfig
from .absorption import absorb
from .covariance import chosen
from .evidence import Evidence
from .members import FEWEST, ran
from .refit import Refit
from .significance import Significance, misfits, unexplained

__all__ = ["left_having"]


def left_having(evidence: Evidence, test: Significance, refit: Refit, config: DiagnosisConfig) -> float | None:
    """p that a twin that has the effect of ``refit`` leaves as much of the fitted block means as the refit does, if that effect is right.

    The members of ``evidence`` run at the refit's amounts, place and shape, their parameters as far from the refit's as they were from the
    fit's, and are absorbed by the twin with the effect, its amounts included. None where fewer than four of them run.
    """
    search = refit.search
    if search is None or not evidence.members:
        return None
    rows, numbers = search.asked.rows, refit.numbers
    low, high = search.forward.bounds
    effect = search.candidate(numbers).values(refit.amounts)
    made = [replace(one, shift=np.clip(one.shift + refit.shift, low, high), values={**one.values, **effect}) for one in evidence.members]
    kept = [k for k, one in enumerate(made) if search.twins.steps({**search.forward.values(one.shift), **one.values}) <= search.most]
    if len(kept) < FEWEST:
        return None
    runs = ran([made[k] for k in kept], search.twins, config)
    finite = np.isfinite(runs).all(1)
    if finite.sum() < FEWEST:
        return None
    runs, good = runs[finite], np.array(kept)[finite]
    at, everything = search.place(numbers, refit.prediction), np.ones(search.size, bool)
    slopes = search.measured(at, search.slopes, search.low, search.high, everything)
    sound = evidence.scatter
    sd = np.where(sound.layout.fitted, np.sqrt(np.diag(sound.noise)), np.inf)
    both = np.concatenate([runs, search.asked.data[None]])
    about: dict = dict(bounds=(search.low - numbers, search.high - numbers), rounds=config.rounds)
    left = absorb(both, refit.prediction, slopes, sd, lambda shift: search.run(numbers + shift), **about)[0][:-1]
    scatter = replace(sound, left=left, slopes=slopes)
    noisy = left + (evidence.noisy - sound.left)[good]
    prior = chosen(scatter, config, noisy)
    scatter, noisy = scatter.only(rows), noisy[:, rows]
    likelihood, residual = scatter.likelihood(prior), search.asked.left(refit.prediction)
    _, usual = misfits(likelihood, scatter.left_out(prior), residual, noisy)
    return unexplained(replace(test, misfits=tuple(usual)), likelihood, residual, evidence.forward.motion[rows])
