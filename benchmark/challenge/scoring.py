"""Scoring an opened set: everybody's figures beside each other, and the whole story of one answerer."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from ...datasets.concealed.folder import Folder
from ...datasets.concealed.seal import write_json
from ..cache import replacing
from .book import entrants_of
from .grids import Grid, grids
from .history import History
from .opening import judged, opened_labels
from .schema import FAILED
from .scores import Figure, figures, with_floors
from .statistics import mcnemar
from .truths import Row

__all__ = ["Scored", "markdown", "score_set", "terminal", "write_scores"]

JUDGES = ("diagnosis", "continuum")  # the first who answered says what a twin of a sound body is off by, for all entrants alike
CEILING = "oracle"
SHOWN = 5  # failed answers of an entrant whose reasons are printed
# figures of everybody's table, and what its columns are called
COMPARED = {
    "false alarms": "alarms",
    "effects found": "found",
    "named first at twice the floor, macro": "named 2x",
    "named or one of two at twice the floor, macro": "of two 2x",
    "named wrong": "wrong",
    "place F1": "place",
    "amplitude, error": "amplitude",
    "share of the oracle's gain, heldout": "held-out gain",
    "share of the oracle's gain, transfer": "transfer gain",
    "catalogued against outside, area under the curve": "open set",
    "outside yet named": "outside named",
    "calibration error": "calibration",
}
Scored = Mapping[str, tuple[dict, list[Row], list[Figure]]]


def score_set(root: str | Path, *more: str | Path) -> Scored:
    """By entrant: its standing (see ``judged``), a row for every case, its figures; neither where its answers are gone or not trusted.

    Labels and answers are checked once more. A case without an answer, or with one that is not what was sealed or says nothing sensible,
    counts as one that refused. Of several sets, made and answered one after the other, all cases count as those of one, named SET/CASE.
    Raises ValueError where a set is still sealed or not what was published, where nothing was answered, or where two have one name.
    """
    folders = [Folder(Path(one)) for one in (root, *more)]
    sets = dict(zip((f"{folder.root.resolve().name}/" for folder in folders), map(_answered, folders), strict=True))
    if len(sets) < len(folders):
        raise ValueError(f"sets that are scored together must have names of their own, got {', '.join(str(f.root) for f in folders)}")
    if len(sets) == 1:
        sets = {"": next(iter(sets.values()))}
    names = list(dict.fromkeys(name for _, found in sets.values() for name in found))

    def answered(name) -> dict[str, dict]:
        """Its answers to all cases; none where those to one set are gone or not trusted."""
        own = {prefix: found[name][1] for prefix, (_, found) in sets.items() if name in found}
        if any(answers is None for answers in own.values()):
            return {}
        return {prefix + case: one.plain() for prefix, answers in own.items() for case, one in (answers or {}).items()}

    said = {name: answered(name) for name in names}
    told = said.get(CEILING, {})

    def rows(answers):
        labels = {prefix + case: label for prefix, (labels, _) in sets.items() for case, label in labels.items()}
        return [Row(case, label, answers.get(case, FAILED), told.get(case)) for case, label in labels.items()]

    judge = rows(next((said[name] for name in JUDGES if said.get(name)), {}))
    scored = {}
    for name, answers in said.items():
        own = with_floors(rows(answers), judge) if answers else []
        scored[name] = _standing([found[name][0] for _, found in sets.values() if name in found]), own, figures(own) if own else []
    return scored


def _answered(folder: Folder):
    """(labels by case, by entrant its standing and answers) of an opened set."""
    labels = opened_labels(folder)
    found = {name: judged(folder, name) for name in entrants_of(folder)}
    if not found:
        raise ValueError(f"{folder.root}: nobody has answered; twinbench challenge answer {folder.root}")
    return labels, found


def _standing(own: Sequence[dict]) -> dict:
    """Of one entrant in several sets: what it is in all of them, and why it is not in some."""
    if len(own) == 1:
        return own[0]
    why = [str(one["why"]) for one in own if "why" in one]
    whole = {"status": " / ".join(dict.fromkeys(one["status"] for one in own)), "answers": sum(one["answers"] for one in own)}
    return whole | ({"why": "; ".join(dict.fromkeys(why))} if why else {})


def compared(scored: Scored) -> Grid:
    """Everybody's main figures; and how likely a difference in right names from the first entrant is by chance (McNemar)."""
    first = _first(scored)

    def right(entrant):
        return [r.first for r in scored[entrant][1] if r.kind == "effect"]

    rows = []
    for entrant, (status, _, found) in scored.items():
        by_name = {f.name: f for f in found}
        differs = "-" if entrant == first or not found else f"{mcnemar(right(first), right(entrant)):.3f}"
        rows.append((entrant, *(_value(by_name[name]) if found else "-" for name in COMPARED), differs, status["status"]))
    return Grid("Everybody", ("entrant", *COMPARED.values(), "p", "status"), tuple(rows))


