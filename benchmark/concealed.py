"""Diagnosing recordings whose effect is known and was concealed: answers, their scores, and the calibration of the decision."""

from __future__ import annotations

import json
import time
import traceback
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..datasets.concealed.folder import Folder
from ..datasets.concealed.seal import read_json, write_json
from ..diagnosis.balance import TURNS
from ..diagnosis.verdict import (
    CONTEXT,
    FEATURES,
    GAINS,
    NONE,
    OTHER,
    SEEN,
    SHOWS,
    USUAL,
    Calibration,
    Reading,
    decide,
    kind_of,
    scores,
    shown,
    verdict_of,
)
from .challenge.answering import answer_case, each
from .challenge.opening import opened_labels
from .challenge.scores import of_the_ceiling
from .challenge.truths import Row

__all__ = ["answer", "answers", "by_effect", "calibrate", "ceilings", "crossed", "decided", "markdown", "score", "study", "thresholds"]

LABELS = "labels.json"
RIDGE = 0.01  # of the shared weights; effects' own biases are few cases each and get more
RIDGE_BIAS = 0.02
SURE = 30.0  # log odds for each unit of what recordings say by themselves: it parts all cases there are, so that nothing is to be fitted
SELDOM = {"camera_pose_seen": -1.2}  # log odds: that all cameras are off alike is rarer than that the ground is
FOLDS = 8
POOLED = 4.0  # cases without an effect that what all terms show together counts for, beside a term's own
PLAIN = ""  # of what does not depend on the context
TELLS = 0.15  # log of the share of error left by a reading from which on it explains something


def answer(case: Path, out: Path, preset: str, device: str) -> dict:
    """Diagnose ``case``/fit with ``case``/transfer, write into ``out``/NAME, and return the result; an error is an answer that says so."""
    from ..diagnosis.diagnose import diagnose
    from .opening import open_scenario

    begun = time.time()
    try:
        fit, transfer = (open_scenario(str(case / part)) for part in ("fit", "transfer"))
        found = diagnose(fit, twin="springs", transfer=[transfer], preset=preset, device=device)
        found.write(out / case.name)
    except Exception as error:
        traceback.print_exc()
        return {"verdict": "failed", "error": f"{type(error).__name__}: {error}", "seconds": time.time() - begun}
    return read_json(out / case.name / "diagnosis.json")


def answers(data: Path, out: Path, *, preset: str = "quick", device: str = "cpu", jobs: int = 1, progress=print) -> dict[str, dict]:
    """Answers by case for a folder that ``python -m twinbench.datasets.concealed`` wrote; those that are there are kept."""
    cases = sorted(p for p in data.iterdir() if (p / "fit").is_dir() and (p / "transfer").is_dir())
    if not cases:
        raise ValueError(
            f"{data}: no case_*/fit and case_*/transfer here; write some with python -m twinbench.datasets.concealed --out {data}"
        )
    done = {c.name: read_json(file) for c in cases if (file := out / c.name / "diagnosis.json").exists()}
    todo = [(c, out, preset, device) for c in cases if c.name not in done]
    for (case, *_), found in each(answer, todo, jobs=jobs, device=device):
        name = Path(case).name
        done[name] = found
        progress(f"{name}: {found['verdict']} {found.get('effect') or ''}")
    return dict(sorted(done.items()))


def ceilings(
    data: Path, out: Path, labels: dict[str, dict], *, preset: str = "quick", device: str = "cpu", jobs: int = 1
) -> dict[str, dict]:
    """By case with an effect, the answer of who is told the effect and its place (the entrant "oracle"); those that are there are kept."""
    files = {name: out / name / "oracle.json" for name, label in labels.items() if label["kind"] == "effect" and (data / name).is_dir()}
    todo = [(data / name, ("oracle",), preset, device, labels[name]) for name, file in files.items() if not file.exists()]
    for (case, *_), found in each(answer_case, todo, jobs=jobs, device=device):
        write_json(files[Path(case).name], found["oracle"])
    return {name: read_json(file) for name, file in files.items()}


def decided(result: dict, c: Calibration) -> dict:
    """``result`` with the decision taken again from its evidence."""
    if "evidence" not in result:
        return result
    found, around = _evidence(result)
    d = decide(found, around, c, result["evidence"].get("alike", ()))
    return {**result, "verdict": d.verdict, "effect": d.effect, "alternatives": list(d.alternatives), "probabilities": d.probabilities}


