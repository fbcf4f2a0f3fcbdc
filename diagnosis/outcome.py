"""What a diagnosis says of recordings and a continuum twin: the content of ``diagnosis.json``, and what the report draws."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import NormalDist

import numpy as np

from ..datasets.scenario import Scenario
from ..datasets.temporary import replacing
from ..methods.continuum.scene import Scene
from ..methods.continuum.sights import jitter
from .config import DiagnosisConfig
from .effects import effects
from .experiment import proposed
from .inference.evidence import Evidence
from .inference.phases import Answer, Named, shortcoming
from .inference.planning import Plan
from .inference.refit import Gain
from .inference.wander import Wander
from .keeping import write_tracks, write_twins
from .motions import figures
from .page.document import plain
from .page.words import effect_name
from .report import write_report

__all__ = ["SCHEMA", "Outcome", "arrays_of", "chance_of_listed", "chance_of_sound", "curves_of", "floor_of", "recordings_of", "verdict_of"]

DRIFT = "track_drift"
BELOW = {"ground_pose": 0.77, "camera_pose": 0.23}  # of a body below the told ground: e^1.2 as often the ground as all cameras alike
RIGHT = 1 / 184  # probability that it is told rightly all the same: of 182 recordings of which it is, no body lies below it
SCHEMA = 2
UNFOUNDED = (
    "How far a sound twin of such a body is off is told by no stored recordings, and by other twins alone it was never told well: "
    "recordings of the same command (--against) would tell it."
)
HALF = 0.5  # of how firmly a hand holds what it holds most firmly: it has fallen to that at the radius of a grip
UNTRIED = Gain(np.nan, np.nan)
READINGS = 0.9  # names are readings until they have this much of the probability together, were one of them true


@dataclass(frozen=True)
class Outcome:
    """result: what ``diagnosis.json`` holds; arrays: what ``write_report`` draws; twins by the names of ``keeping.NAMES``."""

    result: dict
    arrays: dict
    twins: dict = field(default_factory=dict)

    @classmethod
    def of(
        cls, found, parts: Sequence[tuple[Scenario, str]], runs, config: DiagnosisConfig, *, plan: Plan | None = None, seconds: float
    ) -> Outcome:
        """Of an ``Asked``, the recordings and their roles, and of each the tracks (T, N, 3) m of the twin and of the told one, or None;
        and the ``plan`` of what to record next."""
        answer, forward = found.answer, found.evidence.forward
        verdict, names = verdict_of(answer, config)
        first = answer.named[0] if answer.verdict == "named" else None
        lost = _lost(answer, config) if DRIFT in names else None
        here = lost if answer.wandering and lost is answer.wandering[0] else None  # tracks of another recording have other numbers
        floor = float(np.mean([floor_of(one) for one, role in parts if role == "case"]))
        scored = [(_unheld(parts[0][0], found.tracks), parts[0][1]), *parts[1:]]
        result = {
            "schema": SCHEMA,
            "twin": "continuum",
            "verdict": verdict,
            "effect": names[0] if names else None,
            "alternatives": list(names[1:]),
            "probabilities": _probabilities(answer, lost, config),
            "why": _why_open(answer, verdict, config),
            "test": _test(answer, found.evidence, config),
            "where": _where(first, forward.simulators[0].scene) if first else _where_lost(here, parts[0][0]),
            "when": {"frames": [0, parts[0][0].frame_count]} if names else None,
            "parameters": _parameters(first, len(found.evidence.noisy)) | _how_lost(lost),
            "fit": _errors(scored, runs, floor),
            "budget": [asdict(b) | {"recording": parts[b.record][0].name} for b in answer.budget],
            "detectable": _detectable(answer, found.evidence, "amount"),
            "detectable_mm": _detectable(answer, found.evidence, "mm"),
            "experiment": proposed(plan, verdict, names),
            "evidence": {
                "hypotheses": _hypotheses(answer, found.evidence, names, config),
                "noise_floor": floor,
                "notes": _notes(found, answer, config),
                "recordings": recordings_of(parts),
                "curves": curves_of(scored, runs, floor),
                "twin": found.twin.values,
                "told": found.told.values if found.told else None,
                "plan": figures(plan.motion, plan.separation, plan.others, float(parts[0][0].fps)) if plan else None,
                "rollouts": {"count": answer.runs, "seconds": answer.seconds},
            },
            "seconds": round(seconds, 3),
        }
        twins = {name: twin for name, twin in (("baseline", found.twin), ("extended", found.told)) if twin is not None}
        return cls(result, arrays_of(parts, runs), twins)

    def write(self, out: str | Path) -> None:
        """Write ``diagnosis.json``, ``report.html``, ``tracks.npz`` and the folder ``twins`` into the folder ``out``."""
        out = Path(out)
        with replacing(out / "diagnosis.json") as temporary:
            temporary.write_text(json.dumps(plain(self.result), indent=1, allow_nan=False), encoding="utf-8")
        write_report(self.result, self.arrays, out / "report.html")
        write_tracks(self.arrays, out)
        write_twins(self.twins, out)


def verdict_of(answer: Answer, config: DiagnosisConfig) -> tuple[str, tuple[str, ...]]:
    """(one of ``page.words.VERDICTS``, the names that it rests on, best first).

    Where a sound twin explains the fitted frames, the body is adequate only if the frames held out say so as well, and if at least half of
    the effects asked would have been found at ``config.motion`` mm; otherwise nothing can be told. Tracks that wander are a fault of the
    measurement, and whether anything else is missing they do not let be seen unless it has a name. So it is where a body lies below the
    told ground in frame 0: whether the ground or all cameras are wrong then, what hands hold may tell.
    """
    drift, below = (DRIFT,) if _lost(answer, config) else (), tuple(n for n, share in _below(answer).items() if share > 1 - READINGS)
    if _only_lies_below(answer):
        alone = "measurement" if below == ("camera_pose",) else "missing"
        return ("ambiguous" if len((*below, *drift)) > 1 else alone), (*below, *drift)
    if drift and answer.verdict != "named":
        return "measurement", drift
    if answer.verdict == "adequate":
        return ("cannot_tell" if _why_undecided(answer, config) else "adequate"), ()
    if answer.verdict == "unfounded":
        return "cannot_tell", ()
    if answer.verdict == "unknown":
        return "unknown", ()
    first, kinds = answer.named[0], {e.name: e.kind for e in effects()}
    readings, share = [], 0.0
    for name, chance in answer.probabilities.items():
        if share < READINGS:
            readings.append(name)
        share += chance
    others = [n for n in dict.fromkeys([*answer.parallel, *readings, *below, *drift]) if n != first.name]
    if others:
        return "ambiguous", (first.name, *others)
    return ("measurement" if kinds[first.name] == "measurement" else "missing"), (first.name,)


def _lies_below(answer: Answer) -> bool:
    return max(answer.sunk, default=0.0) > 0


def _below(answer: Answer) -> dict[str, float]:
    """Shares of what is wrong where a body lies below the told ground, the larger first; nothing where none does."""
    if not _lies_below(answer):
        return {}
    odds = BELOW | {"camera_pose": BELOW["camera_pose"] * float(np.exp(np.clip(answer.cameras_rather, -50, 50)))}
    shares = {name: one / sum(odds.values()) for name, one in odds.items()}
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def _only_lies_below(answer: Answer) -> bool:
    """Whether that is all that can be said: nothing else has a name."""
    return _lies_below(answer) and answer.verdict != "named"


def _lost(answer: Answer, config: DiagnosisConfig) -> Wander | None:
    """Of the recordings that were asked, the one whose tracks wander the most, if any do; the least of their p has to be paid for."""
    worst = min(answer.wandering, key=lambda one: one.p, default=None)
    return worst if worst and len(answer.wandering) * worst.p < config.wandering else None


def _where_lost(lost: Wander | None, recording: Scenario) -> dict | None:
    """The tracks that wander, where they are in frame 0."""
    if lost is None or not len(lost.tracks):
        return None
    places = recording.points[0, lost.tracks]
    centroid = places.mean(0)
    radius = float(np.linalg.norm(places - centroid, axis=1).max())
    return {"points": lost.tracks.tolist(), "centroid": centroid.tolist(), "radius": radius}


def _how_lost(lost: Wander | None) -> dict:
    if lost is None:
        return {}
    far = float(np.nanmedian(lost.far[lost.tracks])) if len(lost.tracks) else 0.0
    values = {"track_drift": (far, "m"), "track_drift_share": (len(lost.tracks) / len(lost.far), "-")}
    return {name: {"value": value, "unit": unit, "interval90": None} for name, (value, unit) in values.items()}


def _why_undecided(answer: Answer, config: DiagnosisConfig) -> str | None:
    """Why recordings that a sound twin explains do not show that it is one, or None."""
    if answer.verdict == "unfounded":
        return UNFOUNDED
    sizes: dict[str, float] = {}
    for one in answer.detectable:
        sizes[one.name] = min(one.size, sizes.get(one.name, np.inf))
    half = float(np.median(list(sizes.values()))) if sizes else np.inf
    if half > config.motion:
        return f"Half of the effects that were asked would have to move the body by {half:.0f} mm or more to be found here."
    if answer.test.p_held_out < config.level:
        return f"On the frames held out the twin is off by more than sound twins are (p = {answer.test.p_held_out:.2g})."
    return None


def _why_open(answer: Answer, verdict: str, config: DiagnosisConfig) -> str | None:
    """Why nothing can be told, or why what was found has no name, in a sentence; None where neither is asked, or nobody knows."""
    if _only_lies_below(answer):
        return "In frame 0 the body lies below the told ground."
    if verdict == "cannot_tell":
        return _why_undecided(answer, config)
    wrong = shortcoming(answer.named[0], config) if verdict == "unknown" and answer.named else None
    return f"The likeliest of those that were tried, {effect_name(answer.named[0].name)}, {wrong}." if wrong else None


def chance_of_sound(p: float) -> float:
    """The least probability that a p-value leaves a sound twin, at even odds before."""
    return _chance(_least_odds(p))


def chance_of_listed(config: DiagnosisConfig, left: float = 1.0, gain: Gain = UNTRIED) -> float:
    """Probability that what is missing is one of the effects that are asked.

    ``config.listed`` before anything is tried. Where the likeliest was refitted, by the least odds that the p of what it leaves of the
    fitted frames (``Named.left``) leaves it, and by the chance that its ``gain`` on frames that nobody fitted is one (normal, by its
    standard error): what explains a motion for a wrong reason does not explain the next.
    """
    holds = 1.0 if np.isnan(gain.share) else NormalDist().cdf(gain.share / max(gain.error, 1e-9))
    return _chance(config.listed / (1 - config.listed) * _least_odds(left) * holds)


def _least_odds(p: float) -> float:
    """That a p-value leaves what it is of, over those before: -e p ln p, one at most (Sellke et al. 2001)."""
    p = min(max(p, 1e-12), float(np.exp(-1)))
    return float(-np.e * p * np.log(p))


def _chance(odds: float) -> float:
    return odds / (1 + odds)


def _probabilities(answer: Answer, lost: Wander | None, config: DiagnosisConfig) -> dict:
    if _only_lies_below(answer):
        shares = {name: (1 - RIGHT) * share for name, share in _below(answer).items()}
        return {name: round(p, 4) for name, p in ({"adequate": RIGHT} | shares | {"unknown": 0.0}).items()}
    if lost and answer.verdict != "named":
        sound = chance_of_sound(lost.p)
        return {"adequate": round(sound, 4), DRIFT: round(1 - sound, 4), "unknown": 0.0}
    sound = chance_of_sound(answer.test.p)
    first = answer.named[0] if answer.named else None
    listed = (chance_of_listed(config, first.left, first.gain) if first else chance_of_listed(config)) if answer.probabilities else 0.0
    found = {"adequate": sound} | {name: (1 - sound) * listed * share for name, share in answer.probabilities.items()}
    return {name: round(p, 4) for name, p in (found | {"unknown": (1 - sound) * (1 - listed)}).items()}


def _test(answer: Answer, evidence: Evidence, config: DiagnosisConfig) -> dict:
    t = answer.test
    said = {name: getattr(t, name) for name in ("p", "p_members", "p_misfit", "p_scan", "p_held_out")}
    counts = dict(level=config.level, members=len(evidence.noisy), controls=len(t.controls.standardised) if t.controls else 0)
    return said | counts | dict(misfit=t.misfit, standardised=dict(t.standardised), at_hands=t.at_hands)


def _where(first: Named, scene: Scene) -> dict | None:
    """Where on the body, or in the room, it is: the particles of frame 0 within its reach, at least the nearest, or what its hand holds."""
    effect, fixed, structure = first.candidate.effect, first.candidate.fixed, scene.structure
    if effect.hand:
        return _held(scene, int(fixed[effect.hand]))
    if first.place is None:
        return None
    far = np.linalg.norm(structure - np.array(first.place), axis=1)
    reach = float(fixed.get(effect.within, 0.0)) or float(far.min())
    points = np.flatnonzero(far <= max(reach, far.min()))
    centroid = np.array(first.place) if effect.roaming else structure[points].mean(0)
    return {"points": points.tolist(), "centroid": centroid.tolist(), "radius": reach}


def _held(scene: Scene, number: int) -> dict | None:
    """What the hand of that number was told to hold, half as firmly as anything in it, or more; None of all hands together, and of one that
    holds nothing in this recording."""
    hand = scene.hands[number] if 0 <= number < len(scene.hands) else None
    if hand is None or not len(hand.points):
        return None
    points = hand.points[hand.firmness >= HALF * hand.firmness.max()]
    centroid = scene.structure[points].mean(0)
    radius = float(np.linalg.norm(scene.structure[points] - centroid, axis=1).max())
    return {"points": points.tolist(), "centroid": centroid.tolist(), "radius": radius}


def _parameters(first: Named | None, members: int) -> dict:
    """The effect's amounts with 90 % intervals, as of a Student t of so many ``members``, and what it was tried with."""
    if first is None:
        return {}
    from scipy.stats import t

    wide = float(t.ppf(0.95, members))
    found = {}
    for amount in first.candidate.effect.amounts:
        value, sd = first.amounts[amount.name], first.sds[amount.name]
        ends = [float(np.clip(value + s * wide * sd, amount.low, amount.high)) for s in (-1, 1)]
        found[amount.name] = {"value": value, "unit": amount.unit, "interval90": ends}
    units = dict.fromkeys(first.candidate.coordinates, "m")
    units |= {p.name: p.unit for p in first.candidate.effect.parameters.values()}
    return found | {n: {"value": float(v), "unit": units.get(n, "-"), "interval90": None} for n, v in first.candidate.fixed.items()}


