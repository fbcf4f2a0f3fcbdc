"""A candidate fitted in full: its amounts, its place, its shape and all that a sound twin's fit may change, weighed by the error of sound
twins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...methods.continuum.estimate import run_within
from ..config import DiagnosisConfig
from ..effects import Candidate
from .amounts import Scale
from .forward import Forward
from .likelihood import Likelihood
from .scan import Signature
from .slopes import corrected

__all__ = ["Gain", "Refit", "gained", "refitted"]

TRIALS = (1.0, 0.4, 0.1, 0.03)  # of a Gauss-Newton step, one after the other until one is better: what swings falls elsewhere beyond
TRUSTED = 0.2  # of what slopes promised: a step that gains less says that they are those of elsewhere
FARTHEST = 3.0  # prior standard deviations that a place or a shape may be astray
DIFFERENCE = 0.05  # prior standard deviations
ARRIVED = 0.05  # nats: evidences that differ by less say nothing of names


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
    approximation.

    Standard deviations are those of the curvature, or what sound twins would be said to have of the effect by the same slopes (RMS), where
    that is more: of a covariance from a few members the curvature promises too much (Huber 1967; Mueller 2013, whose sandwich this is)."""

    candidate: Candidate | None
    shift: np.ndarray
    amounts: np.ndarray
    sd: np.ndarray
    prediction: np.ndarray
    log_evidence: float


@dataclass(frozen=True, eq=False)
class _Place:
    """numbers (n + m + k + f,) in prior standard deviations, k of them coordinates of the effect's place and f its shapes; the prediction
    (B,) there, and the negative log posterior."""

    numbers: np.ndarray
    prediction: np.ndarray
    cost: float


def refitted(
    forward: Forward,
    data,
    reference,
    slopes,
    likelihood: Likelihood,
    rows,
    signature: Signature | None,
    config: DiagnosisConfig,
    sound: Sequence[tuple[Likelihood, np.ndarray]] = (),
) -> Refit:
    """Of ``signature``'s candidate, or of the sound twin alone (None), to the ``rows`` of ``data`` (B,) m.

    likelihood  of these rows, without what parameters do, which are fitted
    sound       what sound twins leave of these rows, each with the likelihood by the others

    All refits of a recording have the same budget of steps. Slopes
    are the shared ones at first, corrected after each step by what it missed (``slopes``), and measured again where a step gained less than
    a fifth of what they promised: an effect that moves a body by centimetres leads far from where the sound twin's fit ended. A refit has
    arrived where fresh slopes lead nowhere. Shapes stay as they were tried until all else has arrived: what they lead to is better than
    without. A place has a prior of ``config.astray`` around the one that was tried, the logarithm of a shape one
    of ``config.reshaped``, amounts one by the motion that they make (``amounts``). What would take more than ``config.dearest`` times the
    steps is not run. Runs end with the fitted frames, but one where the refit arrived; where that diverges, all frames are run all along.
    """
    given = (data, reference, slopes, likelihood, rows, signature, config, sound)
    alone = forward.fitted_alone(reference)
    found = _searched(alone, *given)
    if alone is forward:
        return found
    twins, more = (
        (forward, {}) if found.candidate is None else (forward.with_effects([found.candidate]), found.candidate.values(found.amounts))
    )
    whole = twins.rows([{**forward.values(found.shift), **more}])[0]
    return replace(found, prediction=whole) if np.isfinite(whole).all() else _searched(forward, *given)