def _evidence(result):
    rows = result["evidence"]["readings"]
    found = [Reading(r["effect"], r["term"], {k: v for k, v in r.items() if k not in ("effect", "term")}) for r in rows]
    return found, result["evidence"]["context"]


def truth(label: dict) -> str:
    """What a perfect answer says: "adequate", "unknown" for what is in no catalogue, or the effect."""
    return Row("", label, {}).truth


def score(results: dict[str, dict], labels: dict[str, dict], told: Mapping[str, dict] | None = None) -> dict:
    """Figures by the rules of the challenge: alarms on controls, effects found, names right first and among two, names for the nameless,
    place and onset of what was named rightly, and the share of the closable error that the named term removes on the transfer recording;
    where ``told`` has the answers of those who know (``ceilings``), what is removed over what they remove.

    Cases whose simulated truth moves when its mesh is refined (a label's ``unconverged``) have figures of their own, under that name.
    """
    rows = [Row(k, labels[k], results[k], (told or {}).get(k)) for k in sorted(results) if k in labels]
    apart = [r for r in rows if r.label.get("unconverged")]
    whole = _figures([r for r in rows if not r.label.get("unconverged")], told)
    return whole | ({"unconverged": _figures(apart, told)} if apart else {})


def _figures(rows, told):
    controls, effects, outside = ([r for r in rows if r.kind == kind] for kind in ("control", "effect", "outside"))
    first = [r for r in effects if r.first]
    places = [d for r in first if (d := _distance(r.answer, r.label)) is not None]
    began = [(r.answer["when"]["frames"][0], r.label["onset"][0]) for r in first if r.answer.get("when")]
    onsets = [abs(said - true) for said, true in began if true is not None]
    shares = [c for r in first if (c := closed(r.answer)) is not None]
    return {
        "cases": len(rows),
        "controls": len(controls),
        "alarms": sum(r.alarm for r in controls),
        "named_alarms": sum(r.named for r in controls),
        "effects": len(effects),
        "found": sum(r.alarm for r in effects),
        "named": sum(r.named for r in effects),
        "right_first": len(first),
        "right_of_two": sum(r.of_two for r in effects),
        "wrong": sum(r.named and not r.first for r in effects),
        "ranked_first": sum(r.rank == 1 for r in effects),
        "ranked_of_two": sum(r.rank <= 2 for r in effects),
        "outside": len(outside),
        "outside_named": sum(r.named and r.verdict != "ambiguous" for r in outside),
        "place_mm": 1000 * float(np.median(places)) if places else None,
        "onset_frames": float(np.median(onsets)) if onsets else None,
        "closed": float(np.median(shares)) if shares else None,
        "seconds": float(np.median([r.answer["seconds"] for r in rows])) if rows else None,
        **({f"of_oracle_{part}": of_the_ceiling(effects, part) for part in ("heldout", "transfer")} if told else {}),
    }


def _distance(result, label):
    """Between the place said and the place of the label [m], None where either has none."""
    place = label["place"][0]
    return float(np.linalg.norm(np.subtract(result["where"]["centroid"], place["centroid"]))) if result.get("where") and place else None


def closed(result) -> float | None:
    """Share of the error above the noise floor that the named term removes on the transfer recording."""
    fit = result["fit"].get("transfer")
    if not fit or fit["extended"] is None or not fit["baseline"] > fit["noise_floor"]:
        return None
    return (fit["baseline"] - fit["extended"]) / (fit["baseline"] - fit["noise_floor"])