def _unheld(recording: Scenario, tracks) -> Scenario:
    """Without what was seen of ``tracks``, by which a hand was told."""
    hidden = {name: getattr(recording, name).copy() for name in ("visible", "motion_valid")}
    for values in hidden.values():
        values[:, tracks] = False
    return replace(recording, **hidden)


def _off(recording: Scenario, path) -> np.ndarray:
    """(T, N) m, of tracks that are seen and not driven; NaN elsewhere."""
    seen = recording.visible.copy()
    seen[:, recording.grips[recording.grips >= 0]] = False
    return np.where(seen, np.linalg.norm(path - recording.points, axis=2), np.nan)


def _mean(values) -> float | None:
    return float(np.nanmean(values)) if np.isfinite(values).any() else None


def _errors(parts, runs, floor) -> dict:
    """Mean errors [m] at tracks by what was fitted, what was held out and what was never fitted; several recordings count alike."""
    found = {}
    for split, role, cut in (
        ("train", "case", lambda one: slice(0, one.split.train_end)),
        ("heldout", "case", lambda one: slice(one.split.train_end, None)),
        ("transfer", "transfer", lambda one: slice(0, None)),
    ):
        means = []
        for (one, own), pair in zip(parts, runs, strict=True):
            if own == role:
                means.append([None if path is None else _mean(_off(one, path)[cut(one)]) for path in pair])
        columns = [[m for m in column if m is not None] for column in zip(*means, strict=True)] if means else [[], []]
        if columns[0]:
            before, after = (float(np.mean(c)) if c else None for c in columns)
            found[split] = {"baseline": before, "extended": after, "noise_floor": floor, "last_residual": None, "learned_residual": None}
    return found


