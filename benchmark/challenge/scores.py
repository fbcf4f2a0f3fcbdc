"""Every figure by which an answerer of the challenge is judged, with its uncertainty."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...diagnosis.hypotheses import catalogue
from ...diagnosis.verdict import OTHER
from .statistics import (
    auroc,
    bootstrap,
    clopper_pearson,
    early_auroc,
    expected_calibration_error,
    overlap,
    risk_coverage,
    size_at,
    upper_bound,
)
from .truths import Row, amplitude

__all__ = ["SIZES", "Figure", "confidence", "figures", "size_of", "with_floors"]

NAN = float("nan")

SIZES = (0.5, 1.0, 2.0, 4.0, 8.0)  # over the floor; a case belongs to the nearest, by ratio
CLOSABLE = 0.05  # share of its error that who was told must close, so that there is something to close
PARTS = ("heldout", "transfer")


@dataclass(frozen=True)
class Figure:
    """One number: its 95 % interval, over how many cases, and the ``goal`` that it shall reach ("higher", "lower"), if there is one."""

    name: str
    value: float
    low: float
    high: float
    cases: int
    unit: str = ""
    goal: float | None = None
    better: str = "higher"

    @property
    def reached(self) -> bool | None:
        """Whether the goal is reached; None without a goal, or where nothing could be counted."""
        if self.goal is None or not np.isfinite(self.value):
            return None
        return bool(self.value >= self.goal if self.better == "higher" else self.value <= self.goal)


def with_floors(rows: Sequence[Row], judge: Sequence[Row]) -> list[Row]:
    """``rows`` with what a twin of a sound body is off by: the median training error in ``judge``'s controls of the same body and engine.

    Where there are none, those of the same body count, then all.
    """
    known: dict[tuple, list[float]] = {}
    for row in judge:
        error = ((row.answer.get("fit") or {}).get("train") or {}).get("baseline")
        if row.kind == "control" and error:
            for key in (_body_and_engine(row), _body_and_engine(row)[:1], ()):
                known.setdefault(key, []).append(error)
    return [replace(r, floor=float(np.median(next(known[k] for k in _keys(r) if k in known))) if known else r.floor) for r in rows]


def _body_and_engine(row):
    return row.label["object"], row.label.get("simulated_by")


def _keys(row):
    return _body_and_engine(row), _body_and_engine(row)[:1], ()


def figures(rows: Sequence[Row]) -> list[Figure]:
    """All figures of one answerer."""
    kinds = {kind: [r for r in rows if r.kind == kind] for kind in ("control", "effect", "outside", "pair")}
    controls, effects, outside, pairs = kinds.values()
    twice = [r for r in effects if size_of(r) == 2.0]
    right = [r for r in [*effects, *pairs] if r.first]
    alarms = sum(r.alarm for r in controls)
    found = [
        _share("false alarms", [r.alarm for r in controls], goal=0.05, better="lower"),
        Figure(
            "false alarms, 95 % bound",
            upper_bound(alarms, len(controls)),
            float("nan"),
            float("nan"),
            len(controls),
            "share",
            0.05,
            "lower",
        ),
        _share("false alarms with a name", [r.named for r in controls], better="lower"),
        _over("detection, area under the curve", rows, _suspected, _separated(auroc)),
        _over("the same up to 5 % false alarms", rows, _suspected, _separated(early_auroc)),
        _share("effects found", [r.alarm for r in effects]),
        _over("named first, macro", effects, _hit("first"), _macro),
        _over("named first at twice the floor, macro", twice, _hit("first"), _macro, goal=0.75),
        _over("named or one of two at twice the floor, macro", twice, _hit("of_two"), _macro, goal=0.85),
        _over("named or one of two, macro", effects, _hit("of_two"), _macro),
        _over("likeliest name right, said or not, macro", effects, lambda r: (r.truth, r.rank == 1), _macro),
        _over("right among the two likeliest names, macro", effects, lambda r: (r.truth, r.rank <= 2), _macro),
        _over("macro F1 of names", effects, lambda r: (r.truth, r.said if r.named else None), _macro_f1),
        _share("named wrong", [r.named and not r.first for r in effects], better="lower"),
        _over("size found in 80 % of cases", effects, _sized("alarm"), _size_at, unit="floors"),
        _over("size named in 80 % of cases", effects, _sized("first"), _size_at, unit="floors"),
        _over("place F1", right, _place_f1, np.median, goal=0.80),
        _over("place and time F1", right, _place_time_f1, np.median),
        _over("place, distance", right, _distance, np.median, unit="m", better="lower"),
        _over("first cluster holds the place", right, _pinpointed, np.mean),
        _over("onset, difference", right, _onset, np.median, unit="frames", better="lower"),
        _over("amplitude, error", right, _amplitude_error, np.median, goal=0.20, better="lower", unit="share"),
        _over("amplitude, 90 % intervals that cover", right, _covered, np.mean),
        *(
            _over(f"share of the oracle's gain, {part}", effects, _gains(part), _ratio, goal=0.6 if part == "transfer" else None)
            for part in PARTS
        ),
        _over(
            "catalogued against outside, area under the curve",
            [*effects, *outside],
            lambda r: (r.kind == "outside", r.conviction),
            _separated(auroc),
            goal=0.90,
        ),
        _share("outside yet named", [r.named for r in outside], goal=0.10, better="lower"),
        _share("outside said to be unknown", [r.verdict == OTHER for r in outside]),
        _share("pairs, first name one of the two", [r.first for r in pairs]),
        _over("pairs, F1 of names", pairs, _pair_f1, np.mean),
        _over("calibration error", rows, _trusted, lambda some: expected_calibration_error(*_columns(some)), better="lower"),
        _over("Brier score", rows, _brier, np.mean, better="lower"),
        _over("area under risk and coverage", rows, _trusted, lambda some: risk_coverage(*zip(*some, strict=True)), better="lower"),
        _share("failed or missing answers", [r.verdict == "failed" for r in rows], better="lower"),
        _over("time of an answer", rows, lambda r: r.answer.get("seconds"), np.median, unit="s", better="lower"),
    ]
    return found


def size_of(row: Row) -> float:
    """The size of ``SIZES`` nearest to a case's, by ratio."""
    return min(SIZES, key=lambda s: abs(np.log(row.ratio / s))) if row.ratio > 0 else float("nan")


