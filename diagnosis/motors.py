"""What a chain of markers that motors move lacks beside a sound recording of the same command: joints in the place of a twin (``joints``).

No twin here has tendons or motors, so that nothing is simulated. The sound recording says what a sound body does under the command.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ..datasets.scenario import Scenario
from .config import DiagnosisConfig
from .inference.blocks import is_marked
from .inference.contrast import as_long, until
from .joints import BIN, MASS, STIFFNESS, Difference, Explanation, compared
from .outcome import SCHEMA, Outcome, arrays_of, chance_of_sound, curves_of, floor_of, recordings_of
from .page.words import effect_name

__all__ = ["ask_joints", "is_moved_by_motors", "judged"]

SURE = 1.645  # standard deviations to either end of a 90 % interval
POWER = 1.645  # more that an effect must stand out by to be found in 95 of 100
UNITS = {MASS: "1/m", STIFFNESS: "-"}


def is_moved_by_motors(recording: Scenario, config: DiagnosisConfig) -> bool:
    """Whether it shows markers, and tells what motors did."""
    return recording.actuation is not None and is_marked(recording, config)


def ask_joints(
    case: Scenario,
    against: Sequence[Scenario],
    config: DiagnosisConfig,
    *,
    transfer: Sequence[Scenario] = (),
    progress: Callable[[str], None] = lambda said: None,
) -> Outcome:
    """How ``case`` differs from sound recordings of the same command (``against``), by its joints, over the frames that all have.

    A name is sure where it alone explains the difference as well as anything does; where two do, or both at once do clearly better, the
    recording cannot tell them apart. Raises ValueError as ``compared``, and for a ``transfer`` recording, which nothing here could predict.
    """
    if transfer:
        raise ValueError(f"what motors move is not simulated, so that a transfer recording says nothing, got {transfer[0].name}")
    begun, case = time.time(), until(case, against)
    against = [as_long(one, case) for one in against]
    progress("comparing joints")
    found = compared(case, against)
    verdict, names = judged(found, config)
    both = found.best(*(n for n in (MASS, STIFFNESS) if n in names)) if names else None
    first = found.best(names[0]) if names else None
    floor, why = floor_of(case), _why(found, verdict, config)
    parts = [(case, "case"), *((one, "against") for one in against)]
    beside = np.where(against[0].visible[..., None], against[0].points, np.nan)  # the first sound recording stands where a twin would
    runs = [(beside, None), *((None, None) for _ in against)]
    result = {
        "schema": SCHEMA,
        "twin": "joints",
        "verdict": verdict,
        "effect": names[0] if names else None,
        "alternatives": list(names[1:]),
        "probabilities": _probabilities(found, names),
        "why": why,
        "test": dict(p=found.p, level=config.level, members=0, controls=0),
        "where": _where(both, found, case),
        "when": {"frames": [0, case.frame_count]} if names else None,
        "parameters": _parameters(both),
        "fit": _errors(found, first, floor),
        "budget": _budget(found, first, case, config),
        "detectable": {},
        "detectable_mm": _detectable(found),
        "experiment": None,
        "evidence": {
            "hypotheses": _hypotheses(found, first),
            "noise_floor": floor,
            "notes": [*_notes(found), *filter(None, [why])],
            "recordings": recordings_of(parts),
            "curves": curves_of(parts[:1], runs[:1], floor),
        },
        "seconds": round(time.time() - begun, 3),
    }
    return Outcome(result, arrays_of(parts, runs))


def judged(found: Difference, config: DiagnosisConfig) -> tuple[str, tuple[str, ...]]:
    """(one of ``page.words.VERDICTS``, the names that it rests on, best first)."""
    if found.p >= config.level:
        return ("cannot_tell" if _why(found, "cannot_tell", config) else "adequate"), ()
    best = found.explanations[0]
    if not found.gain(best) > 0:
        return "unknown", ()
    alone = {n: found.best(n).nats for n in sorted((MASS, STIFFNESS), key=lambda n: -found.best(n).nats)}
    suffice = tuple(n for n, nats in alone.items() if best.nats - nats < config.clearly)
    return ("missing" if len(suffice) == 1 else "ambiguous"), suffice or tuple(alone)


def _probabilities(found: Difference, names: Sequence[str]) -> dict[str, float]:
    """Explanations share by their evidence, two names of one in halves, places of a name alike."""
    sound = chance_of_sound(found.p)
    if not names:
        return {"adequate": round(sound, 4), "unknown": round(1 - sound, 4)}
    weights = {MASS: 0.0, STIFFNESS: 0.0}
    for one in found.explanations:
        places = sum(one.names == other.names for other in found.explanations)
        for name in one.names:
            weights[name] += float(np.exp(one.nats - found.explanations[0].nats)) / places / len(one.names)
    whole = sum(weights[n] for n in names)
    shares = {n: round((1 - sound) * w / whole, 4) for n, w in weights.items() if n in names}
    return {"adequate": round(sound, 4)} | shares | {"unknown": 0.0}


def _why(found: Difference, verdict: str, config: DiagnosisConfig) -> str | None:
    if verdict == "ambiguous":
        both, alone = found.best(MASS, STIFFNESS), max(found.best(n).nats for n in (MASS, STIFFNESS))
        if both.nats - alone > config.clearly:
            return f"Both at once explain it better than either alone ({both.nats - alone:.0f} nats)."
        return None
    if verdict == "unknown":
        return f"{effect_name(found.explanations[0].names[0])}, the likeliest, predicts no frames held out.".capitalize()
    most = max(_detectable(found).values())
    if verdict == "cannot_tell" and most > config.motion:
        return f"An effect would have to move the markers by {most:.0f} mm or more to be found here."
    return None


def _where(best: Explanation | None, found: Difference, case: Scenario) -> dict | None:
    """The marker that is heavier."""
    if best is None or MASS not in best.names:
        return None
    point = int(found.order[best.marker + 1])
    return {"points": [point], "centroid": case.points[0, point].tolist(), "radius": 0.0}


def _parameters(best: Explanation | None) -> dict:
    """Of each joint, counted from the held end: weight over stiffness [1/m], and by which share it is stiffer."""
    rows = [(0, MASS, "weight_over_stiffness"), (1, STIFFNESS, "stiffer")]
    if best is None:
        return {}
    found = {}
    for row, name, words in rows:
        if name not in best.names:
            continue
        for j, (value, sd) in enumerate(zip(best.values[row], best.sds[row], strict=True)):
            if sd > 0:
                ends = [float(value - SURE * sd), float(value + SURE * sd)]
                ends = [max(0.0, ends[0]), ends[1]] if name == MASS else ends
                found[f"{words}_joint_{j + 1}"] = {"value": float(value), "unit": UNITS[name], "interval90": ends}
    return found


def _errors(found: Difference, best: Explanation | None, floor: float) -> dict:
    rows = {}
    for split, fitted in (("train", True), ("heldout", False)):
        before, after = found.left(fitted=fitted), found.left(best, fitted=fitted) if best else None
        if np.isfinite(before):
            beside = {"noise_floor": floor, "last_residual": None, "learned_residual": None}
            rows[split] = {"baseline": before, "extended": after} | beside
    return rows


def _budget(found: Difference, best: Explanation | None, case: Scenario, config: DiagnosisConfig) -> list[dict]:
    """By part of the recording, RMS in mm over the markers: there is no twin, and so nothing that one gets wrong."""
    parts, times = [], np.arange(len(found.seen)) * BIN
    for fitted, count in ((True, config.times), (False, config.held_out)):
        for rows in np.array_split(np.flatnonzero(found.fitted == fitted), count):
            seen = rows[found.seen[rows]]
            if not len(seen):
                continue
            error, left = (_rms(found.off(one)[seen]) for one in (None, best))
            part = dict(record=0, recording=case.name, begin=float(times[rows[0]]), end=float(times[rows[-1]] + BIN), fitted=fitted)
            part |= dict(error=error, noise=0.0, representation=0.0, parameters=0.0)
            parts.append(part | dict(named=float(np.sqrt(max(0.0, error**2 - left**2))), unexplained=min(left, error)))
    return parts


def _rms(far) -> float:
    return float(1e3 * np.sqrt((far**2).sum(-1).mean()))


def _detectable(found: Difference) -> dict[str, float]:
    """mm RMS by which an effect of one joint, of that in which it shows the most, must move markers to be found in 95 of 100 recordings."""
    used = found.seen & found.fitted
    sizes: dict[str, float] = {}
    for name, row in ((MASS, 0), (STIFFNESS, 1)):
        for one in (e for e in found.explanations if e.names == (name,)):
            for j in np.flatnonzero(one.sds[row]):
                bends = np.zeros_like(found.chain.bends)
                bends[:, j] = found.chain.moments[:, j, one.marker] if name == MASS else found.chain.bends[:, j]
                bends -= bends[used].mean(0)
                stands = np.sqrt(2 * max(0.0, found.usual) + np.log(max(2, int(used.sum())))) + POWER
                size = stands * one.sds[row, j] * _rms(found.chain.moved(bends)[used])
                sizes[name] = min(sizes.get(name, np.inf), size)
        sizes.setdefault(name, 0.0)  # recordings that do not differ at all leave nothing open
    return sizes


def _hypotheses(found: Difference, first: Explanation | None) -> list[dict]:
    rows = [{"effect": "baseline", "kind": "baseline", "train_gain": 0.0, "heldout_gain": 0.0, "transfer_gain": None}]
    for one in found.explanations:
        gains = [
            1 - found.left(one, fitted=fitted) / before if (before := found.left(fitted=fitted)) > 0 else 0.0 for fitted in (True, False)
        ]
        at = f" at marker {found.order[one.marker + 1]}" if one.marker >= 0 else ""
        why = "chosen" if one is first else f"{found.explanations[0].nats - one.nats:.0f} nats less likely"
        row = {"effect": " and ".join(one.names), "kind": f"joints{at}", "train_gain": gains[0], "heldout_gain": gains[1]}
        rows.append(row | {"transfer_gain": None, "absorbed": None, "amplitude": None, "unit": "-", "probability": None, "why": why})
    return rows


def _notes(found: Difference) -> list[str]:
    heavy = sorted((e for e in found.explanations if e.names == (MASS,)), key=lambda e: -e.nats)
    said = [
        "Motors move this body, which no twin here has: its joints are compared with those of the sound recordings.",
        f"p = {found.p:.2g} that a motion which has nothing to do with the difference explains as much of it.",
    ]
    if found.p < 1 and len(heavy) > 1:
        first, second = heavy[:2]
        at = [int(found.order[e.marker + 1]) for e in (first, second)]
        said.append(f"A weight would be at marker {at[0]}: {first.nats - second.nats:.0f} nats likelier than at marker {at[1]}.")
    return [*said, f"How stiff joints are is not told, and so no weight in grams: {effect_name(MASS)} is told over the joint's stiffness."]