def floor_of(recording: Scenario) -> float:
    """Mean length [m] of the noise vector of a track: sqrt(8 / pi) standard deviations of a coordinate from one frame to the next."""
    return float(np.sqrt(8 / np.pi) * jitter(np.nan_to_num(recording.points), recording.visible))


def _detectable(answer: Answer, evidence: Evidence, unit: str) -> dict:
    """By effect the least size that would have been found, None for one that was not asked: mm of motion, or its first amount's."""
    found: dict[str, float | None] = {e.name: None for e in effects()}
    amounts = {id(s.candidate): float(s.unit[0]) for s in evidence.catalogue}
    for one, signature in zip(answer.detectable, evidence.catalogue, strict=True):
        size = one.size * (amounts[id(signature.candidate)] if unit == "amount" else 1.0)
        found[one.name] = size if (known := found[one.name]) is None else min(size, known)
    return found


def _hypotheses(answer: Answer, evidence: Evidence, names, config: DiagnosisConfig) -> list[dict]:
    """A row for every effect that was asked: what it explains, and what speaks for or against it."""
    full = {n.name: n for n in answer.named}
    shares = {d.name: d.unabsorbed for d in sorted(answer.detectable, key=lambda d: d.unabsorbed)}
    best: dict[str, float] = {}
    for signature, one in zip(evidence.catalogue, answer.test.scores, strict=True):
        best[signature.name] = max(best.get(signature.name, 0.0), one.explains)
    rows = [{"effect": "baseline", "kind": "baseline", "train_gain": 0.0, "heldout_gain": 0.0, "transfer_gain": None}]
    units = {e.name: e.amounts[0].unit for e in effects()}
    for name in sorted(best, key=lambda n: (n not in names, n not in full, -best[n])):
        one = full.get(name)
        rows.append(
            {
                "effect": name,
                "kind": "refitted" if one else "linear estimate",
                "train_gain": best[name],
                "heldout_gain": None if one is None or np.isnan(one.gain.share) else one.gain.share,
                "transfer_gain": None,
                "absorbed": 1 - shares[name],
                "amplitude": None if one is None or not one.amounts else float(np.linalg.norm(list(one.amounts.values()))),
                "unit": units[name],
                "probability": answer.probabilities.get(name) if one else None,
                "why": _why(name, one, names, config),
            }
        )
    return rows


