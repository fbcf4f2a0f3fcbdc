"""From evidence to a decision: which reading is likely, what may be said of it, and when nothing may be said."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import resources
from itertools import combinations

import numpy as np

from .balance import TURNS
from .fit import floor_of
from .ground import sunk
from .hands import held_points
from .inquiry import Inquiry, Refit
from .turn import cameras_rather

__all__ = ["MEASUREMENT", "Calibration", "Decision", "Reading", "alike", "calibration", "decide", "readings"]

MEASUREMENT = ("controller_delay", "camera_pose", "track_drift", "grip_points")
MATERIAL = (
    *("strain_stiffening", "compression_softening", "anisotropy", "bending", "bending_damping", "torsion", "viscoelastic"),
    *("creep", "internal_friction", "rest_shape", "pressure"),
)
# Where a twin of the same body was adequate on other recordings (priors, not fitted): log odds of an effect of its material, which a
# recording cannot add to it; and how many times more a gain tells, of a free run as much as of any, as the twin's own inadequacy is known
# to be small.
SETTLED, SHARPER = -20.0, 6.0
SLID = 1.0  # log of the growth of neighbour distances that deformation alone brings, creases too
LATE, TOLD = 1.0, 0.2  # frames of lag, and log of what it takes off the strays beside a hand, that bending near a hand alone brings
FINE, AT_EASE = 1.0, 5.0  # log of the mean square error over what a twin is asked for, below which there is nothing to explain; log odds
TOLD_APART = 2.2  # nats, by which cameras are likelier to be wrong than the ground: nine times
ASIDE = 1.0  # distances between nodes that the free run of such a twin may be off by
ASTRAY = 3.0  # times the error of its free run where it was fitted: beyond that a twin is no longer the one that was adequate there
ALIKE = 0.95  # cosine of two effects' unabsorbed directions from which on a recording can hardly tell them apart
RIVAL = 0.25  # of the likelier one's probability that the other must have for both to be said
SURE = 0.5  # probability of "adequate" that is asked of a kind of body that the calibration never met
NONE, OTHER = "adequate", "unknown"
SHOWS = ("shows_train", "shows_unseen")  # told beside what the same term shows where nothing is missing
GAINS = ("train", "heldout", "transfer", "free_heldout", "free_transfer")
FEATURES = (*GAINS, "rival", "kept", "extra", *SHOWS, *TURNS)
STRANGE = (-3.0, 8.0)  # standard deviations of what a term shows where nothing is missing, beyond which none says more
SEEN = ("track_drift_seen", "controller_delay_seen", "ground_pose_seen", "camera_pose_seen")  # without a simulation
KINDS = ("chain", "sheet", "solid")
USUAL = ("learned", "best", "misfit", "unforeseen", "free")  # told beside what is usual of a kind of body where nothing is missing
CONTEXT = ("chain", "sheet", *(f"{name}_{kind}" for name in USUAL for kind in KINDS), *TURNS)


@dataclass(frozen=True)
class Reading:
    """One way to read the recordings, as numbers that a decision weighs.

    effect, term  the effect's name and the term that stands for it ("" where the tracks themselves speak)
    features      by name: logs of the shares of error that are left, negated (0: no gain), and what they cost
    """

    effect: str
    term: str
    features: dict[str, float] = field(default_factory=dict)

    @property
    def key(self) -> str:
        return self.term or f"{self.effect}_seen"


@dataclass(frozen=True)
class Calibration:
    """Weights of the decision, fitted on recordings whose effect is known.

    weights   of ``FEATURES``, the same for all effects
    biases    by term: how readily it explains what is not it; those of "adequate" and "unknown" too
    context   by "adequate" and "unknown", weights of ``CONTEXT``
    named     least probability of a name; ``both`` of the two best together
    sure      by kind of body, least probability of "adequate": of a body that folds as it pleases little is known even if it is sound
    source    what it was fitted on
    null      by term, and by "" for a term that it never met: mean and standard deviation of ``SHOWS`` where nothing is missing
    usual     by kind of body, and by "" for all, the same of ``USUAL``: how well twins of it do when they lack nothing
    """

    weights: dict[str, float]
    biases: dict[str, float]
    context: dict[str, dict[str, float]]
    named: float = 0.5
    both: float = 0.7
    sure: dict[str, float] = field(default_factory=dict)
    source: str = ""
    null: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    usual: dict[str, dict[str, list[float]]] = field(default_factory=dict)

    def to_json(self) -> str:
        return json.dumps(asdict(self), indent=1)

    def told(self, reading: Reading) -> dict[str, float]:
        """Its features as the weights take them: what it shows in standard deviations from what its term shows where nothing is missing.

        A twin that was fitted elsewhere has other chances to show something; there that says nothing.
        """
        null = self.null.get(reading.key, self.null.get("", {}))
        out = dict(reading.features)
        for name in SHOWS:
            mean, deviation = null.get(name, (0.0, 0.0))
            usable = reading.term and deviation > 0 and name in out and "settled" not in out
            out[name] = float(np.clip((out[name] - mean) / deviation, *STRANGE)) if usable else 0.0
        return out

    def surroundings(self, around: Mapping[str, float]) -> dict[str, float]:
        """The context as the weights take it: ``USUAL`` in standard deviations from what is usual of its kind of body, whose weights are
        its own. A twin of a sound stuffed body is hardly ever off, that of a cloth often is.
        """
        kind = kind_of(around)
        usual = self.usual.get(kind, self.usual.get("", {}))
        out = {k: v for k, v in around.items() if k not in USUAL}
        for name in USUAL:
            mean, deviation = usual.get(name, (0.0, 1.0))
            out[f"{name}_{kind}"] = float(np.clip((around.get(name, mean) - mean) / deviation, *STRANGE))
        return out


@dataclass(frozen=True)
class Decision:
    """verdict; effect named, or None; alternatives to it, best first; probabilities by effect ("adequate" and "unknown" among them);
    the reading chosen, or None where no effect is named.
    """

    verdict: str
    effect: str | None
    alternatives: tuple[str, ...]
    probabilities: dict[str, float]
    chosen: Reading | None


def calibration() -> Calibration:
    """The calibration that ships with twinbench."""
    return Calibration(**json.loads(resources.files(str(__package__)).joinpath("calibration.json").read_text()))


def left(gain: float) -> float:
    """-log of the share of error that is left: 0 where nothing was gained, 0.7 where half is gone; between -0.5 and 4."""
    return float(-np.log(np.clip(1 - gain, np.exp(-4.0), np.exp(0.5)))) if np.isfinite(gain) else -0.5


def readings(inquiry: Inquiry) -> list[Reading]:
    """Every refitted hypothesis, and what the tracks say by themselves."""
    found, turns = [], turning(inquiry)
    for refit in inquiry.refits:
        found.append(Reading(refit.score.hypothesis.effect, refit.score.hypothesis.term.name, _features(refit, inquiry.transferred)))
    if len(inquiry.simulators) > 1 + inquiry.transfers:  # the twin comes from other recordings of the body
        for reading in found:
            reading.features["settled"] = float(reading.effect in MATERIAL)
    best = {r.term: r.features for r in found}
    for reading in found:
        reading.features.update({name: turns[name] if reading.effect in effects else 0.0 for name, effects in TURNS.items()})
        rivals = [_worth(f) for term, f in best.items() if term != reading.term]
        reading.features["rival"] = max(0.0, max(rivals, default=0.0))
    return found + _tracks(inquiry)


def turning(inquiry: Inquiry) -> dict[str, float]:
    """What a balance of torques says of a body that hangs from hands, where one can be drawn up: whether the air brakes it more than is
    usual, and how strongly a steady level force pulls it aside.
    """
    found = inquiry.balance
    return dict.fromkeys(TURNS, 0.0) if found is None else {name: float(np.clip(getattr(found, name), *STRANGE)) for name in TURNS}


def _features(refit: Refit, transfer):
    mean = np.mean
    h = refit.score.hypothesis
    return {
        "train": left(refit.gain("train")),
        "heldout": left(refit.gain("heldout", "foreseen")),
        "transfer": float(mean([left(refit.gain(t, "foreseen")) for t in transfer])) if transfer else 0.0,
        "free_heldout": left(refit.gain("heldout", "free")),
        "free_transfer": float(mean([left(refit.gain(t, "free")) for t in transfer])) if transfer else 0.0,
        "kept": float(np.log(max(refit.score.kept, 1e-3))),
        "extra": float(len(h.knobs)),
        "shows_train": squeezed(refit.score.shows["train"]),
        "shows_unseen": float(mean([squeezed(refit.score.shows[part]) for part in ("heldout", *transfer)])),
    }


def squeezed(size: float) -> float:
    """log(1 + |size|) with its sign: from linear for small to logarithmic for large ones."""
    return float(np.copysign(np.log1p(abs(size)), size))


def _worth(features: Mapping[str, float]) -> float:
    """One number for how well a reading explains: what any weighing of its gains would start from."""
    return 0.4 * features["train"] + 0.3 * features["heldout"] + 0.3 * features["transfer"]


def shown(reading: Reading) -> float:
    """How much a reading has to show for itself: its ``_worth``, or what is seen without a simulation."""
    return max(_worth(reading.features), *(reading.features.get(name, 0.0) for name in SEEN))


def _tracks(inquiry: Inquiry) -> list[Reading]:
    """Faults that show in tracks and hands without any simulation."""
    recordings = [s.replica for s in inquiry.simulators[: 1 + inquiry.transfers]]
    hands = [held for replica in recordings for held in held_points(replica.recording)]
    deep = max(sunk(replica.recording) for replica in recordings)
    shown = {
        "track_drift": max(replica.sightings.slide for replica in recordings) - SLID,
        "controller_delay": max((held.told - TOLD for held in hands if abs(held.lag) >= LATE), default=0.0),
        "ground_pose": deep,
        "camera_pose": deep,  # all that cameras see is lower than it is
    }
    found = [
        Reading(effect, "", dict.fromkeys(FEATURES, 0.0) | {f"{effect}_seen": max(0.0, float(size))}) for effect, size in shown.items()
    ]
    if deep > 0:  # the ground or cameras must be wrong, and what hands hold tells which
        found[-1].features["rather"] = cameras_rather([replica.recording for replica in recordings])
    return found


def context(inquiry: Inquiry, found: Sequence[Reading]) -> dict[str, float]:
    """What speaks for nothing or for something else: gains of a nameless force field and of the best reading, logs of errors over the
    distance between nodes, and the kind of body.
    """
    others = [part for part in inquiry.parts if part.name != "train"]
    assert inquiry.yardstick is not None  # a whole inquiry has it
    gains = [left(inquiry.yardstick.gain(part.name, "foreseen")) for part in others]
    best = max([_worth(r.features) for r in found if r.term], default=0.0)
    asked = {p.name: floor_of(inquiry.simulators[p.index].replica, inquiry.finest) for p in inquiry.parts}
    excess = [np.log(inquiry.base.observed[name] / size) for name, size in asked.items()]
    astray = inquiry.astray is not None and max(inquiry.base.free.values()) > ASTRAY * inquiry.astray
    width = 3 * inquiry.case.spacing**2
    unforeseen = np.mean([np.log(inquiry.base.foreseen[p.name] / width) / 2 for p in others])
    misfit = np.log(inquiry.base.observed["train"] / width) / 2
    free = np.array([inquiry.base.free[p.name] for p in others]) / inquiry.case.spacing
    known = np.log(free[np.isfinite(free) & (free > 0)])  # a twin that blew up says nothing
    chain = bool(inquiry.case.system.chains)
    sheet = not chain and not len(inquiry.case.recording.interior)
    around = {"learned": np.mean(gains), "best": best, "misfit": misfit, "unforeseen": unforeseen, **turning(inquiry)}
    around |= {"free": np.mean(known)} if known.size else {}
    fine = max(excess) < FINE and not astray and bool(np.all(free < ASIDE))
    flags = {"chain": chain, "sheet": sheet, "fine": fine, "astray": astray}
    return {k: float(v) for k, v in {**around, **flags}.items()}


def kind_of(around: Mapping[str, float]) -> str:
    """Chain, sheet or solid."""
    return next((kind for kind in KINDS[:2] if around.get(kind)), KINDS[2])


def scores(found: Sequence[Reading], around: Mapping[str, float], c: Calibration) -> tuple[list[str], np.ndarray]:
    """Names and scores (log odds) of the readings, then of "adequate" and "unknown"."""
    names, values = [], []
    around = c.surroundings(around)
    # a term that the calibration never met is as doubtful as the most doubtful of those it did
    doubt = min((0.0, *(b for key, b in c.biases.items() if key not in (NONE, OTHER))))
    settled = c.weights | dict.fromkeys(GAINS, SHARPER * float(np.mean([c.weights.get(k, 0.0) for k in GAINS])))
    for reading in found:
        names.append(reading.effect)
        weights = settled if "settled" in reading.features else c.weights
        value = c.biases.get(reading.key, doubt) + sum(weights.get(k, 0.0) * v for k, v in c.told(reading).items())
        value += SETTLED * reading.features.get("settled", 0.0) + reading.features.get("rather", 0.0)
        values.append(value)
    for name in (NONE, OTHER):
        names.append(name)
        values.append(c.biases.get(name, 0.0) + sum(c.context.get(name, {}).get(k, 0.0) * v for k, v in around.items()))
    values[-2] += AT_EASE * (around.get("fine", 0.0) - around.get("astray", 0.0))
    return names, np.array(values)


def alike(inquiry: Inquiry, found: Sequence[Reading]) -> list[tuple[str, str]]:
    """Pairs of effects that do the same to the fitted frames, in so far as no turn of the twin's own numbers does it.

    A ground that is lower than it is told is one with cameras that see everything lower, unless what hands hold tells which it is.
    """
    best, pairs = inquiry.best().values(), set[tuple[str, str]]()
    if sum(one.features.get("rather", 0.0) for one in found) < TOLD_APART:
        pairs.add(("camera_pose", "ground_pose"))
    for one, other in combinations(best, 2):
        if abs(float(one.direction @ other.direction)) > ALIKE and one.hypothesis.effect != other.hypothesis.effect:
            first, second = sorted((one.hypothesis.effect, other.hypothesis.effect))
            pairs.add((first, second))
    return sorted(pairs)


def decide(found: Sequence[Reading], around: Mapping[str, float], c: Calibration, pairs: Sequence[tuple[str, str]] = ()) -> Decision:
    """Weigh the readings: a name where one is likely enough, two where they are together or ``pairs`` has them, else what is honest."""
    names, values = scores(found, around, c)
    weight = np.exp(values - values.max())
    weight /= weight.sum()
    chances: dict[str, float] = {}
    for name, w in zip(names, weight, strict=True):
        chances[name] = chances.get(name, 0.0) + float(w)
    chances = dict(sorted(chances.items(), key=lambda item: -item[1]))
    verdict, effect, also = verdict_of(chances, c, kind_of(around), pairs)
    chosen = None
    if effect:
        mine = [(v, r) for r, v in zip(found, values, strict=False) if r.effect == effect]
        chosen = max(mine, key=lambda pair: (bool(pair[1].term), pair[0]))[1]  # one that has a model, if any
    return Decision(verdict, effect, also, chances, chosen)


def verdict_of(
    chances: Mapping[str, float], c: Calibration, kind: str, pairs: Sequence[tuple[str, str]] = ()
) -> tuple[str, str | None, tuple[str, ...]]:
    """Verdict, effect and alternatives from probabilities, largest first, of a ``kind`` of body; of ``pairs`` of effects neither is named
    without the other.
    """
    effects = [n for n in chances if n not in (NONE, OTHER)]
    first, second = [*effects, None, None][:2]
    nothing, other = chances[NONE], chances[OTHER]
    rivals = second and chances[second] >= RIVAL * chances[first] and any(set(pair) == {first, second} for pair in pairs)
    if rivals and chances[first] + chances[second] >= c.named and chances[first] > max(nothing, other):
        return "ambiguous", first, (second,)
    if first and chances[first] >= c.named:
        return ("measurement" if first in MEASUREMENT else "missing"), first, ()
    if second and chances[first] + chances[second] >= c.both and chances[first] > nothing:
        return "ambiguous", first, (second,)
    if nothing >= c.sure.get(kind, SURE):
        return NONE, None, ()
    if other > nothing or 1 - nothing >= c.both:
        return OTHER, None, tuple(effects[:2])
    return "cannot_tell", None, tuple(effects[:2])
