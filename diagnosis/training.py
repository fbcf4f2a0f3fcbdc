"""Fitting the decision about twins of springs to cases whose truth is known: weights, biases, and how sure it must be."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .balance import TURNS
from .verdict import (
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

__all__ = ["calibrate", "crossed", "decided", "thresholds"]

RIDGE = 0.01  # of the shared weights; effects' own biases are few cases each and get more
RIDGE_BIAS = 0.02
SURE = 30.0  # log odds for each unit of what recordings say by themselves: it parts all cases there are, so that nothing is to be fitted
SELDOM = {"camera_pose_seen": -1.2}  # log odds: that all cameras are off alike is rarer than that the ground is
FOLDS = 8
POOLED = 4.0  # cases without an effect that what all terms show together counts for, beside a term's own
PLAIN = ""  # of what does not depend on the context
TELLS = 0.15  # log of the share of error left by a reading from which on it explains something


def calibrate(results: Mapping[str, dict], truths: Mapping[str, str], *, source: str = "") -> Calibration:
    """Weights that make the ``truths`` of cases likely: one multinomial choice a case among its readings, "adequate" and "unknown"; ridge
    priors. Of results without a truth nothing is learned.

    Where the right reading explains next to nothing (``TELLS``, or it was never refitted), "unknown" is right too: what is asked of the
    weights is to name what shows and to accuse no other.
    """
    from scipy.optimize import minimize

    rows = [(*_evidence(r), truths[k]) for k, r in sorted(results.items()) if k in truths and "evidence" in r]
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


def crossed(
    results: Mapping[str, dict], truths: Mapping[str, str], *, seed: int = 0, thresholds: Calibration | None = None
) -> dict[str, dict]:
    """Decisions on every case by a calibration that did not see it (``FOLDS`` parts)."""
    names = sorted(results)
    fold = np.random.default_rng(seed).permutation(len(names)) % FOLDS
    out = {}
    for part in range(FOLDS):
        c = calibrate({n: results[n] for n, f in zip(names, fold, strict=True) if f != part}, truths)
        if thresholds:
            c = replace(c, named=thresholds.named, both=thresholds.both, sure=thresholds.sure)
        out |= {n: decided(results[n], c) for n, f in zip(names, fold, strict=True) if f == part}
    return out


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


def thresholds(
    results: Mapping[str, dict],
    truths: Mapping[str, str],
    score: Callable[[dict[str, dict]], Mapping[str, Any]],
    *,
    alarms: float = 0.04,
    seeds: Sequence[int] = (0, 1, 2),
) -> tuple[float, float, dict[str, float]]:
    """Least probabilities (named, both, and sure by kind of body), from cross-validations by ``seeds``.

    All but the share ``alarms`` of a kind's controls are as sure as it must be. Names are chosen by what they are worth in total, by how
    many of which sort a ``score`` of answers counts.
    """
    runs = [crossed(results, truths, seed=s) for s in seeds]
    sure = _sure([r for run in runs for k, r in run.items() if truths.get(k) == NONE and "evidence" in r], alarms)
    best, chosen = -np.inf, (0.5, 0.7)
    for named in (0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7):
        for both in (0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
            if both < named:
                continue
            c, worth = Calibration({}, {}, {}, named=named, both=both, sure=sure), 0.0
            for run in runs:
                s = score({k: _again(r, c) for k, r in run.items()})
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


def _again(result, c):
    """The decision from probabilities that are there already."""
    if "evidence" not in result:
        return result
    evidence = result["evidence"]
    verdict, effect, also = verdict_of(result["probabilities"], c, kind_of(evidence["context"]), evidence.get("alike", ()))
    return {**result, "verdict": verdict, "effect": effect, "alternatives": list(also)}