def calibrate(results: dict[str, dict], labels: dict[str, dict], *, source: str = "") -> Calibration:
    """Weights that make the labels likely: one multinomial choice a case among its readings, "adequate" and "unknown"; ridge priors.

    Where the right reading explains next to nothing (``TELLS``, or it was never refitted), "unknown" is right too: what is asked of the
    weights is to name what shows and to accuse no other. Of two effects at once, and of one that moves a body by no more than a sound twin
    is off by, nothing is learned.
    """
    from scipy.optimize import minimize

    taught = [k for k, r in sorted(results.items()) if k in labels and "evidence" in r and _teaches(labels[k])]
    rows = [(*_evidence(results[k]), truth(labels[k])) for k in taught]
    null, usual = _null(rows), _usual(rows)
    terms = sorted({r.key for found, _, _ in rows for r in found})
    unknowns = [("weight", name) for name in (*FEATURES, *SEEN)] + [("bias", term) for term in terms]
    unknowns += [(of, name) for of in (NONE, OTHER) for name in (PLAIN, *CONTEXT)]

    def told(values):
        table = dict(zip(unknowns, map(float, values), strict=True))
        weights, biases = ({name: v for (of, name), v in table.items() if of == block} for block in ("weight", "bias"))
        biases |= {of: table[of, PLAIN] for of in (NONE, OTHER)}
        return Calibration(weights, biases, {of: {n: table[of, n] for n in CONTEXT} for of in (NONE, OTHER)}, null=null, usual=usual)

    # Scores are affine in the unknowns: their slopes are found by asking for each of them once.
    nothing = told(np.zeros(len(unknowns)))
    offset = _scores(rows, nothing)
    slopes = np.stack([_scores(rows, told(unit)) - offset for unit in np.eye(len(unknowns))], 1)
    names = [scores(found, context, nothing)[0] for found, context, _ in rows]
    first = np.cumsum([0, *map(len, names)])[:-1]
    right = np.concatenate([_right(found, of, true) for of, (found, _, true) in zip(names, rows, strict=True)])
    ridge = np.array([_ridge(*unknown) for unknown in unknowns])

    def cost(v):
        """Mean negative log likelihood of the truths with its priors, and its gradient."""
        values = offset + slopes @ v
        all_of, all_share = _softmax(values, first)
        right_of, right_share = _softmax(np.where(right, values, -np.inf), first)
        gradient = slopes.T @ (all_share - right_share) / len(rows) + 2 * ridge * v
        return float((all_of - right_of).mean() + ridge @ v**2), gradient

    found = minimize(cost, np.zeros(len(unknowns)), jac=True, method="L-BFGS-B", bounds=[_bounds(*unknown) for unknown in unknowns])
    return replace(told(np.round(found.x, 4)), source=source)


def _teaches(label: dict) -> bool:
    """Whether a case says what evidence means; sealed sets have a ``level``, the size of an effect over what a sound twin is off by."""
    return label["kind"] != "pair" and not (label["kind"] == "effect" and (label.get("level") or np.inf) <= 1)


def _ridge(of: str, name: str) -> float:
    """How strongly an unknown of the calibration is drawn to zero. How often nothing, or something else, is missing is free."""
    if of == "weight":
        return 0.0 if name in SEEN else RIDGE
    return RIDGE_BIAS if of == "bias" else 0.0 if name == PLAIN else RIDGE


def _bounds(of: str, name: str) -> tuple[float | None, float | None]:
    """Between which an unknown of the calibration is looked for.

    A gain never speaks against its effect, nor does being told from the twin's own numbers; an amplitude more never speaks for it. Errors
    only speak against "adequate"; what they speak for is the readings' to say.
    """
    if of == "weight" and name in SEEN:
        return SURE, SURE
    if of == "weight" and (name == "kept" or name in (*GAINS, *SHOWS, *TURNS)):
        return 0, None
    if of == "weight" and name == "extra":
        return None, 0
    if of == "bias" and name in SEEN:
        seldom = SELDOM.get(name, 0.0)
        return seldom, seldom
    if of in (NONE, OTHER) and any(name.startswith(f"{usual}_") for usual in USUAL):
        return None if of == NONE else 0, 0
    return None, None


def _null(rows) -> dict[str, dict[str, list[float]]]:
    """By term, and over all by "": mean and standard deviation of what readings show where nothing is missing."""
    seen: dict[str, list] = {}
    for found, _, true in rows:
        for r in found:
            if r.term and true == NONE and all(name in r.features for name in SHOWS):
                seen.setdefault(r.key, []).append([r.features[name] for name in SHOWS])
    return _spreads(seen, SHOWS, POOLED)


def _usual(rows) -> dict[str, dict[str, list[float]]]:
    """By kind of body, and over all by "": mean and standard deviation of errors and gains where nothing is missing."""
    seen: dict[str, list] = {}
    for _, around, true in rows:
        if true == NONE and all(name in around for name in USUAL):
            seen.setdefault(kind_of(around), []).append([around[name] for name in USUAL])
    return _spreads(seen, USUAL, 1.0)