def _share(name, hits, **about):
    low, high = clopper_pearson(sum(hits), len(hits)) if hits else (float("nan"),) * 2
    return Figure(name, sum(hits) / len(hits) if hits else float("nan"), low, high, len(hits), "share", **about)


def _over(name, rows, number, pool, *, unit="", **about):
    """What ``pool`` makes of the ``number`` of every case that has one (not None); its interval is that of drawing these cases anew."""
    told = [v for r in rows if (v := number(r)) is not None]
    value = float(pool(told)) if told else float("nan")
    low, high = bootstrap(told, lambda some: float(pool(some))) if np.isfinite(value) else (float("nan"),) * 2
    return Figure(name, value, low, high, len(told), unit, **about)


def _hit(what):
    return lambda r: (r.truth, getattr(r, what))


def _macro(some):
    """Mean over effects of the share of their cases that are hit: an effect counts as much as another, however many cases it has."""
    groups: dict[str, list[bool]] = {}
    for truth, hit in some:
        groups.setdefault(truth, []).append(bool(hit))
    return np.mean([np.mean(g) for g in groups.values()])


def _macro_f1(some):
    true, said, hits = Counter(t for t, _ in some), Counter(n for _, n in some), Counter(t for t, n in some if n == t)
    return np.mean([2 * hits[n] / (true[n] + said[n]) for n in true])


def _sized(what):
    return lambda r: (r.ratio, getattr(r, what)) if np.isfinite(r.ratio) else None


def _columns(some):
    """Pairs as two lists."""
    first, second = zip(*some, strict=True)
    return first, second


def _size_at(some):
    return size_at(*_columns(some))


def _suspected(row):
    return row.kind == "control", row.suspicion


def _separated(area):
    """Area under the curve by which the second numbers of cases tell whether the first is false."""
    return lambda some: area([v for low, v in some if not low], [v for low, v in some if low])


def _trusted(row):
    name, chance = row.likeliest
    return chance, name in row.truths


def confidence(rows: Sequence[Row]) -> tuple[list[float], list[bool]]:
    """Probability of the likeliest reading of every case, and whether it is right."""
    return [_trusted(r)[0] for r in rows], [_trusted(r)[1] for r in rows]


