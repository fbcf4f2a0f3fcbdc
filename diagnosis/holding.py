"""A hand, a clamp or a tether that holds the body and that the recording does not list.

Where it goes nobody says, but what it holds was seen. So the hypothesis is a recording: the one that is asked, of which some tracks are
told as a hand's. A twin is fitted to it and tested as any is. What the tracks that are told did, the hypothesis takes from the data: it
counts as if a hand could go anywhere within its reach.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

from ..datasets.scenario import Scenario
from ..methods.base import Diverged
from ..methods.continuum.fitting import AllDiverged
from ..methods.continuum.hands import FINGER, HAND
from ..methods.continuum.twin import ContinuumTwin
from .config import DiagnosisConfig
from .effects import Candidate
from .effects.grips import HOLD
from .inference.blocks import Blocks
from .inference.covariance import Prior
from .inference.evidence import Evidence
from .inference.phases import Answer, Named, budget_of, shortcoming, tested
from .inference.refit import Gain, Refit, gained
from .inference.significance import Significance

__all__ = ["Hold", "Place", "believed", "explains", "held", "listed", "places"]

TRIED = 3  # places, at most, that twins are fitted to in full
MOST = 10.0  # m: what misses by more did not run
ENOUGH = 2  # places that leave nothing to explain: beside the first one, another may be likelier
NEAR = 2.0  # times the least miss of a first look, beyond which a place is not tried
ALWAYS = 0.5  # of the train frames, in which a track must be seen to be told as a hand's
CLEARLY = 15.0  # nats: e^15 is three million
FAILS = ValueError, AllDiverged, Diverged  # of a body that cannot be held so, or of which no twin runs

Question = Callable[[Scenario], tuple[ContinuumTwin, Evidence]]
Look = Callable[[Scenario, Mapping[str, float] | None], Sequence[ContinuumTwin]]


@dataclass(frozen=True, eq=False)
class Place:
    """``tracks`` (k,) that would be the hand's, and the ``labels`` of the regions of block means that they are in."""

    tracks: np.ndarray
    labels: np.ndarray


@dataclass(frozen=True, eq=False)
class Hold:
    """The likeliest place, the twin of the recording in which it is told, and how it is judged.

    centre      (3,) m of its tracks in frame 0
    nats        logarithm by which the fitted block means are likelier than beside the sound twin
    gain        on block means that were not fitted, of other tracks than those that are told
    prediction  (B,) m of the block means of the recording that is asked
    """

    tracks: np.ndarray
    centre: np.ndarray
    twin: ContinuumTwin
    test: Significance
    nats: float
    gain: Gain
    prediction: np.ndarray


def places(recording: Scenario, blocks: Blocks, config: DiagnosisConfig) -> list[Place]:
    """Where a hand that is not listed may hold: two neighbouring markers, which tell how it turns, or the tracks of a region within a
    finger's width of its middle. None where a hand is listed."""
    seen = recording.visible[: recording.split.train_end].mean(0) >= ALWAYS
    seen &= recording.visible[0]
    seen[recording.grips[recording.grips >= 0]] = False
    points = recording.points[0]
    if blocks.is_single:
        return [Place(pair, pair) for pair in _neighbours(points, np.flatnonzero(seen))]
    found = []
    for label, middle in enumerate(blocks.regions):
        far = np.linalg.norm(points - middle, axis=1)
        own = np.flatnonzero(seen & (blocks.label == label) & (far < FINGER))
        apart = np.linalg.norm(recording.controllers[0] - middle, axis=1).min(initial=np.inf)
        if len(own) >= config.fewest and apart > HAND:
            found.append(Place(own, np.array([label])))
    return found


def _neighbours(points, free) -> list[np.ndarray]:
    """Pairs (2,) of ``free`` markers that are joined by the shortest tree through them."""
    from scipy.sparse.csgraph import minimum_spanning_tree
    from scipy.spatial.distance import pdist, squareform

    if len(free) < 2:
        return []
    pairs = np.argwhere(minimum_spanning_tree(squareform(pdist(points[free]))).toarray() > 0)
    return [np.sort(free[pair]) for pair in pairs]