def _why(name: str, one: Named | None, names, config: DiagnosisConfig) -> str:
    if names and name == names[0]:
        return "chosen"
    if name in names:
        return "the recordings cannot tell it from the first"
    if one is None:
        return "others explain more of what sound twins leave"
    return shortcoming(one, config) or "others are likelier"


def _notes(found, answer: Answer, config: DiagnosisConfig) -> list[str]:
    scene, members = found.twin.scene, len(found.evidence.noisy)
    body, cells = scene.body.kind, config.cells_of(scene.body)
    beside = f"{members} recordings in which nothing is missing" if found.evidence.from_recordings else f"{members} sound twins"
    said = [f"The twin that was questioned is a {body}, in {cells:g} times the method's cells, beside {beside}."]
    said.append(f"p = {answer.test.p:.2g} that a sound twin's error looks like this (level {config.level:g}); {answer.runs} roll-outs.")
    if (nats := answer.test.at_hands) and answer.named:
        said.append(f"Tracks beside hands speak {'for' if nats > 0 else 'against'} an effect at a hand, by {abs(nats):.1f} nats.")
    if lost := _lost(answer, config):
        moved = 1e3 * np.nanmedian(lost.far[lost.tracks])
        said.append(f"{len(lost.tracks)} of {len(lost.far)} tracks leave their neighbours, by {moved:.0f} mm (p = {lost.p:.2g}).")
    if answer.verdict == "adequate":
        said.append("Effects below the sizes listed as detectable may still be there.")
    said += [found.faster.said()] if found.faster else []
    return said + ([found.twin.note] if found.twin.note else [])