def _searched(forward, data, reference, slopes, likelihood, rows, signature, config, sound) -> Refit:
    """As ``refitted``, all runs by ``forward``."""
    count, amounts = slopes.shape[1], len(signature.unit) if signature else 0
    spots, forms = (len(signature.candidate.coordinates), len(signature.candidate.effect.forms)) if signature else (0, 0)
    twins = forward.with_effects([signature.candidate]) if signature else forward
    low, high = forward.bounds

    most = config.dearest * forward.steps(forward.values(np.zeros(count)))

    def there(numbers) -> Candidate:
        assert signature is not None  # only what has a signature has a place
        at, form = np.split(numbers[count + amounts :], [spots])
        return signature.candidate.shifted(1e-3 * config.astray * at).formed(config.reshaped**form)

    def simulated(shifts, more):
        rows = [{**forward.values(s), **one} for s, one in zip(shifts, more, strict=True)]
        return run_within(rows, twins.rows, twins.steps, most, len(data))

    if signature is not None:
        tried = signature.candidate
        scale = Scale.of(
            signature, lambda a: simulated(np.zeros((len(a), count)), map(tried.values, a))[:, rows], reference[rows], config.motion
        )
        astray = np.full(spots + forms, FARTHEST)
        low, high = np.r_[low, scale.low, -astray], np.r_[high, scale.high, astray]
        own = signature.columns / signature.unit * scale.slope(np.zeros(amounts))
        slopes = np.c_[slopes, own, np.zeros((len(slopes), spots + forms))]

    def run(numbers):
        more = ({} if signature is None else there(row).values(scale.amounts(row[count : count + amounts])) for row in numbers)
        return simulated(numbers[:, :count], more)

    def place(numbers, prediction):
        if not np.isfinite(prediction).all():
            return _Place(numbers, prediction, np.inf)
        return _Place(numbers, prediction, float(numbers @ numbers) / 2 - likelihood.log_density((data - prediction)[rows], guarded=True))

    at, jacobian, fresh = place(np.zeros(len(low)), reference), slopes, False
    held = np.arange(len(low)) >= len(low) - forms
    low[held], high[held] = 0.0, 0.0
    begun = forward.cost.runs
    for _ in range(config.steps):
        if forward.cost.runs - begun >= config.runs:
            break
        step, promised = _step(at, jacobian, data, likelihood, rows, low, high)
        for part in TRIALS:
            numbers = np.clip(at.numbers + part * step, low, high)
            found = place(numbers, run(numbers[None])[0])
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
            jacobian = _slopes(run, at, jacobian, low, high, measured)
    curvature, _ = _normal(likelihood, (data - at.prediction)[rows], jacobian[rows])
    deviations = np.sqrt(np.diag(np.linalg.inv(curvature)))
    evidence = -at.cost - np.linalg.slogdet(curvature)[1] / 2 + _one_sided(signature, at.numbers[count:], deviations[count:])
    if signature is None:
        return Refit(None, at.numbers, np.zeros(0), np.zeros(0), at.prediction, float(evidence))
    mistaken = [_normal(one, left, jacobian[rows]) for one, left in sound]
    spread = np.sqrt(np.mean([np.linalg.solve(*equations) ** 2 for equations in mistaken], axis=0)) if mistaken else 0.0
    own, sd = (one[count : count + amounts] for one in (at.numbers, np.maximum(deviations, spread)))
    return Refit(there(at.numbers), at.numbers[:count], scale.amounts(own), sd * scale.slope(own), at.prediction, float(evidence))


def _slopes(run, at: _Place, jacobian, low, high, measured):
    """(B, n) by differences around a place, of a deviation each over 20; what it was where a run diverged, or is not ``measured`` (n,)."""
    steps = np.where(at.numbers + DIFFERENCE <= high, DIFFERENCE, -DIFFERENCE)
    steps = np.clip(at.numbers + steps, low, high) - at.numbers
    found = jacobian.copy()
    with np.errstate(invalid="ignore", divide="ignore"):
        found[:, measured] = ((run(at.numbers + np.diag(steps)[measured]) - at.prediction) / steps[measured, None]).T
    return np.where(np.isfinite(found).all(0), found, jacobian)


def _one_sided(signature, amounts, deviations) -> float:
    """Log of the share of the posterior that is on the side of a one-sided amount, over the half of the prior that is."""
    from scipy.special import log_ndtr

    if signature is None:
        return 0.0
    parts = zip(signature.candidate.effect.amounts, np.abs(amounts / deviations), strict=False)  # places come after them
    return float(sum(np.log(2) + log_ndtr(far) for a, far in parts if a.one_sided))


def _normal(likelihood, residual, ways):
    """((n, n) curvature of the negative log posterior, in prior standard deviations: Gauss and Newton's, by a guarded Student t's weight;
    (n,) its fall by what of ``residual`` (b,) m the slopes ``ways`` (b, n) explain)."""
    white, ways = likelihood.whitened(residual), likelihood.whitened(ways)
    weight = likelihood.weight(float(white @ white), len(white))
    return weight * ways.T @ ways + np.eye(ways.shape[1]), weight * ways.T @ white


def _step(at, jacobian, data, likelihood, rows, low, high):
    """((n,) Gauss and Newton's, what presses against a bound staying there; what it promises to gain)."""
    curvature, fall = _normal(likelihood, (data - at.prediction)[rows], jacobian[rows])
    downhill = fall - at.numbers
    free = ~((at.numbers <= low) & (downhill < 0) | (at.numbers >= high) & (downhill > 0))
    step = np.zeros(len(free))
    step[free] = np.linalg.solve(curvature[np.ix_(free, free)], downhill[free])
    return step, float(downhill @ step) / 2


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