def _spreads(seen, names, pooled):
    """By key, and over all by "", mean and standard deviation; each key's are drawn to those of all as if those were ``pooled`` more."""
    if not seen:
        return {}
    every = np.concatenate([np.array(v) for v in seen.values()])
    middle, width = every.mean(0), np.maximum(every.std(0), 1e-3)

    def told(mean, deviation):
        return {name: [round(float(m), 4), round(float(d), 4)] for name, m, d in zip(names, mean, deviation, strict=True)}

    out = {"": told(middle, width)}
    for key, values in seen.items():
        share = len(values) / (len(values) + pooled)
        mean = share * np.mean(values, 0) + (1 - share) * middle
        out[key] = told(mean, np.sqrt(share * np.var(values, 0) + (1 - share) * width**2))
    return out


def _scores(rows, c: Calibration) -> np.ndarray:
    return np.concatenate([scores(found, context, c)[1] for found, context, _ in rows])


def _right(found, names, true) -> np.ndarray:
    """Which of a case's readings are true; "unknown", the last, where none is or none that is shows."""
    right = np.array([n == true for n in names])
    if true != NONE and max((shown(r) for r in found if r.effect == true), default=0.0) < TELLS:
        right[-1] = True
    return right


def _softmax(values, first):
    """Per case, whose readings begin at ``first``: the log of the sum of exponentials; and the share of each reading in it."""
    lengths = np.diff([*first, len(values)])
    top = np.maximum.reduceat(values, first)
    weight = np.exp(values - np.repeat(top, lengths))
    total = np.add.reduceat(weight, first)
    return top + np.log(total), weight / np.repeat(total, lengths)


def crossed(results: dict[str, dict], labels: dict[str, dict], *, seed: int = 0, thresholds: Calibration | None = None) -> dict[str, dict]:
    """Decisions on every case by a calibration that did not see it (``FOLDS`` parts)."""
    names = [k for k in sorted(results) if k in labels]
    fold = np.random.default_rng(seed).permutation(len(names)) % FOLDS
    out = {}
    for part in range(FOLDS):
        c = calibrate({n: results[n] for n, f in zip(names, fold, strict=True) if f != part}, labels)
        if thresholds:
            c = replace(c, named=thresholds.named, both=thresholds.both, sure=thresholds.sure)
        out |= {n: decided(results[n], c) for n, f in zip(names, fold, strict=True) if f == part}
    return out


def markdown(results: dict[str, dict], labels: dict[str, dict]) -> str:
    """A row for every case, and a row for every effect with how often it was found and named."""
    lines = [
        "| case | truth | body | moved mm | verdict | effect | alternatives | p | place mm | transfer mm before > after |",
        "|" + "---|" * 10,
    ]
    for name in sorted(results):
        r, v = results[name], labels[name]
        told = (r.get("probabilities") or {}).get(r.get("effect") or NONE)
        d = _distance(r, v)
        fit = (r.get("fit") or {}).get("transfer") or {}
        after = f"{1000 * fit['baseline']:.1f} > {1000 * fit['extended']:.1f}" if fit.get("extended") else ""
        what = v["effect"] or f"control ({v['control']})"
        what += " (outside)" if v["kind"] == "outside" else ""
        cells = [
            name,
            what,
            v["object"],
            f"{1000 * v['displacement']:.0f}",
            r["verdict"],
            r.get("effect") or "",
            ", ".join(r.get("alternatives") or []),
        ]
        cells += ["" if told is None else f"{told:.2f}", "" if d is None else f"{1000 * d:.0f}", after]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def by_effect(results: dict[str, dict], labels: dict[str, dict]) -> str:
    """Per effect: cases, found, named right, named wrong as."""
    groups: dict[str, list] = {}
    for name in sorted(results):
        groups.setdefault(truth(labels[name]), []).append(results[name])
    lines = ["| truth | cases | right | refused | said instead |", "|---|---|---|---|---|"]
    for true, group in sorted(groups.items()):
        said = Counter(r.get("effect") or r["verdict"] for r in group)
        right = said.pop(true, 0)
        refusals = {"cannot_tell"} if true == NONE else {"cannot_tell", NONE, OTHER} - {true}  # of nothing, "unknown" is an alarm
        refused = sum(said.pop(k, 0) for k in refusals)
        lines.append(f"| {true} | {len(group)} | {right} | {refused} | {', '.join(f'{k} {n}' for k, n in said.most_common())} |")
    return "\n".join(lines)


