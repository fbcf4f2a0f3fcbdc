"""Recordings and their fitted sound twin to a verdict: the phases of the inference."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Scenario
from ...methods.continuum.twin import ContinuumTwin
from ..config import DiagnosisConfig
from ..effects import Candidate
from ..ground import sunk
from .absorption import absorb
from .budget import Budget, Detectable, budget, detectable
from .controls import Controls
from .covariance import Prior, Scatter, chosen
from .forward import Forward
from .members import Member, drawn, ran
from .refit import Gain, Refit, Start, begun, gained, refitted
from .scan import Score, Signature, signatures, usual_errors
from .search import Asked
from .significance import Significance, fitted_rows, significance, unexplained
from .wander import Wander, wander

__all__ = ["Answer", "Evidence", "Named", "Tested", "gathered", "infer", "shortcoming", "tested", "weighed"]

WORSE = 15.0  # nats by which the linear evidence of a second place may be less
MOST = 2  # times ``config.refitted`` candidates that are refitted while one that was not is the likeliest


@dataclass(frozen=True, eq=False)
class Evidence:
    """What roll-outs said, before anything is decided.

    residual   (B,) m, of the sound twin, absorbed as members are; ``noisy`` (K, B) m: members' residuals as they would have been seen
    posterior  (B, B) m^2, of predictions, by the fit's covariance
    members    K that did not diverge, none where they are sound recordings (``peers``); ``settled`` (K, n): where the reference is that
               was fitted to each, in prior standard deviations
    """

    forward: Forward
    reference: np.ndarray
    slopes: np.ndarray
    scatter: Scatter
    residual: np.ndarray
    noisy: np.ndarray
    posterior: np.ndarray
    catalogue: tuple[Signature, ...]
    members: tuple[Member, ...]
    settled: np.ndarray

    @property
    def from_recordings(self) -> bool:
        """Whether members are sound recordings."""
        return not self.members


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
    """A candidate that was refitted: its ``probability`` among all effects, what it gains on frames that nobody fitted, where it acts, and
    the p that a sound body's twin leaves as much of the fitted frames as it does (``left``): what explains too little is no name."""

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
    recording that is asked, none of markers; ``sunk``: how clearly the body lies below the told ground in each (``ground.sunk``)."""

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


def gathered(
    twin: ContinuumTwin,
    recordings: Sequence[Scenario],
    config: DiagnosisConfig,
    *,
    sound: Iterable[int] = (),
    against: bool = False,
    missing: Mapping[str, np.ndarray | None] | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Evidence:
    """All roll-outs but the refits': the reference and its slopes, members, signatures.

    ``sound`` recordings are known to lack nothing; ``against``: the first is compared with the others, see ``contrast``; effects that
    are known to be ``missing`` are asked alone, see ``signatures``.
    """
    tell = progress or (lambda _: None)
    forward = Forward.of(twin, recordings, config, sound, against=against)
    paths, reference = forward.reference()
    noise, draw = forward.noise(paths)
    slopes = forward.slopes(reference)
    tell(f"slopes of {slopes.shape[1]} unknowns for {len(reference)} block means")
    sound_twins = drawn(forward, config, seed)
    runs = ran(sound_twins, forward, config)
    good = np.flatnonzero(np.isfinite(runs).all(1))
    runs, kept = runs[good], tuple(sound_twins[k] for k in good)
    if len(runs) < 4:
        raise ValueError(f"at least 4 members must not diverge, got {len(runs)} of {config.members} (scenario {recordings[0].name})")
    tell(f"{len(runs)} sound twins")
    layout, random = forward.layout, np.random.default_rng(seed)
    draws = np.array([draw(random) for _ in runs])
    sd = np.where(layout.fitted, np.sqrt(np.diag(noise)), np.inf)
    both = np.concatenate([runs, forward.data[None]])
    left, settled = absorb(both, reference, slopes, sd, forward.at, forward.bounds, rounds=config.rounds)
    heard = np.sqrt(np.diag(noise) + np.mean(left[:-1] ** 2, 0))
    catalogue = signatures(forward, paths, reference, config, left[-1], heard, missing)
    tell(f"signatures of {len(catalogue)} candidates")
    usual = usual_errors([] if against else catalogue, layout.record)  # recordings that are compared share it
    scatter = Scatter(left[:-1], noise, slopes, usual, layout, 0.0 if against else 1e-3 * config.floor)
    posterior = forward.posterior(slopes)
    return Evidence(forward, reference, slopes, scatter, left[-1], left[:-1] + draws, posterior, tuple(catalogue), kept, settled[:-1])


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
    e, scatter, layout = evidence, evidence.scatter, evidence.scatter.layout
    found = found or tested(evidence, config)
    prior, test = found.prior, found.test
    tell(f"p {test.p:.3g} (misfit {test.p_misfit:.3g}, scan {test.p_scan:.3g})")
    rows = np.flatnonzero(layout.fitted)
    fitting = scatter.only(rows).likelihood(prior, parameters=False)
    common = Asked(e.forward.data, e.reference, e.slopes, fitting, rows)
    sound = refitted(e.forward, common, None, config)
    alarm = found.alarms(config)
    likely, tried, chances = _likely(test, e.catalogue, config), {}, _chances(test, e.catalogue, {})
    refits = refits and alarm

    def begin(k: int, forward: Forward) -> Start | None:
        return begun(forward, common, e.catalogue[k], config)

    firsts = [k for k, *_ in likely.values()] if refits else []
    starts = dict(zip(firsts, e.forward.each(begin, firsts), strict=True))
    led = {e.catalogue[k].name: one.log_evidence - sound.log_evidence for k, one in starts.items() if one}
    asked = _in_order(test.scores, led)[: config.refitted] if refits else []
    members = list(zip(scatter.only(rows).left_out(prior, parameters=False), e.noisy[:, rows], strict=True)) if asked else []

    def refit(k: int, forward: Forward) -> Refit:
        start = starts[k] if k in starts else begin(k, forward)
        return refitted(forward, common, e.catalogue[k], config, members, start)

    while asked:
        which = [k for name in asked for k in likely[name]]
        for k, own in zip(which, e.forward.each(refit, which), strict=True):
            name = e.catalogue[k].name
            if name not in tried or own.log_evidence > tried[name][1].log_evidence:
                tried[name] = k, own
        gains = {k: one.log_evidence - sound.log_evidence for k, one in tried.values()}
        chances = _chances(test, e.catalogue, gains)
        likeliest = next(iter(chances))  # where refits were worse than their linear evidence, it may be one that was not refitted
        asked = [likeliest] if likeliest not in tried and len(tried) < MOST * config.refitted else []
    tell(f"{len(tried)} candidates refitted")
    best = [(e.catalogue[k], one) for k, one in tried.values()]
    whole, seen = scatter.only(rows).likelihood(prior), (e.forward.data[rows], e.forward.motion[rows])
    left = [unexplained(test, whole, seen[0] - r.prediction[rows], seen[1]) for _, r in best]
    usual = np.diag(scatter.expected(prior) + scatter.noise)
    named = sorted((_named(e, s, r, sound, chances, p, usual) for (s, r), p in zip(best, left, strict=True)), key=lambda n: -n.probability)
    confirmed = bool(named) and shortcoming(named[0], config) is None
    verdict = "unfounded" if not found.founded else "adequate" if not alarm else "named" if confirmed else "unknown"
    change = named[0].refit.prediction - sound.prediction if verdict == "named" else np.zeros(len(e.residual))
    first = next((s for s, r in best if named and r is named[0].refit), None)
    return Answer(
        verdict,
        test,
        prior,
        tuple(named),
        chances,
        _parallel(whole, rows, first, e.catalogue, _refuted(named, config), config) if first else (),
        tuple(detectable(scatter, prior, test, e.catalogue, config.level)),
        tuple(budget(scatter, prior, e.forward.data - sound.prediction, e.posterior, change)),
        e.forward.cost.runs,
        e.forward.cost.seconds,
        _wandering(e),
        _sunk(e),
    )


def _wandering(evidence: Evidence) -> tuple[Wander, ...]:
    forward = evidence.forward
    kind = forward.simulators[0].scene.body.kind
    return () if forward.blocks[0].is_single else tuple(wander(forward.recordings[r], kind) for r in forward.asked)


def _sunk(evidence: Evidence) -> tuple[float, ...]:
    """Of recordings that are compared, the ground is the same."""
    forward = evidence.forward
    return () if forward.contrast is not None else tuple(sunk(forward.recordings[r].observed()) for r in forward.asked)


def tested(evidence: Evidence, config: DiagnosisConfig) -> Tested:
    """Whether a sound twin explains the recordings."""
    e = evidence
    prior = chosen(e.scatter, config, e.noisy)
    usual = e.forward.contrast is None and not e.from_recordings  # as controls were
    kind, marked = e.forward.simulators[0].scene.body.kind, e.forward.blocks[0].is_single
    controls = Controls.of(kind, config, marked=marked, recordings=len(e.forward.simulators)) if usual else None
    founded = Controls.known(kind, marked=marked) or e.from_recordings or e.forward.contrast is not None  # members alone are no null
    test = significance(e.scatter, prior, e.residual, e.noisy, e.catalogue, e.forward.motion, controls=controls)
    return Tested(prior, test, founded)


def _likely(test: Significance, catalogue, config: DiagnosisConfig) -> dict[str, list[int]]:
    """By effect, the likeliest first, the index of its likeliest candidate by linear evidence; of places that explain as much, one where
    less of it does. Where it has a place, the likeliest elsewhere is a second one, since a little of an effect may not be told by what
    much of it does: a weight on the tip of a beam bends it as ten times as much does beside the clamp, and swings otherwise."""
    found: dict[str, list[int]] = {}
    likely = [s.log_evidence for s in test.scores]
    usual = np.array([logs - _unusual(s, one) for logs, s, one in zip(likely, test.scores, catalogue, strict=True)])
    for name in dict.fromkeys(catalogue[k].name for k in np.argsort(-np.array(likely), kind="stable")):
        own = sorted((k for k, one in enumerate(catalogue) if one.name == name), key=lambda k: -usual[k])
        elsewhere = [k for k in own[1:] if usual[k] > usual[own[0]] - WORSE and _apart(catalogue[k], catalogue[own[0]]) > config.astray]
        found[name] = [own[0], *elsewhere[:1]]
    return found


def _in_order(scores: Sequence[Score], led: Mapping[str, float]) -> list[str]:
    """Names of effects, the likeliest first: by the better of linear evidence, of any candidate, and that of the best start (``led``)."""
    best = dict(led)
    for one in scores:
        best[one.name] = max(best.get(one.name, -np.inf), one.log_evidence)
    return sorted(best, key=lambda name: -best[name])


def _apart(one: Signature, other: Signature) -> float:
    """Half of the way between the places of two candidates on the body [mm], as far as the refits of both may go to meet; 0 without."""
    places = [s.candidate.place for s in (one, other)]
    if one.candidate.effect.roaming or places[0] is None or places[1] is None:
        return 0.0
    return 500 * float(np.linalg.norm(places[0] - places[1]))


def _unusual(score, signature: Signature) -> float:
    """Nats against an amount above what is noticeable: ten times as much is a standard deviation."""
    amounts = np.abs(np.array(score.sizes) * signature.unit)
    over = [np.log10(max(a / u.first, 1.0)) for a, u in zip(amounts, signature.candidate.effect.amounts, strict=True)]
    return float(np.sum(np.square(over)) / 2)


def _chances(test: Significance, catalogue, refits: Mapping[int, float]) -> dict[str, float]:
    """By effect, the likeliest first: all are alike before, and so are the candidates of one.

    refits  evidence of refits by the index of their candidates. What a refit corrects, it corrects in all candidates of an effect: linear
    evidence of those that were not refitted may be tens of nats too good.
    """
    from scipy.special import logsumexp

    shift = {catalogue[k].name: evidence - test.scores[k].log_evidence for k, evidence in refits.items()}
    logs: dict[str, list[float]] = {}
    for signature, one in zip(catalogue, test.scores, strict=True):
        logs.setdefault(signature.name, []).append(one.log_evidence + shift.get(signature.name, 0.0))
    names = list(logs)
    means = np.array([logsumexp(v) - np.log(len(v)) for v in logs.values()])
    shares = np.exp(means - logsumexp(means)) if len(means) else means
    return {names[k]: float(shares[k]) for k in np.argsort(-means, kind="stable")}


def _named(e: Evidence, signature: Signature, refit: Refit, sound: Refit, chances, left: float, usual: np.ndarray) -> Named:
    """``usual`` (B,) m^2: variances of what sound twins are off by."""
    candidate, layout = refit.candidate or signature.candidate, e.scatter.layout
    away = np.flatnonzero(~layout.fitted)
    data = e.forward.data
    cells = np.unique(np.c_[layout.record, layout.place], axis=0, return_inverse=True)[1].ravel()
    gain = gained(data[away], sound.prediction[away], refit.prediction[away], cells[away], usual[away])
    names = [a.name for a in candidate.effect.amounts]
    amounts, sds = (dict(zip(names, map(float, values), strict=True)) for values in (refit.amounts, refit.sd))
    place = None if candidate.place is None else tuple(candidate.place.tolist())
    evidence = refit.log_evidence - sound.log_evidence
    return Named(candidate, signature.name, candidate.words, chances[signature.name], evidence, amounts, sds, place, gain, left, refit)


def shortcoming(one: Named, config: DiagnosisConfig) -> str | None:
    """Why a refit is not believed, if it is not: what it leaves, that nothing is about as likely, or that it does not gain on frames that
    nobody fitted, where there are any."""
    if one.left < config.level:
        return "leaves more unexplained than sound twins do"
    if one.log_evidence <= config.clearly:
        return "is not much likelier than that nothing is missing"
    return "does not hold on the held-out frames" if one.gain.share <= 0 else None


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