def recordings_of(parts) -> list[dict]:
    return [
        {
            "name": one.name,
            "role": role,
            "frames": one.frame_count,
            "points": one.points.shape[1],
            "fps": float(one.fps),
            "train_end": one.split.train_end if role == "case" else 0,
        }
        for one, role in parts
    ]


def curves_of(parts, runs, floor) -> dict:
    found = {}
    for (one, _), pair in zip(parts, runs, strict=True):
        named = {n: [_mean(row) for row in _off(one, p)] for n, p in zip(("baseline", "extended"), pair, strict=True) if p is not None}
        found[one.name] = named | {"noise_floor": floor}
    return found


def arrays_of(parts, runs) -> dict:
    """As ``write_report`` takes them."""
    arrays = {}
    for r, ((one, _), pair) in enumerate(zip(parts, runs, strict=True)):
        arrays[f"observed_{r}"] = np.where(one.visible[..., None], one.points, np.nan)
        for name, path in zip(("baseline", "extended"), pair, strict=True):
            if path is not None:
                arrays[f"{name}_{r}"] = path
        if one.controllers.size:
            arrays[f"controllers_{r}"] = one.controllers
    first = parts[0][0]
    gravity = np.asarray(first.gravity, float)
    if np.linalg.norm(gravity) > 0:
        arrays["up"] = -gravity / np.linalg.norm(gravity)
    if first.ground is not None:
        arrays["ground"] = np.append(first.ground.normal, first.ground.offset) / np.linalg.norm(first.ground.normal)
    return arrays