def listed(recording: Scenario, place: Place, *, markers: bool) -> Scenario:
    """The recording in which the tracks of ``place`` are a hand's, or driven ``markers``; between frames in which one is seen it goes
    straight."""
    tracks, frames = place.tracks, np.arange(recording.frame_count)
    path = np.stack([_between(frames, recording.points[:, n], recording.visible[:, n]) for n in tracks], 1)
    grips = tracks if markers else np.full(len(tracks), -1)
    return replace(recording, controllers=np.concatenate([recording.controllers, path], 1), grips=np.concatenate([recording.grips, grips]))


def _between(frames, path, seen):
    known = frames[seen]
    return np.stack([np.interp(frames, known, path[seen, axis]) for axis in range(3)], 1)


def held(
    recording: Scenario,
    evidence: Evidence,
    prior: Prior,
    question: Question,
    look: Look,
    config: DiagnosisConfig,
    *,
    progress: Callable[[str], None] = lambda said: None,
) -> Hold | None:
    """The likeliest place of a hand that is not listed, one that leaves nothing to explain if there is one; None where no twin runs.

    A look at all places says where to begin. Once a place leaves nothing to explain, the numbers of its twin say where to look again.

    question  the twin of a recording, and the evidence of it
    look      twins of it that cost little, with given numbers or such as are likely
    """
    blocks = evidence.forward.blocks[0]
    known = places(recording, blocks, config)
    told = [listed(recording, one, markers=blocks.is_single) for one in known]

    def misses(numbers):
        return np.array([_miss(look, numbers, there, one, blocks) for there, one in zip(told, known, strict=True)])

    found: dict[int, Hold | None] = {}
    ordered, numbers, sufficient = misses(None), None, 0
    while known and len(found) < TRIED and sufficient < ENOUGH:
        if numbers:
            ordered, numbers = misses(numbers), None
        likely = [k for k in np.argsort(ordered, kind="stable") if ordered[k] <= min(NEAR * ordered.min(), MOST)]
        k = next((k for k in likely if k not in found), None)
        if k is None:
            break
        x, y, z = 1e3 * recording.points[0, known[k].tracks].mean(0)
        progress(f"asking a hand at {x:.0f}, {y:.0f}, {z:.0f} mm that the recording does not list")
        found[k] = None
        with suppress(*FAILS):
            twin, own = question(told[k])
            evidence.forward.cost.runs += own.forward.cost.runs
            evidence.forward.cost.seconds += own.forward.cost.seconds
            found[k] = one = _judged(known[k], recording, evidence, prior, twin, own, config)
            if _suffices(one, config):  # its numbers tell better which place it is
                numbers, sufficient = twin.values, sufficient + 1
    return max((one for one in found.values() if one), key=lambda one: (_suffices(one, config), one.nats), default=None)


def _suffices(hold: Hold, config: DiagnosisConfig) -> bool:
    """Whether nothing more is missing beside it, and it is far likelier than the sound twin."""
    return hold.test.p >= config.level and hold.nats > CLEARLY


def _miss(look: Look, numbers: Mapping[str, float] | None, told: Scenario, place: Place, blocks: Blocks) -> float:
    """m, RMS over the train frames of tracks that no hand is told by, of the best twin at a look; infinite where none runs."""
    frames, found = told.split.train_end, [np.inf]
    seen = told.visible[:frames] & ~np.isin(blocks.label, place.labels)
    seen[:, told.grips[told.grips >= 0]] = False
    with suppress(*FAILS):
        for twin in look(told, numbers) if seen.any() else ():
            with suppress(Diverged):
                path = np.asarray(twin.rollout(told.controllers[:frames]).tracked)
                found.append(float(np.sqrt(np.mean(((path - told.points[:frames])[seen] ** 2).sum(1)))))
    return min(found)