def _first(scored):
    """The first whose answers can be scored; the first where none can."""
    return next((name for name, (_, rows, _) in scored.items() if rows), next(iter(scored)))


def story(found: Sequence[Figure], name: str) -> Grid:
    """All figures of one answerer, with intervals, goals, and by how much a goal is missed."""
    header = ("figure", "value", "95 % interval", "cases", "goal", "")
    rows = []
    for f in found:
        goal = "" if f.goal is None else f"{'at least' if f.better == 'higher' else 'at most'} {f.goal:g}"
        verdict = {None: "", True: "reached", False: f"missed by {abs(f.value - (f.goal or 0)):.2f}"}[f.reached]
        rows.append((f.name, _value(f), _range(f), str(f.cases), goal, verdict))
    return Grid(f"All figures: {name}", header, tuple(rows))


def _value(f: Figure) -> str:
    return _number(f.value, f.unit) + (f" {_shown(f.unit)}" if _shown(f.unit) and np.isfinite(f.value) else "")


def _range(f: Figure) -> str:
    return f"{_number(f.low, f.unit)} to {_number(f.high, f.unit)}" if np.isfinite(f.low) and np.isfinite(f.high) else ""


def _number(value, unit):
    if not np.isfinite(value):
        return "-"
    return f"{1000 * value:.1f}" if unit == "m" else f"{value:.1f}" if unit in ("s", "frames") else f"{value:.3f}"


def _shown(unit):
    return {"m": "mm", "share": ""}.get(unit, unit)


def tables(scored: Scored) -> list[Grid]:
    """Everybody, then the first answerer at length."""
    first = _first(scored)
    _, rows, found = scored[first]
    return [compared(scored), story(found, first), *grids(rows)]


def terminal(scored: Scored, found: History) -> str:
    """The tables as aligned text, with what was ``found`` in the ledger."""
    parts = []
    for grid in tables(scored):
        widths = [max(map(len, column)) for column in zip(grid.header, *grid.rows, strict=True)]
        lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in (grid.header, *grid.rows)]
        rule = "-" * max(map(len, lines))
        parts.append("\n".join([grid.title, rule, lines[0], rule, *lines[1:], rule]))
    return "\n\n".join([*parts, *_standings(scored, found)])


def markdown(scored: Scored, found: History) -> str:
    """The tables in Markdown, with what was ``found`` in the ledger."""
    parts = []
    for grid in tables(scored):
        head = [grid.header, ("---",) * len(grid.header)]
        parts.append("\n".join([f"## {grid.title}", "", *("| " + " | ".join(row) + " |" for row in (*head, *grid.rows))]))
    return "\n\n".join([*parts, "\n".join(f"- {line}" for line in _standings(scored, found))]) + "\n"


def _standings(scored, found):
    lines = []
    for entrant, (status, rows, _) in scored.items():
        lines.append(f"{entrant}: {status['status']}, {status['answers']} answers" + (f" ({status['why']})" if "why" in status else ""))
        failed = [f"{r.name}: {r.answer['error']}" for r in rows if r.answer.get("error")]
        lines += [f"{entrant}: failed {one}" for one in failed[:SHOWN]]
        lines += [f"{entrant}: failed in {len(failed) - SHOWN} cases more, see score.json"] if len(failed) > SHOWN else []
    return [*lines, *(f"ledger: {note}" for note in found.notes), f"ledger: {found.entries} entries, head {found.head}"]


def write_scores(scored: Scored, found: History, out: str | Path) -> list[Path]:
    """Write ``score.md``, ``score.csv`` (a line for every figure of every entrant) and ``score.json``, each in one rename."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    text = io.StringIO()
    lines = [{"entrant": entrant, "status": status["status"], **_plain(f)} for entrant, (status, _, own) in scored.items() for f in own]
    columns = ["entrant", "status", *(f.name for f in fields(Figure)), "reached"]
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    for name, content in (("score.md", markdown(scored, found)), ("score.csv", text.getvalue())):
        with replacing(out / name) as temporary:
            temporary.write_text(content, encoding="utf-8")
    entrants = {entrant: {"standing": status, "figures": [_plain(f) for f in own]} for entrant, (status, _, own) in scored.items()}
    cases = [
        {"case": r.name, "entrant": entrant, "kind": r.kind, "truth": r.truth, "said": r.said, "verdict": r.verdict}
        | {"right": r.first, "size": _finite(r.ratio), "error": r.answer.get("error")}
        for entrant, (_, rows, _) in scored.items()
        for r in rows
    ]
    whole = {"ledger": asdict(found), "entrants": entrants, "cases": cases, "tables": [asdict(g) for g in tables(scored)]}
    write_json(out / "score.json", whole)
    return [out / "score.md", out / "score.csv", out / "score.json"]


def _plain(figure):
    return {k: _finite(v) if isinstance(v, float) else v for k, v in asdict(figure).items()} | {"reached": figure.reached}


def _finite(value):
    return float(value) if np.isfinite(value) else None
