"""What a continuum twin lacks: from recordings to a sound twin, a verdict, and a twin with what was named."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..datasets.scenario import Observed, Scenario
from ..methods.base import Diverged
from ..methods.continuum import Continuum
from ..methods.continuum.config import Config
from ..methods.continuum.estimate import own_values
from ..methods.continuum.twin import ContinuumTwin
from ..methods.continuum.unknowns import Unknown
from .config import DiagnosisConfig
from .experiment import plannable, planned
from .holding import believed, explains, held
from .inference.blocks import is_marked
from .inference.contrast import comparable, until
from .inference.evidence import Evidence, gathered
from .inference.forward import as_run
from .inference.peers import are_members, compared, there
from .inference.phases import Answer, Named, tested, weighed, withdrawn
from .inference.planning import Plan
from .inference.settling import left, settled
from .motors import ask_joints, is_moved_by_motors
from .outcome import Outcome, verdict_of
from .suitable import suitable
from .swings import Faster, faster, swing_of

__all__ = ["Asked", "ask", "asked", "informed", "leaves_less", "sound_twin", "told_twin"]

LOST = 0.5  # of the motion: a twin that misses more was fitted to nonsense, and what a little of an effect does to it means nothing. Where
# it misses less, effects of the catalogue say what a hand does, and a hand that goes where it likes would explain much that none did

LOST_RUNS = 120  # of a refit of such a twin, at most: a run of it takes seconds, and where it leads says little

LARGER = 1.5  # times as large as usual, cells of a second search

FEW = 3  # recordings: from a fit of so many, in which starts are told apart, that of more begins

Tell = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Asked:
    """The sound twin, what was gathered and answered, and the twin with what was named, or None; the ``tracks`` that it was told of as a
    hand's; how much ``faster`` the recordings swing than sound ones, where they do by themselves."""

    twin: ContinuumTwin
    evidence: Evidence
    answer: Answer
    told: ContinuumTwin | None
    tracks: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    faster: Faster | None = None


def sound_twin(recordings: Sequence[Scenario], config: DiagnosisConfig, *, seed: int = 0, device: str = "cpu") -> ContinuumTwin:
    """The twin that is questioned, fitted jointly to the train frames of ``recordings``.

    It is searched in cells as large as those in which the inference runs it, and not refined in smaller ones, of which it makes no use;
    then it is settled on the means that the inference tests. Where that misses more than ``config.restless`` of the motion, a search in
    larger cells, in which a body that is thrown has fewer ways to go wrong, is settled as well, and the better one is taken. The fit of
    more than ``FEW`` recordings begins where that of the first ones ended.
    """
    observed, made = [one.observed() for one in recordings], _coarse(config, recordings)

    def found(config_of_fit: Config) -> ContinuumTwin:
        options: dict[str, Any] = dict(seed=seed, device=device)
        if config_of_fit.recordings and len(observed) > FEW:
            few = Continuum().fitted(observed[:FEW], config_of_fit, **options)
            options["begin"] = few.values | few.ended
        return settled(Continuum().fitted(observed, config_of_fit, **options), recordings, config)

    twin = found(made)
    if not twin.scene.body.settling or is_marked(recordings[0], config) or (missed := left(twin, recordings, config)) < config.restless:
        return twin
    other = found(replace(made, coarse=LARGER))
    return other if left(other, recordings, config) < missed else twin


def _coarse(config: DiagnosisConfig, recordings: Sequence[Scenario]) -> Config:
    """All recordings are fitted, whose hands have numbers of their own; of markers as many as suit a cable."""
    return Config(coarse=config.cells, refinement=0, recordings=None if is_marked(recordings[0], config) else len(recordings))


def leaves_less(told: ContinuumTwin, twin: ContinuumTwin, recordings: Sequence[Scenario], config: DiagnosisConfig) -> bool:
    """Whether ``told`` misses less of the train frames of ``recordings`` than ``twin``, which has nothing that it has not; no, where it
    diverges there."""
    with suppress(ValueError):
        return left(told, recordings, config) < left(twin, recordings, config)
    return False