def thresholds(
    results: dict[str, dict], labels: dict[str, dict], *, alarms: float = 0.04, seeds: Sequence[int] = (0, 1, 2)
) -> tuple[float, float, dict[str, float]]:
    """Least probabilities (named, both, and sure by kind of body), from cross-validations by ``seeds``.

    All but the share ``alarms`` of a kind's controls are as sure as it must be. Names are chosen by what they are worth in total.
    """
    runs = [crossed(results, labels, seed=s) for s in seeds]
    sure = _sure([r for run in runs for k, r in run.items() if truth(labels[k]) == NONE and "evidence" in r], alarms)
    best, chosen = -np.inf, (0.5, 0.7)
    for named in (0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7):
        for both in (0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
            if both < named:
                continue
            c, worth = Calibration({}, {}, {}, named=named, both=both, sure=sure), 0.0
            for run in runs:
                s = score({k: _again(r, c) for k, r in run.items()}, labels)
                worth -= 10 * max(0.0, s["named_alarms"] - alarms * s["controls"])
                worth += (
                    s["right_first"]
                    + 0.4 * (s["right_of_two"] - s["right_first"])
                    - 1.5 * s["wrong"]  # a refusal is better than a wrong name
                    - 0.7 * s["outside_named"]
                )
            if worth > best:
                best, chosen = worth, (named, both)
    return *chosen, sure


def _sure(controls, share):
    """By kind of body, the probability of "adequate" that all but ``share`` of such ``controls`` reach."""
    chances: dict[str, list[float]] = {}
    for result in controls:
        chances.setdefault(kind_of(result["evidence"]["context"]), []).append(result["probabilities"][NONE])
    return {kind: round(float(np.quantile(values, share)), 4) for kind, values in sorted(chances.items())}


def study(
    folders: Sequence[Path], out: Path, *, preset: str, device: str, jobs: int, calibrating: bool = False, ceiling: bool = False
) -> tuple[dict, dict, dict]:
    """Answers, labels and scores of folders of cases; scores.json, cases.md and, ``calibrating``, calibration.json go into ``out``.

    ``ceiling``: whoever is told answers too. A sealed set that was opened is a folder of cases too. Where there are several folders, cases
    bear their names too. Raises ValueError where two are called alike, or one has no labels.
    """
    if not folders:
        raise ValueError("no folder of cases is named")
    if len({data.name for data in folders}) < len(folders):
        raise ValueError(f"folders of cases must have different names, got {', '.join(map(str, folders))}")
    results, labels, told, how = {}, {}, {}, {"preset": preset, "device": device, "jobs": jobs}
    for data in folders:
        own = f"{data.name}/" if len(folders) > 1 else ""
        cases, known = _labelled(data)
        labels |= {own + name: label for name, label in known.items()}
        results |= {own + name: found for name, found in answers(cases, out / own, **how).items()}
        if ceiling:
            told |= {own + name: found for name, found in ceilings(cases, out / own, known, **how).items()}
    if calibrating:
        fitted = calibrate(results, labels, source=f"{len(results)} cases of {' and '.join(data.name for data in folders)}")
        named, both, sure = thresholds(results, labels)
        fitted = replace(fitted, named=named, both=both, sure=sure)
        (out / "calibration.json").write_text(fitted.to_json() + "\n")
        results = crossed(results, labels, thresholds=fitted)
    scored = score(results, labels, told)
    (out / "scores.json").write_text(json.dumps(scored, indent=1) + "\n")
    (out / "cases.md").write_text(by_effect(results, labels) + "\n\n" + markdown(results, labels) + "\n")
    return results, labels, scored


def _labelled(data: Path) -> tuple[Path, dict[str, dict]]:
    """Where the cases of ``data`` are, and their labels: of a folder of cases, or of a sealed set that was opened."""
    folder = Folder(data)
    if folder.manifest.is_file():
        return folder.cases, opened_labels(folder)
    if not (data / LABELS).is_file():
        raise ValueError(f"{data}: no {LABELS} here; write cases with python -m twinbench.datasets.concealed --out {data}")
    return data, read_json(data / LABELS)


def _again(result, c):
    """The decision from probabilities that are there already."""
    if "evidence" not in result:
        return result
    evidence = result["evidence"]
    verdict, effect, also = verdict_of(result["probabilities"], c, kind_of(evidence["context"]), evidence.get("alike", ()))
    return {**result, "verdict": verdict, "effect": effect, "alternatives": list(also)}
