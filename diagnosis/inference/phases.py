"""Recordings and their fitted sound twin to a verdict: the phases of the inference."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...datasets.scenario import Scenario
from ...methods.continuum.twin import ContinuumTwin
from ..carried import stray_of
from ..config import DiagnosisConfig
from ..effects import Candidate
from ..ground import sunk
from ..turn import cameras_rather
from .budget import Budget, Detectable, budget, detectable
from .controls import Controls
from .covariance import Prior, chosen
from .evidence import Evidence, gathered
from .having import left_having
from .refit import Gain, Refit, gained
from .scan import Signature
from .significance import Significance, fitted_rows, significance, unexplained
from .trials import Trials, chances_of
from .wander import Wander, wander

__all__ = ["Answer", "Named", "Tested", "budget_of", "infer", "shortcoming", "tested", "weighed", "withdrawn"]


@dataclass(frozen=True, eq=False)
class Tested:
    """The prior of the covariance, the test, whether anything says how far a sound twin of such a body is off (``founded``), and whether
    somebody ``told`` that something is missing."""

    prior: Prior
    test: Significance
    founded: bool
    told: bool = False

    def alarms(self, config: DiagnosisConfig) -> bool:
        return self.told or (self.founded and self.test.p < config.level)


@dataclass(frozen=True, eq=False)
class Named:
    """A candidate that was refitted: its ``probability`` among all effects, its ``log_evidence`` over that of nothing missing, what hands
    tell of it included, what it gains on frames that nobody fitted, where it acts, and
    the p that a sound body's twin leaves as much of the fitted frames as it does (``left``), or one that has the effect (``having``), 0
    where the twin that is fitted on with it leaves more than the sound one: what explains too little is no name."""

    candidate: Candidate
    name: str
    words: str
    probability: float
    log_evidence: float
    amounts: dict[str, float]
    sds: dict[str, float]
    place: tuple[float, ...] | None
    gain: Gain
    left: float
    refit: Refit


@dataclass(frozen=True, eq=False)
class Answer:
    """verdict: adequate, named, unknown, or unfounded where nothing says how far a sound twin is off; ``probabilities`` of effects, given
    that one of them acts; ``parallel``: names that the recordings cannot tell from the first; ``wandering``: how far tracks stray in each
    recording that is asked, none of markers; ``sunk``: how clearly the body lies below the told ground in each (``ground.sunk``), and where
    it does, how much likelier than the ground cameras are to be wrong (``turn.cameras_rather``)."""

    verdict: str
    test: Significance
    prior: Prior
    named: tuple[Named, ...]
    probabilities: dict[str, float]
    parallel: tuple[str, ...]
    detectable: tuple[Detectable, ...]
    budget: tuple[Budget, ...]
    runs: int
    seconds: float
    wandering: tuple[Wander, ...] = ()
    sunk: tuple[float, ...] = ()
    cameras_rather: float = 0.0


def infer(
    twin: ContinuumTwin,
    recordings: Sequence[Scenario],
    config: DiagnosisConfig | None = None,
    *,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Answer:
    """Whether, and by which effect, a sound ``twin`` fails the recordings whose train frames it was fitted to.

    Train frames alone are fitted, tested and scanned. Frames held out, which no fit sees, say what a refit gains. Of other recordings
    nothing is looked at. Raises NoTracks where points do not correspond, ValueError where too few members could be run.
    """
    config = config or DiagnosisConfig()
    return weighed(gathered(twin, recordings, config, seed=seed, progress=progress), config, progress=progress)


def weighed(
    evidence: Evidence,
    config: DiagnosisConfig,
    found: Tested | None = None,
    *,
    refits: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Answer:
    """The test (``found``, if it was made before), names, detectable sizes and the budget of what ``gathered`` returns.

    Where the test alarms, much of each effect is tried, and the best are refitted, which costs twice as many runs as all before and more,
    unless ``refits`` says otherwise.
    """
    tell = progress or (lambda _: None)
    e, scatter = evidence, evidence.scatter
    found = found or tested(evidence, config)
    prior, test, alarm = found.prior, found.test, found.alarms(config)
    holds = f"; a hand holds {np.exp(-test.standardised['grip']):.2f} of what was told" if "grip" in test.standardised else ""
    tell(f"p {test.p:.3g} (misfit {test.p_misfit:.3g}, scan {test.p_scan:.3g}{holds})")
    trials = Trials.of(e, prior, test, config).with_refits() if alarm and refits else None
    best = [(e.catalogue[k], trials.made[k], trials.over_sound(k, trials.made[k])) for k in trials.best.values()] if trials else []
    tell(f"{len(best)} candidates refitted")
    sound = trials.sound.prediction if trials else e.forward.data - e.residual
    chances = trials.chances if trials else chances_of(test, e.catalogue, {})
    rows = np.flatnonzero(scatter.layout.fitted)
    whole, seen = scatter.only(rows).likelihood(prior), (e.forward.data[rows], e.forward.motion[rows])
    left = [unexplained(test, whole, seen[0] - r.prediction[rows], seen[1]) for _, r, _ in best]
    usual = np.diag(scatter.expected(prior) + scatter.noise)
    named = [_named(e, s, r, nats, sound, chances, p, usual) for (s, r, nats), p in zip(best, left, strict=True)]
    named = sorted(named, key=lambda n: -n.probability)
    named[:1] = [_judged_again(one, e, test, config, tell) for one in named[:1]]
    confirmed = bool(named) and shortcoming(named[0], config) is None
    verdict = "unfounded" if not found.founded else "adequate" if not alarm else "named" if confirmed else "unknown"
    change = named[0].refit.prediction - sound if verdict == "named" else np.zeros(len(e.residual))
    first, below = next((s for s, r, _ in best if named and r is named[0].refit), None), _sunk(e)
    return Answer(
        verdict,
        test,
        prior,
        tuple(named),
        chances,
        _parallel(whole, rows, first, e.catalogue, _refuted(named, config), config) if first else (),
        tuple(detectable(scatter, prior, test, e.catalogue, config.level)),
        budget_of(e, prior, sound, change),
        e.forward.cost.runs,
        e.forward.cost.seconds,
        _wandering(e),
        below,
        _rather(e) if max(below, default=0.0) > 0 else 0.0,
    )


def _wandering(evidence: Evidence) -> tuple[Wander, ...]:
    forward = evidence.forward
    kind = forward.simulators[0].scene.body.kind
    return () if forward.blocks[0].is_single else tuple(wander(forward.recordings[r], kind) for r in forward.asked)


def _sunk(evidence: Evidence) -> tuple[float, ...]:
    """Of recordings that are compared, the ground is the same."""
    forward = evidence.forward
    return () if forward.contrast is not None else tuple(sunk(forward.recordings[r].observed()) for r in forward.asked)


def _rather(evidence: Evidence) -> float:
    return cameras_rather([evidence.forward.recordings[r].observed() for r in evidence.forward.asked])


def tested(evidence: Evidence, config: DiagnosisConfig) -> Tested:
    """Whether a sound twin explains the recordings."""
    e = evidence
    prior = chosen(e.scatter, config, e.noisy)
    usual = e.forward.contrast is None and not e.from_recordings  # as controls were
    kind, marked = e.forward.simulators[0].scene.body.kind, e.forward.blocks[0].is_single
    controls = Controls.of(kind, config, marked=marked, recordings=len(e.forward.simulators)) if usual else None
    founded = Controls.known(kind, marked=marked) or e.from_recordings or e.forward.contrast is not None  # members alone are no null
    hands = _hands(e, config)
    farther = float(np.log(config.motion / config.floor))
    about: dict = dict(controls=controls, hands=hands, farther=farther)
    test = significance(e.scatter, prior, e.residual, e.noisy, e.catalogue, e.forward.motion, **about)
    return Tested(prior, test, founded)


def _hands(evidence: Evidence, config: DiagnosisConfig) -> dict[str, float]:
    """What hands tell, by the name of its statistic; nothing of markers, nor of recordings that are compared.

    Of several recordings means: the most of many hands would lie farther out than that of controls, which are single recordings, and a law
    that is missing acts in all of them.
    """
    forward = evidence.forward
    if forward.blocks[0].is_single or forward.contrast is not None:
        return {}
    strays = [stray_of(forward.recordings[r].observed(), 1e-3 * config.floor) for r in forward.asked]
    known = [one for one in strays if one is not None]
    told = {"grip": forward.narrowed(), "stray": float(np.mean(known)) if known else None}
    return {name: value for name, value in told.items() if value is not None}


def _named(e: Evidence, signature: Signature, refit: Refit, nats: float, sound, chances, left: float, usual: np.ndarray) -> Named:
    """``nats`` over the sound twin, which predicts ``sound`` (B,) m; ``usual`` (B,) m^2: variances of what sound twins are off by."""
    candidate, layout = refit.candidate or signature.candidate, e.scatter.layout
    away = np.flatnonzero(~layout.fitted)
    data = e.forward.data
    cells = np.unique(np.c_[layout.record, layout.place], axis=0, return_inverse=True)[1].ravel()
    gain = gained(data[away], sound[away], refit.prediction[away], cells[away], usual[away])
    names = [a.name for a in candidate.effect.amounts]
    amounts, sds = (dict(zip(names, map(float, values), strict=True)) for values in (refit.amounts, refit.sd))
    place = None if candidate.place is None else tuple(candidate.place.tolist())
    return Named(candidate, signature.name, candidate.words, chances[signature.name], nats, amounts, sds, place, gain, left, refit)


def shortcoming(one: Named, config: DiagnosisConfig) -> str | None:
    """Why a refit is not believed, if it is not: what it leaves, that nothing is about as likely, or that it does not gain on frames that
    nobody fitted, where there are any."""
    if one.left < config.level:
        return "leaves more unexplained than sound twins do"
    if one.log_evidence <= config.clearly:
        return "is not much likelier than that nothing is missing"
    return "does not hold on the held-out frames" if one.gain.share <= 0 else None


def withdrawn(answer: Answer, evidence: Evidence) -> Answer:
    """``answer`` without its name, of which the twin that is fitted on with it leaves more than the sound one."""
    first, reference = replace(answer.named[0], left=0.0), evidence.reference
    unexplained = budget_of(evidence, answer.prior, reference, np.zeros(len(reference)))
    return replace(answer, verdict="unknown", named=(first, *answer.named[1:]), budget=unexplained)


def budget_of(evidence: Evidence, prior: Prior, sound, change) -> tuple[Budget, ...]:
    """Of a sound twin that predicts ``sound`` (B,) m, and ``change`` (B,) m, what that of a name predicts otherwise, or zeros."""
    e = evidence
    return tuple(budget(e.scatter, prior, e.forward.data - sound, e.posterior, change, e.forward.missed))


def _judged_again(one: Named, evidence: Evidence, test: Significance, config: DiagnosisConfig, tell: Callable[[str], object]) -> Named:
    """By twins that have it, where it would be believed but for what it leaves."""
    if one.left >= config.level or shortcoming(replace(one, left=1.0), config):
        return one
    p = left_having(evidence, test, one.refit, config)
    if p is None:
        return one
    tell(f"{one.name} leaves as much as sound twins with p {one.left:.3g}, as twins that have it with p {p:.3g}")
    return replace(one, left=max(one.left, p))


def _refuted(named: Sequence[Named], config: DiagnosisConfig) -> set[str]:
    """Names whose refits are far less likely than the first: what a little of two effects does may be alike, and much of them is not."""
    return {one.name for one in named[1:] if one.log_evidence < named[0].log_evidence - config.clearly}


def _parallel(likelihood, rows, first: Signature, catalogue, refuted: Container[str], config: DiagnosisConfig) -> tuple[str, ...]:
    """Names of other effects, not ``refuted``, in whose whitened span, or in the span of which, the first one's signature nearly lies."""
    from scipy.linalg import subspace_angles

    own = likelihood.whitened(fitted_rows(first, rows).columns)
    found = []
    for one in catalogue:
        if one.name != first.name and one.name not in refuted:
            least = np.cos(subspace_angles(own, likelihood.whitened(fitted_rows(one, rows).columns)))[0]
            found += [one.name] * bool(least > config.parallel)
    return tuple(dict.fromkeys(found))
