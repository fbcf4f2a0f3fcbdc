"""The score test: what each hypothesis could explain of the innovations that no turn of the baseline's knobs can."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np

from .fit import INDEPENDENT, Fit, Task, turned
from .hypotheses import STAGES_IN_ONE, Hypothesis
from .parts import MARGIN, Part, finite, innovations, judged

__all__ = ["Score", "confirm", "screen"]

RIDGE = 1 / INDEPENDENT  # of least squares on weighted innovations: a prior of one spread, with data that are worth so many


@dataclass(frozen=True)
class Score:
    """What a hypothesis is worth in the linear neighbourhood of the baseline.

    amplitude  (A,) estimated amplitudes, in the parameters' units
    gains      by part, the share of the baseline's (re-fitted) squared innovation that it removes in the (geometric) mean frame
    shows      by part, standard errors by which innovations follow what these amplitudes foresee and no turn of the baseline's knobs does:
               about normal by chance on what was not fitted; a large effect in a small part of what is unpredictable stands out here
    kept       share of its own effect on the fitted part that the baseline cannot absorb
    error      (A,) standard errors of the amplitudes
    direction  (R,) its unabsorbed effect on the fitted part, normalised: two hypotheses that share it are told apart by nothing here
    """

    hypothesis: Hypothesis
    amplitude: np.ndarray
    gains: dict[str, float]
    shows: dict[str, float]
    kept: float
    error: np.ndarray
    direction: np.ndarray


@dataclass(frozen=True)
class Turn:
    """Amplitudes of a hypothesis, by name, set to what is small enough to be linear; ``step``: the size by which a slope divides."""

    hypothesis: Hypothesis
    amplitudes: dict[str, float]
    step: float


@dataclass(frozen=True)
class Response:
    """What a turn does: by part, the innovations (R,) without it and their slope (R,)."""

    origin: list[np.ndarray]
    column: list[np.ndarray]


def screen(task: Task, base: Fit, hypotheses: Sequence[Hypothesis], parts: Sequence[Part]) -> list[Score]:
    """Score ``hypotheses`` at ``base``: amplitudes from the first of ``parts``, what they are worth on all."""
    turns = []
    for h in hypotheses:
        for knob in h.knobs:
            step = (1.0 if knob.high > 0 else -1.0) * knob.step * knob.spread
            turns.append(Turn(h, {knob.name: step}, step))
    found, nuisance, by_frame = _responses(task, base, turns, parts)
    scores, at = [], 0
    for h in hypotheses:
        mine = found[at : at + len(h.knobs)]
        at += len(h.knobs)
        columns = [np.stack([r.column[k] for r in mine], 1) for k in range(len(parts))]
        blind = [judged(task, part, h.follows) for part in parts]
        origin, others, own = (_without(of, blind) for of in (mine[0].origin, nuisance, columns))
        scores.append(_score(h, origin, others, own, parts, by_frame))
    return scores


def confirm(task: Task, base: Fit, scores: Sequence[Score], parts: Sequence[Part]) -> list[Score]:
    """The scores with what their amplitudes show on further ``parts``, which have no say in them."""
    turns = [_together(score) for score in scores]
    moved = [t for t in turns if t.step > 0]
    found, nuisance, by_frame = _responses(task, base, moved, parts) if moved and parts else ([], [], [])
    response, out = dict(zip(map(id, moved), found, strict=False)), []
    for score, turn in zip(scores, turns, strict=True):
        shows = {part.name: 0.0 for part in parts}
        if id(turn) in response:
            r, blind = response[id(turn)], [judged(task, part, score.hypothesis.follows) for part in parts]
            of_part = (_without(of, blind) for of in (r.origin, nuisance, r.column))
            for part, e, n, u, frames in zip(parts, *of_part, by_frame, strict=True):
                shows[part.name] = _shows(e, n, u, frames)
        out.append(replace(score, shows=score.shows | shows))
    return out


def _together(score: Score) -> Turn:
    """All amplitudes of a score at once, the greatest of them one step of finite differences large; a step of 0 where there are none."""
    knobs = score.hypothesis.knobs
    most = max(abs(a) / (k.step * k.spread) for k, a in zip(knobs, score.amplitude, strict=True))
    share = 1 / most if most > 0 else 0.0
    return Turn(score.hypothesis, {k.name: share * a for k, a in zip(knobs, score.amplitude, strict=True)}, share)


def _responses(task, base, turns, parts):
    """What each of ``turns`` does; by part the slopes (R, K) of the baseline's own knobs, and what its frames mean."""
    groups = defaultdict(list)
    for k, turn in enumerate(turns):
        groups["one" if turn.hypothesis.term.stage in STAGES_IN_ONE else turn.hypothesis.term].append(k)
    found: list[Any] = [None] * len(turns)  # a ``Response`` each, once their group has been
    nuisance, by_frame = None, []
    trials, widths = turned(base.model, base.z)
    substeps = [ceil(MARGIN * n) for n in task.substeps(base.model, base.z)]
    for members in groups.values():
        hypotheses = [turns[k].hypothesis for k in members]
        model = base.model.extended({h.term for h in hypotheses}, {}, ())
        off = {k.name: max(0.0, k.low) for h in hypotheses for k in h.knobs}
        own = [base.model.decode(z) for z in trials] if nuisance is None else []
        rows = [{**row, **off} for row in (base.values, *own)]
        rows += [{**base.values, **off, **h.values, **turns[k].amplitudes} for k, h in zip(members, hypotheses, strict=True)]
        residuals, by_frame = innovations(task, model, rows, parts, substeps)
        if nuisance is None:
            nuisance = [finite((r[1 : 1 + len(own)] - r[0]).T / widths) for r in residuals]
        for j, k in enumerate(members, 1 + len(own)):
            column = [finite((r[j] - r[0])[:, None] / turns[k].step)[:, 0] for r in residuals]
            found[k] = Response([r[0] for r in residuals], column)
    return found, nuisance, by_frame