def told_twin(twin: ContinuumTwin, observed: Sequence[Observed], named: Named, made: Config, *, seed: int = 0) -> ContinuumTwin:
    """``twin`` of ``observed`` with the effect that was ``named``: all numbers fitted again from there on, its amounts among them."""
    effect, values = named.candidate.effect, named.candidate.values(list(named.amounts.values()))
    free = [] if effect.law else [_free(a, values[a.name]) for a in effect.amounts]
    fixed = {name: value for name, value in values.items() if name not in {u.name for u in free}}
    begin = {f"rec{r}_{name}": value for r in range(len(observed)) for name, value in twin.values.items()}
    begin |= twin.ended | twin.values
    options: dict[str, Any] = dict(extra=(effect.term(),) if effect.term else (), extra_unknowns=free, fixed=fixed, begin=begin, seed=seed)
    return Continuum().fitted(observed, made, device=twin.device, **options)


def _free(amount, value) -> Unknown:
    return Unknown(amount.name, float(np.clip(value, amount.low, amount.high)), amount.low, amount.high, amount.unit)


def asked(
    recordings: Sequence[Scenario],
    config: DiagnosisConfig,
    *,
    fitted_on: Sequence[Scenario] = (),
    against: Sequence[Scenario] = (),
    twin: ContinuumTwin | None = None,
    seed: int = 0,
    device: str = "cpu",
    progress: Tell = lambda said: None,
) -> Asked:
    """All that is found out from train frames (and, as a check on what they named, the frames held out) of ``recordings`` of one object.

    In ``fitted_on`` nothing is missing: all of their frames are fitted with the others', and effects act in the others alone. So it is in
    ``against``, which had the command of the one recording that is asked: how far it differs from them is asked then. Of markers the twin
    is fitted to these alone, and of ``inference.peers.FEWEST`` and more what it misses there tells how far it is off.
    twin: one that was fitted so before, which is not fitted again.
    """
    progress("fitting a sound twin")
    known = [comparable(recordings[0], one) for one in against] or [_whole(one) for one in fitted_on]
    marked = is_marked(recordings[0], config)
    apart = marked and bool(known)  # what markers miss beside sound ones is told by a twin of these alone
    fitted = twin or sound_twin([_whole(one) for one in known] if apart else [*recordings, *known], config, seed=seed, device=device)
    asking = _Asking(fitted, known, config, apart, are_members(recordings[0], fitted_on, config), bool(against), seed, device, progress)
    twin = there(fitted, recordings[0]) if apart else fitted
    evidence = asking.evidence(recordings, twin)
    found, hold = tested(evidence, config), None
    lost = found.test.standardised["left"] > np.log(LOST)
    if found.alarms(config) and lost and len(recordings) == 1 and not against:
        hold = held(recordings[0], evidence, found.prior, asking.again, asking.look, config, progress=progress)
    spent = replace(config, runs=min(config.runs, LOST_RUNS)) if lost else config
    answer = weighed(evidence, spent, found, refits=not (hold and explains(hold, found.test, config)), progress=progress)
    if hold and answer.verdict == "unknown":
        answer = believed(hold, answer, evidence, config)
        if answer.verdict == "named":
            return Asked(twin, evidence, answer, hold.twin, hold.tracks)
    beside, first = bool(fitted_on or against), answer.named[0] if answer.verdict == "named" else None
    told = _with(first, twin, evidence, config, beside=beside, seed=seed, progress=progress) if first else None
    if first and told and not (_as_refitted(first, beside) or leaves_less(told, twin, evidence.forward.recordings, config)):
        progress(f"the twin with {first.name} misses more of the fitted frames than without")
        answer, told = withdrawn(answer, evidence), None
    return Asked(twin, evidence, answer, told, faster=_faster(recordings, known) if asking.peers else None)


def _faster(recordings: Sequence[Scenario], sound: Sequence[Scenario]) -> Faster | None:
    return faster([swing_of(one) for one in recordings], [swing_of(one) for one in sound])


