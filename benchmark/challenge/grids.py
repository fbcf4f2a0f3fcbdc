"""The tables behind the figures: power, names, calibration, and what was said of what."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...diagnosis.verdict import NONE
from .scores import SIZES, confidence, size_of
from .statistics import calibration_bins, clopper_pearson
from .truths import Row

__all__ = ["Grid", "grids"]


@dataclass(frozen=True)
class Grid:
    """A table: a title, the names of its columns, and rows of text."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def grids(rows: Sequence[Row]) -> list[Grid]:
    """Power by size and by what was foreseen, names by effect, body and engine, calibration, and what was said for what."""
    effects = [r for r in rows if r.kind == "effect"]
    sizes = [(f"{s:g}", [r for r in effects if size_of(r) == s]) for s in SIZES]
    bands = ((0, 0.5), (0.5, 1), (1, 2), (2, 4), (4, np.inf))
    known = [(r, r.foreseen) for r in effects]
    foreseen = [(f"{a:g} to {b:g}" if np.isfinite(b) else f"over {a:g}", [r for r, f in known if a <= f < b]) for a, b in bands]
    foreseen.append(("not known", [r for r, f in known if not np.isfinite(f)]))
    return [
        _power("Power by size, over what a twin of a sound body is off by", "size", sizes),
        _power("Power by size, over the smallest that the answer says would have stood out", "size", foreseen),
        _power("By effect", "effect", _groups(effects, lambda r: r.truth)),
        _parts("By body", "body", _groups(rows, lambda r: r.label["object"])),
        _parts("By engine", "engine", _groups(rows, lambda r: str(r.label.get("simulated_by", "-")))),
        *([_parts("By recordings that may be fitted", "recordings", many)] if len(many := _groups(rows, _recordings)) > 1 else []),
        _parts("By control", "control", _groups([r for r in rows if r.kind == "control"], lambda r: r.label["control"])),
        _reliability(rows),
        _confusion(rows),
    ]


def _recordings(row) -> str:
    return str(max(1, len(row.label.get("interactions") or ()) - 1))


def _groups(rows, key):
    names = sorted({key(r) for r in rows})
    return [(name, [r for r in rows if key(r) == name]) for name in names]


def _interval(hits):
    hits = list(hits)
    if not hits:
        return "-"
    low, high = clopper_pearson(sum(hits), len(hits))
    return f"{sum(hits)} of {len(hits)} ({low:.2f} to {high:.2f})"


def _power(title, what, groups):
    rows = [
        (name, str(len(some)), *(_interval([bool(hit(r)) for r in some]) for hit in _HITS))
        for name, some in groups
        if some or what == "size"
    ]
    return Grid(title, (what, "cases", "found", "named first", "or one of two", "named wrong"), tuple(rows))


_HITS = (lambda r: r.alarm, lambda r: r.first, lambda r: r.of_two, lambda r: r.named and not r.first)


def _parts(title, what, groups):
    rows = []
    for name, some in groups:
        controls, effects = ([r for r in some if r.kind == kind] for kind in ("control", "effect"))
        alarms = _interval([r.alarm for r in controls])
        rows.append((name, str(len(some)), alarms, _interval([r.alarm for r in effects]), _interval([r.first for r in effects])))
    return Grid(title, (what, "cases", "false alarms", "effects found", "named first"), tuple(rows))


def _reliability(rows):
    bins = calibration_bins(*confidence(rows)) if rows else []
    cells = tuple((f"{a:.1f} to {b:.1f}", str(n), f"{c:.2f}", f"{r:.2f}") for a, b, n, c, r in bins)
    return Grid("Calibration: the likeliest reading", ("probability", "cases", "mean", "right"), cells)


def _confusion(rows):
    """Truth by what was said, most frequent first."""
    table: dict[str, Counter] = {}
    for r in rows:
        true = NONE if r.kind == "control" else f"outside: {r.label['effect']}" if r.kind == "outside" else r.truth
        table.setdefault(true, Counter())[r.said] += 1
    cells = tuple((true, str(sum(c.values())), ", ".join(f"{n} {k}" for n, k in c.most_common())) for true, c in sorted(table.items()))
    return Grid("What was said of what", ("concealed", "cases", "said"), cells)