def _brier(row):
    """Sum over names of the squared distance of probability from truth; of two effects either may be the one."""
    chances = row.probabilities
    true = max(row.truths, key=lambda n: chances.get(n, 0.0))
    return sum((p - (n == true)) ** 2 for n, p in chances.items()) + (true not in chances)


def _place(row):
    """Place of the truth and, where there is one, of the answer."""
    part = row.concealed
    there = part and part["place"][0]
    return (there, row.answer.get("where")) if there else (None, None)


def _place_f1(row):
    there, said = _place(row)
    if not there or not there.get("points"):  # nothing there, or in the room
        return None
    return overlap(said["points"], there["points"]) if said else 0.0


def _place_time_f1(row):
    """F1 of sets of particles and frames: what two rectangles share is the product of what their sides share."""
    there, said = _place(row)
    if not there or not there.get("points"):
        return None
    frames = row.label["frames"][0]
    begins = row.concealed["onset"][0]
    when = row.answer.get("when")
    if not said or not when or begins is None:
        return 0.0
    points = len(set(said["points"]) & set(there["points"]))
    times = max(0, min(when["frames"][1], frames) - max(when["frames"][0], begins))
    size = len(said["points"]) * (when["frames"][1] - when["frames"][0]) + len(there["points"]) * (frames - begins)
    return 2 * points * times / size


def _distance(row):
    there, said = _place(row)
    return float(np.linalg.norm(np.subtract(said["centroid"], there["centroid"]))) if there and said else None


def _pinpointed(row):
    """Whether the heaviest cluster of the misfit lies where the truth is."""
    there, _ = _place(row)
    clusters = (row.answer.get("evidence") or {}).get("clusters")
    if not there or clusters is None:
        return None
    if not clusters:
        return 0.0
    return float(np.linalg.norm(np.subtract(clusters[0]["centroid"], there["centroid"])) <= max(clusters[0]["radius"], there["radius"]))


def _onset(row):
    """Frames between the beginning that is said and the true one, of what begins after frame 0."""
    begins, when = (row.concealed or {}).get("onset", [None])[0], row.answer.get("when")
    return abs(when["frames"][0] - begins) if begins and when else None


def _amplitude_error(row):
    part = row.concealed
    if not part:
        return None
    true, said = row.true_amplitude(part)[0], amplitude(part["effect"], row.answer.get("parameters") or {})
    return abs(said / true - 1) if np.isfinite(true) and np.isfinite(said) and true else None


def _covered(row):
    """Whether the 90 % interval of an effect of one amplitude holds the true one, where physics tells it."""
    part = row.concealed
    if not part or row.true_amplitude(part)[1] != "physics":
        return None
    inner = [p.get("interval90") for n, p in (row.answer.get("parameters") or {}).items() if n in _amplitude_names(part["effect"])]
    true = row.true_amplitude(part)[0]
    if len(inner) != 1 or not inner[0]:
        return None
    low, high = (unbounded if end is None else end for end, unbounded in zip(inner[0], (-np.inf, np.inf), strict=True))
    return float(low <= true <= high or low <= -true <= high)  # late hands count as negative


def _amplitude_names(effect):
    return {
        n
        for term in catalogue()
        if term.stands_for().name == effect and len(term.stands_for().amplitudes) == 1
        for n in term.stands_for().amplitudes
    }


def _gains(part):
    """Error on ``part`` that an answer removes, and that who was told removes; None where the latter is next to nothing."""

    def gained(answer):
        one = ((answer or {}).get("fit") or {}).get(part) or {}
        if one.get("baseline") is None:
            return None, 1.0
        return one["baseline"] - (one["baseline"] if one.get("extended") is None else one["extended"]), one["baseline"]

    def number(row):
        most, baseline = gained(row.ceiling)
        return None if most is None or most <= CLOSABLE * baseline else (gained(row.answer)[0] or 0.0, most)

    return number


def of_the_ceiling(rows, part: str) -> float | None:
    """Error on ``part`` that the answers remove, over what those remove who were told; None where nobody was, or could remove any."""
    numbers = [one for one in map(_gains(part), rows) if one is not None]
    return _ratio(numbers) if numbers else None


def _ratio(some):
    return sum(g for g, _ in some) / sum(most for _, most in some)


def _pair_f1(row):
    said = {row.answer["effect"], *row.answer["alternatives"][:1]} if row.named else set()
    return overlap(said, row.truths)
