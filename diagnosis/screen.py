"""The score test: what each hypothesis could explain of the innovations that no turn of the baseline's knobs can."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from .fit import INDEPENDENT, Fit, Task, turned
from .hypotheses import STAGES_IN_ONE, Hypothesis
from .parts import MARGIN, Part, finite, innovations, judged

__all__ = ["Score", "screen"]


@dataclass(frozen=True)
class Score:
    """What a hypothesis is worth in the linear neighbourhood of the baseline.

    amplitude  (A,) estimated amplitudes, in the parameters' units
    gains      by part, the share of the baseline's (re-fitted) squared innovation that it removes in the (geometric) mean frame
    kept       share of its own effect on the fitted part that the baseline cannot absorb
    error      (A,) standard errors of the amplitudes
    direction  (R,) its unabsorbed effect on the fitted part, normalised: two hypotheses that share it are told apart by nothing here
    """

    hypothesis: Hypothesis
    amplitude: np.ndarray
    gains: dict[str, float]
    kept: float
    error: np.ndarray
    direction: np.ndarray


def screen(task: Task, base: Fit, hypotheses: Sequence[Hypothesis], parts: Sequence[Part]) -> list[Score]:
    """Score ``hypotheses`` at ``base``: amplitudes from the first of ``parts``, gains on all."""
    groups = defaultdict(list)
    for h in hypotheses:
        groups["one" if h.term.stage in STAGES_IN_ONE else h.term].append(h)
    scores: list[Score] = []
    nuisance = None
    trials, widths = turned(base.model, base.z)
    substeps = [ceil(MARGIN * n) for n in task.substeps(base.model, base.z)]
    for members in groups.values():
        model = base.model.extended({h.term for h in members}, {}, ())
        off = {k.name: max(0.0, k.low) for h in members for k in h.knobs}
        turns = [base.model.decode(z) for z in trials] if nuisance is None else []
        rows = [{**row, **off} for row in (base.values, *turns)]
        steps = []
        for h in members:
            for knob in h.knobs:
                sign = 1.0 if knob.high > 0 else -1.0
                steps.append(sign * knob.step * knob.spread)
                rows.append({**base.values, **off, **h.values, knob.name: steps[-1]})
        residuals, by_frame = innovations(task, model, rows, parts, substeps)
        origin = [r[0] for r in residuals]
        done = 1 + len(turns)
        if nuisance is None:
            nuisance = [finite((r[1:done] - r[0]).T / widths) for r in residuals]
        columns = [finite((r[done:] - r[0]).T / np.array(steps)) for r in residuals]
        at = 0
        for h in members:
            own = slice(at, at + len(h.knobs))
            at += len(h.knobs)
            blind = [judged(task, part, h.follows) for part in parts]
            mine = [c[:, own] for c in columns]
            scores.append(_score(h, *(_without(part, blind) for part in (origin, nuisance, mine)), parts, by_frame))
    return scores


def _without(parts, blind):
    return [p * (b if p.ndim == 1 else b[:, None]) for p, b in zip(parts, blind, strict=True)]


def _score(h, origin, nuisance, columns, parts, by_frame):
    e, n, s = origin[0], nuisance[0], columns[0]
    root = np.sqrt(by_frame[0].huber(e, e) * by_frame[0].weights(e))[:, None]
    e, n, s = e * root[:, 0], n * root, s * root
    spreads = np.array([k.spread for k in h.knobs])
    ridge = 1 / INDEPENDENT
    a = s * spreads
    plain = _ridge(n, e, ridge)
    joined = _ridge(np.concatenate([n, a], 1), e, ridge, [k.prior for k in h.knobs])
    shift, amplitude = joined[: n.shape[1]], joined[n.shape[1] :]
    low = np.array([k.low for k in h.knobs])
    if (len(h.knobs) == 1 and low[0] >= 0 and amplitude[0] > 0) or (len(h.knobs) == 1 and h.knobs[0].high <= 0 and amplitude[0] < 0):
        # residual = y - x: a column is d(residual), so the estimate of an amplitude is the negative of its coefficient
        shift, amplitude = plain, np.zeros(1)
    gains = {}
    for part, o, nn, ss, frames in zip(parts, origin, nuisance, columns, by_frame, strict=True):
        before = o - nn @ plain
        after = o - nn @ shift - (ss * spreads) @ amplitude
        gains[part.name] = float(1 - np.exp(frames.misfit(after) - frames.misfit(before)))
    bare = a - n @ _ridge(n, a, ridge)
    size = float((bare**2).sum())
    kept = size / max(float((a**2).sum()), 1e-300)
    information = bare.T @ bare + 1e-12 * np.eye(a.shape[1])
    error = spreads * np.sqrt(np.maximum(np.diag(np.linalg.pinv(information)) * ridge, 0))
    effect = bare @ amplitude
    direction = effect / max(np.linalg.norm(effect), 1e-300)
    return Score(h, -amplitude * spreads, gains, kept, error, direction)


def _ridge(a, b, ridge, last=()):
    """Least squares with a prior of one spread on every column, of ``last`` spreads on the last ones."""
    prior = np.full(a.shape[1], ridge)
    if len(last):
        prior[-len(last) :] /= np.square(last)
    return np.linalg.solve(a.T @ a + np.diag(prior + 1e-15), a.T @ b)