def informed(
    recordings: Sequence[Scenario],
    missing: Mapping[str, np.ndarray | None],
    *,
    transfer: Sequence[Scenario] = (),
    config: DiagnosisConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    progress: Tell = lambda said: None,
) -> Outcome:
    """What ``ask`` returns where it is known which effects are ``missing``, by name with the place (3,) m of frame 0 or None: only how much
    is asked. Of several the one is taken that is likeliest. Of what a twin of such a body cannot have, or what moves nothing here, nothing
    is fitted. Raises ValueError as ``suitable`` does.
    """
    begun, config = time.time(), config or DiagnosisConfig()
    suitable(recordings, transfer, config=config)
    progress("fitting a sound twin")
    twin = sound_twin(recordings, config, seed=seed, device=device)
    evidence = gathered(twin, recordings, config, missing=missing, seed=seed, progress=progress)
    answer = weighed(evidence, config, replace(tested(evidence, config), told=True), progress=progress)
    told = None
    if answer.named:
        answer = replace(answer, verdict="named")
        told = _with(answer.named[0], twin, evidence, config, seed=seed, progress=progress)
    return _outcome(Asked(twin, evidence, answer, told), dict(case=recordings, transfer=transfer), config, begun)


@dataclass(frozen=True, eq=False)
class _Asking:
    """How a recording is asked: beside ``known`` ones, with a ``fitted`` twin of these alone (``apart``), whose errors there are what is
    compared (``peers``)."""

    fitted: ContinuumTwin
    known: Sequence[Scenario]
    config: DiagnosisConfig
    apart: bool
    peers: bool
    against: bool
    seed: int
    device: str
    progress: Tell

    def evidence(self, recordings: Sequence[Scenario], twin: ContinuumTwin) -> Evidence:
        if self.peers:
            return compared(twin, recordings, self.known, self.config, progress=self.progress)
        sound, everything = range(len(recordings), len(recordings) + len(self.known)), [*recordings, *self.known]
        return gathered(twin, everything, self.config, sound=sound, against=self.against, seed=self.seed, progress=self.progress)

    def again(self, one: Scenario) -> tuple[ContinuumTwin, Evidence]:
        """Of another recording in the place of the one that was asked, which may say more of its hands."""
        options: dict[str, Any] = dict(seed=self.seed, device=self.device)
        own = there(self.fitted, one) if self.apart else sound_twin([one, *self.known], self.config, **options)
        return own, self.evidence([one], own)

    def look(self, one: Scenario, numbers: Mapping[str, float] | None) -> list[ContinuumTwin]:
        """Twins of it that cost little: with given ``numbers``, or at the likeliest start of a fit and with those of the fitted twin."""
        if self.apart:
            return [there(self.fitted, one)]
        quick = replace(_coarse(self.config, [one]), iterations=0, members=0)
        options: dict[str, Any] = dict(seed=self.seed, device=self.device)
        begins = (numbers,) if numbers else (None, self.fitted.values)
        return [Continuum().fitted([one.observed()], quick, begin=begin, **options) for begin in begins]


def _whole(recording: Scenario) -> Scenario:
    """All of its frames are fitted."""
    return recording.with_split(recording.frame_count)


def _with(
    named: Named, twin: ContinuumTwin, evidence: Evidence, config: DiagnosisConfig, *, beside: bool = False, seed: int, progress: Tell
) -> ContinuumTwin:
    """``twin`` with what was ``named``; ``beside`` recordings in which nothing is missing."""
    if _as_refitted(named, beside):
        return _refitted_twin(twin, evidence, named)
    progress(f"fitting the twin with {named.words}")
    recordings = evidence.forward.recordings
    found = told_twin(twin, [one.observed() for one in recordings], named, _coarse(config, recordings), seed=seed)
    return settled(found, recordings, config)


def _as_refitted(named: Named, beside: bool) -> bool:
    """Whether the twin with what was named is not fitted again: ``beside`` sound recordings, in which the effect must not act, and of
    faults of what was measured."""
    return beside or named.candidate.effect.seen is not None