def _without(parts, blind):
    return [p * (b if p.ndim == 1 else b[:, None]) for p, b in zip(parts, blind, strict=True)]


def _score(h, origin, nuisance, columns, parts, by_frame):
    spreads = np.array([k.spread for k in h.knobs])
    root = _root(origin[0], by_frame[0])
    e, n, a = origin[0] * root, nuisance[0] * root[:, None], columns[0] * root[:, None] * spreads
    plain = _ridge(n, e)
    joined = _ridge(np.concatenate([n, a], 1), e, [k.prior for k in h.knobs])
    shift, amplitude = joined[: n.shape[1]], joined[n.shape[1] :]
    low = np.array([k.low for k in h.knobs])
    if (len(h.knobs) == 1 and low[0] >= 0 and amplitude[0] > 0) or (len(h.knobs) == 1 and h.knobs[0].high <= 0 and amplitude[0] < 0):
        # residual = y - x: a column is d(residual), so the estimate of an amplitude is the negative of its coefficient
        shift, amplitude = plain, np.zeros(1)
    gains, shows = {}, {}
    for part, o, nn, ss, frames in zip(parts, origin, nuisance, columns, by_frame, strict=True):
        before = o - nn @ plain
        effect = (ss * spreads) @ amplitude
        gains[part.name] = float(1 - np.exp(frames.misfit(o - nn @ shift - effect) - frames.misfit(before)))
        shows[part.name] = _shows(o, nn, -effect, frames)
    bare = a - n @ _ridge(n, a)
    size = float((bare**2).sum())
    kept = size / max(float((a**2).sum()), 1e-300)
    information = bare.T @ bare + 1e-12 * np.eye(a.shape[1])
    error = spreads * np.sqrt(np.maximum(np.diag(np.linalg.pinv(information)) * RIDGE, 0))
    effect = bare @ amplitude
    direction = effect / max(np.linalg.norm(effect), 1e-300)
    return Score(h, -amplitude * spreads, gains, shows, kept, error, direction)


def _root(e, frames):
    """(R,) by which innovations ``e`` are weighed."""
    return np.sqrt(frames.huber(e, e) * frames.weights(e))


def _shows(e, nuisance, effect, frames):
    """Standard errors by which the innovations ``e`` (R,) follow ``-effect`` (R,), the change that amplitudes would make to them.

    Both are freed of what ``nuisance`` (R, K) can do; the slope of one by the other is worth its size over its standard error.
    """
    root = _root(e, frames)
    e, n, u = e * root, nuisance * root[:, None], effect * root
    e, u = e - n @ _ridge(n, e), u - n @ _ridge(n, u)
    size = float(u @ u)
    return -float(u @ e) / np.sqrt(RIDGE * size) if size > 0 else 0.0


def _ridge(a, b, last=()):
    """Least squares with a prior of one spread on every column, of ``last`` spreads on the last ones."""
    prior = np.full(a.shape[1], RIDGE)
    if len(last):
        prior[-len(last) :] /= np.square(last)
    return np.linalg.solve(a.T @ a + np.diag(prior + 1e-15), a.T @ b)
