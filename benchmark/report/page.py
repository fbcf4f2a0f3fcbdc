"""The report's HTML: tables and notes as text, everything else as data for its script. What comes from outside is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from string import Template

from ...diagnosis.page.document import asset, embedded, policy, script
from ..plan import TASKS
from ..results import Results
from ..table import Sheet, remarks, sheets
from .sorting import Cell, Head, sortable_table

__all__ = ["listed", "page"]

HERE = str(__package__)  # whose folder the files of this page are in

SHARED = ("drawing.js", "curve.js")


def page(results: Results, shown: Sequence[dict], methods: Mapping[str, str], notes: Iterable[str]) -> str:
    """The whole file. ``shown`` are exhibits as ``show`` gives them, ``methods`` says what each method is."""
    boards = sheets(results)
    code = script(*(asset(name) for name in SHARED), asset("sortable.js", HERE), asset("report.js", HERE))
    collections = list(dict.fromkeys(row["collection"] for row in results.rows))
    return Template(asset("report.html", HERE)).substitute(
        title=escape(f"Digital twins of {', '.join(collections)}"),
        policy=policy(code),
        style=asset("base.css") + asset("sortable.css", HERE) + asset("report.css", HERE),
        script=code,
        lead=escape(_lead(results)),
        tables="".join(map(_table, boards)),
        remarks=listed([*remarks(results), *notes]),
        methods=_methods(results, methods),
        origin=listed([*_origin(results), *filter(None, dict.fromkeys(results.citations.values()))]),
        data=embedded(
            {
                "shown": list(dict.fromkeys(metric for sheet in boards for metric in sheet.block.metrics)),
                "units": dict(results.units),
                "directions": dict(results.directions),
                "tasks": TASKS,
                "methods": list(dict.fromkeys(row["method"] for row in results.rows)),
                "exhibits": list(shown),
            }
        ),
    )


def _table(sheet: Sheet) -> str:
    """One table; its lines can be put in order of any column, published ones staying below ours."""
    lines = list(zip(sheet.block.lines, sheet.cells, strict=True))
    bodies = {"ours": [c for line, c in lines if not line.published], "published": [c for line, c in lines if line.published]}
    found = [(kind, [[_cell(*cell) for cell in cells] for cells in body]) for kind, body in bodies.items()]
    return f"<h3>{escape(sheet.caption)}</h3>{sortable_table(sheet.caption, [Head(name) for name in sheet.header], found)}"


def _cell(text: str, best: bool) -> Cell:
    return Cell(f"<strong>{escape(text.strip())}</strong>" if best else escape(text.strip()))


def _lead(results: Results) -> str:
    rows = results.rows
    scored = sum(row["status"] == "ok" for row in rows)
    seeds = sorted({row["seed"] for row in rows})
    parts = [
        _count(len({(row["collection"], row["scenario"]) for row in rows}), "recording"),
        _count(len({row["method"] for row in rows}), "method"),
        f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}",
        f"preset {', '.join(dict.fromkeys(row['preset'] for row in rows))}",
    ]
    return f"{', '.join(parts)}. {scored} of {_count(len(rows), 'row')} scored."


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _methods(results: Results, methods: Mapping[str, str]) -> str:
    names = dict.fromkeys(row["method"] for row in results.rows)
    said = (f"<div><dt>{escape(name)}</dt><dd>{escape((methods.get(name, '').splitlines() or [''])[0])}</dd></div>" for name in names)
    return f"<dl>{''.join(said)}</dl>"


def _origin(results: Results) -> list[str]:
    """When and by what the rows were computed."""
    kinds = {
        "device": "device",
        "commit": "commit",
        "twinbench": "twinbench",
        "torch": "torch",
        "warp": "warp",
        "numpy": "numpy",
        "split": "split",
    }
    found = {words: list(dict.fromkeys(str(row[name]) for row in results.rows if row.get(name))) for name, words in kinds.items()}
    dates = sorted(row["date"] for row in results.rows if row.get("date"))
    said = [f"{name}: {', '.join(values)}" for name, values in found.items() if values]
    return [*said, *([f"computed: {dates[0]}" + (f" to {dates[-1]}" if dates[-1] != dates[0] else "")] if dates else [])]


def listed(items: Iterable[str]) -> str:
    """A list of plain texts."""
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"