def _refitted_twin(twin: ContinuumTwin, evidence: Evidence, named: Named) -> ContinuumTwin:
    """``twin`` at the numbers of the refit: a further fit would let the effect act where nothing is missing as well.

    What was measured wrongly is mended in the twin's own recording alone.
    """
    effect = named.candidate.effect
    values = own_values(evidence.forward.values(named.refit.shift), 0) | named.candidate.values(list(named.amounts.values()))
    extra = (*twin.extra, effect.term()) if effect.term else twin.extra
    scene = effect.seen(twin.scene, values) if effect.seen else twin.scene
    return replace(twin, values=twin.values | values, extra=extra, scene=scene)


def ask(
    recordings: Sequence[Scenario],
    *,
    transfer: Sequence[Scenario] = (),
    fitted_on: Sequence[Scenario] = (),
    against: Sequence[Scenario] = (),
    config: DiagnosisConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    progress: Tell = lambda said: None,
) -> Outcome:
    """Which physics a continuum twin of the object in ``recordings`` lacks, by all of them together.

    ``transfer`` recordings are simulated with the twin as it was and with what was named, and never fitted or chosen by. ``fitted_on`` are
    recordings in which nothing is missing: what ``recordings`` have beyond them is asked. ``against`` are such of the same command: what a
    twin gets wrong in the same way in both is no difference, and how far the one recording differs is asked; of markers that motors move
    joints are compared (``motors``). Beside such, and of markers beside ``inference.peers.FEWEST`` sound recordings and more, the frames
    are asked that all of them have. Raises ValueError for recordings that do not suit (``suitable``, ``inference.contrast.comparable``,
    ``inference.peers.compared``), or both kinds at once.
    """
    begun, config = time.time(), config or DiagnosisConfig()
    if against and (fitted_on or len(recordings) != 1):
        raise ValueError(f"one recording is compared with sound ones, and nothing else fitted; got {len(recordings)} and {len(fitted_on)}")
    if against and is_moved_by_motors(recordings[0], config):
        return ask_joints(recordings[0], against, config, transfer=transfer, progress=progress)
    if beside := against or (fitted_on if recordings and are_members(recordings[0], fitted_on, config) else ()):
        recordings = [until(one, [*recordings, *beside]) for one in recordings]
    suitable(recordings, transfer, fitted_on=fitted_on, against=against, config=config)
    options: dict[str, Any] = dict(fitted_on=fitted_on, against=against, seed=seed, device=device, progress=progress)
    found = asked(recordings, config, **options)
    verdict, names = verdict_of(found.answer, config)
    plan = None
    if plannable(found.evidence, verdict, config):
        progress("looking for a motion that would tell more")
        plan = planned(found.evidence, found.answer, verdict, names, config)
    roles = dict(case=recordings, fitted_on=fitted_on, against=against, transfer=transfer)
    return _outcome(found, roles, config, begun, plan)


def _outcome(
    found: Asked, roles: Mapping[str, Sequence[Scenario]], config: DiagnosisConfig, begun: float, plan: Plan | None = None
) -> Outcome:
    """Of recordings by their roles, those that were asked first; twins run, and are kept, as they were asked."""
    first = found.evidence.forward.recordings[0]
    twin, told = (one and as_run(one, first, config) for one in (found.twin, found.told))
    found = replace(found, twin=twin, told=told)
    parts = [(one, role) for role, group in roles.items() for one in group]
    runs = [[_run(twin, one, first=not k) for twin in (found.twin, found.told)] for k, (one, _) in enumerate(parts)]
    return Outcome.of(found, parts, runs, config, plan=plan, seconds=time.time() - begun)


def _run(twin: ContinuumTwin | None, recording: Scenario, *, first: bool) -> np.ndarray | None:
    """(T, N, 3) m, of tracks; NaN where the twin diverged. In all recordings but the first, its body is laid by what may be seen there."""
    if twin is None:
        return None
    there = twin if first else twin.retarget(recording.initial())
    try:
        return np.asarray(there.rollout(there.controllers if first else recording.controllers).tracked, float)
    except Diverged:
        return np.full(recording.points.shape, np.nan)