def _judged(
    place: Place, recording: Scenario, base: Evidence, prior: Prior, twin: ContinuumTwin, own: Evidence, config: DiagnosisConfig
) -> Hold:
    """The ``twin`` and its ``own`` evidence, of the recording in which ``place`` is told, beside that of the recording as it is."""
    here, there = (np.isin(_labels(one), place.labels) for one in (base, own))
    fitted, data = base.scatter.layout.fitted, base.forward.data
    whole, found = np.flatnonzero(fitted), tested(own, config)
    others = np.flatnonzero(own.scatter.layout.fitted & ~there)
    usual = base.scatter.only(whole).likelihood(prior).log_density(base.residual[whole], guarded=True)
    likelier = own.scatter.only(others).likelihood(found.prior).log_density(own.residual[others], guarded=True)
    anywhere = float(norm.logpdf(base.forward.motion[fitted & here], scale=1e-3 * config.roaming).sum())
    prediction, blocks = base.reference.copy(), base.forward.blocks[0]
    prediction[base.scatter.layout.record == 0] = blocks.means(own.forward.reference()[0][0][None])[0]
    away = ~fitted & ~here & (base.scatter.layout.record == 0)
    gain = gained(data[away], base.reference[away], prediction[away], _labels(base)[away])
    centre = recording.points[0, place.tracks].mean(0)
    return Hold(place.tracks, centre, replace(twin, unlisted=len(place.tracks)), found.test, likelier + anywhere - usual, gain, prediction)


def _labels(evidence: Evidence) -> np.ndarray:
    """(B,) the region of each block mean of the first recording, -1 of others."""
    blocks, layout = evidence.forward.blocks[0], evidence.scatter.layout
    found = np.full(len(layout.record), -1)
    found[layout.record == 0] = np.repeat(blocks.cells % blocks.count, 3)
    return found


def explains(hold: Hold, test: Significance, config: DiagnosisConfig) -> bool:
    """Whether it suffices, and is far likelier than all effects by their linear evidence as well."""
    most = max((one.log_evidence for one in test.scores), default=0.0)
    return _suffices(hold, config) and hold.nats > most + CLEARLY


def believed(hold: Hold, answer: Answer, evidence: Evidence, config: DiagnosisConfig) -> Answer:
    """``answer`` with the hold among what was tried, and named where it is the likeliest and nothing more is missing beside it.

    It is a tether whose other end goes anywhere, and shares the name, and the name's probability, with one that is tied to a place of the
    room. Where that one is likelier, it says the place.
    """
    tied = next((one for one in answer.named if one.name == HOLD.name), None)
    chances = _chances(hold, answer)
    at = tied.place if tied and tied.place and tied.log_evidence > hold.nats else tuple(hold.centre.tolist())
    fixed: Mapping[str, float] = dict(zip(("hold_x", "hold_y", "hold_z"), map(float, at), strict=True))
    candidate, nothing = Candidate(HOLD, fixed), np.zeros(0)
    refit = Refit(candidate, np.zeros(len(evidence.forward.unknowns)), nothing, nothing, hold.prediction, hold.nats)
    own = Named(candidate, HOLD.name, HOLD.says, chances[HOLD.name], hold.nats, {}, {}, at, hold.gain, hold.test.p, refit)
    others = [replace(one, probability=chances[one.name]) for one in answer.named if one.name != HOLD.name]
    named = tuple(sorted([own, *others], key=lambda one: -one.probability))
    answer = replace(answer, named=named, probabilities=chances)
    if next(iter(chances)) != HOLD.name or shortcoming(own, config):
        return answer
    change = hold.prediction - evidence.reference
    return replace(answer, verdict="named", parallel=(), budget=budget_of(evidence, answer.prior, evidence.reference, change))


def _chances(hold: Hold, answer: Answer) -> dict[str, float]:
    """By effect, the likeliest first, the hold being one more candidate of its name. All evidence together is at most that of the likeliest
    over its share."""
    shares = answer.probabilities
    if answer.named:
        whole = answer.named[0].log_evidence - np.log(max(answer.named[0].probability, 1e-300))
    else:
        whole = logsumexp([one.log_evidence for one in answer.test.scores]) if answer.test.scores else 0.0
    logs = {name: whole + np.log(max(share, 1e-300)) for name, share in shares.items()}
    logs[HOLD.name] = np.logaddexp(logs.get(HOLD.name, -np.inf), hold.nats) - np.log(2)
    total = logsumexp(list(logs.values()))
    return {name: float(np.exp(logs[name] - total)) for name in sorted(logs, key=lambda name: -logs[name])}
