"""The leaderboard's HTML: a table for each data set and task, and where every line comes from. What comes from outside is escaped."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from string import Template

from ...datasets.temporary import replacing
from ...diagnosis.page.document import asset, policy, script
from ..leaderboard import ELSEWHERE, Board, Interval, board_cells, boards, elsewhere, said_of_boards
from ..plan import TASKS
from ..report.page import listed
from ..report.sorting import Cell, Head, sortable_table
from ..results import Results
from ..table import Line
from .gather import Gathered
from .provenance import entry_details, entry_id, entry_table

__all__ = ["page", "write_page"]

HERE = str(__package__)  # whose folder the files of this page are in

REPORT = "twinbench.benchmark.report"


def write_page(gathered: Gathered, path: str | Path) -> None:
    """Write the page, in one rename."""
    with replacing(Path(path)) as temporary:
        temporary.write_text(page(gathered), encoding="utf-8", errors="replace")


def page(gathered: Gathered) -> str:
    """The whole file."""
    results, found = gathered.results, boards(gathered.results)
    code = script(asset("sortable.js", REPORT), asset("leaderboard.js", HERE))
    links = {line: entry_id(number) for number, entry in enumerate(gathered.entries) for line in entry.lines}
    return Template(asset("leaderboard.html", HERE)).substitute(
        policy=policy(code),
        style=asset("base.css") + asset("sortable.css", REPORT) + asset("leaderboard.css", HERE),
        script=code,
        lead=escape(_lead(gathered)),
        collections=_options(dict.fromkeys(board.sheet.block.collection for board in found)),
        tasks=_options(task for task in TASKS if any(board.sheet.block.task == task for board in found)),
        metrics=_options(name for name in results.units if any(name in board.sheet.block.metrics for board in found)),
        tables="".join(_board(board, links) for board in found),
        remarks=listed([*said_of_boards(found, results), *_looks(results)]),
        entries=entry_table(gathered.entries),
        details="".join(entry_details(entry, entry_id(number)) for number, entry in enumerate(gathered.entries)),
        cited=_cited(results),
    )


def _lead(gathered: Gathered) -> str:
    rows = gathered.results.rows
    counts = {
        "method": len({row["method"] for row in rows}),
        "data set": len({row["collection"] for row in rows}),
        "recording": len({(row["collection"], row["scenario"]) for row in rows}),
        **{kind: sum(entry.kind == kind for entry in gathered.entries) for kind in ("run", "submission")},
    }
    said = [f"{number} {noun}{'s' * (number != 1)}" for noun, number in counts.items()]
    return f"{', '.join(said[:3])}; from {' and '.join(said[3:])}."


def _looks(results: Results) -> list[str]:
    """What to say of collections whose images were not all made with the same amount of work."""
    presets: dict[str, dict[str, dict]] = {}
    for row in results.rows:
        if row.get("appearance") and row.get("preset"):
            presets.setdefault(row["collection"], {}).setdefault(row["preset"], {})[row["method"]] = None
    return [
        f"{name}, metrics of images cannot be compared between appearances fitted with the presets "
        + "; ".join(f"{preset}: {', '.join(methods)}" for preset, methods in found.items())
        for name, found in presets.items()
        if len(found) > 1
    ]


def _options(names: Iterable[str]) -> str:
    return "".join(f"<option>{escape(name)}</option>" for name in names)


def _board(board: Board, links: Mapping[tuple[str, str], str]) -> str:
    """One table, sorted by its first metric; beside each method over how many rows it is."""
    sheet, block = board.sheet, board.sheet.block
    method, *titles, count, seconds = sheet.header
    metrics = [Head(title, {"data-metric": m, "data-better": sheet.directions[m]}) for m, title in zip(block.metrics, titles, strict=True)]
    heads = [Head(method), Head(count, {"data-better": "higher"}), *metrics, Head(seconds, {"data-cost": ""})]
    bodies: dict[str, list[tuple[Line, list[Cell]]]] = {"ours": [], "published": []}
    for line, cells in zip(block.lines, board_cells(board), strict=True):
        bodies["published" if line.published else "ours"].append((line, _cells(board, line, cells, links)))
    ordered = [(kind, [cells for _, cells in sorted(lines, key=partial(_order, board))]) for kind, lines in bodies.items()]
    told = f'data-collection="{escape(block.collection)}" data-task="{escape(block.task)}"'
    return f"<article {told}><h3>{escape(sheet.caption)}</h3>{sortable_table(sheet.caption, heads, ordered)}</article>"


def _order(board: Board, one: tuple[Line, list[Cell]]) -> tuple[int, float]:
    """By the first metric: the best first, then those with fewer rows, then those without a value."""
    line, metric = one[0], next(iter(board.sheet.block.metrics), "")
    mean = line.means.get(metric, math.nan)
    if math.isnan(mean):
        return 2, 0.0
    return int(_partial(board, line, metric)), mean if board.sheet.directions[metric] == "lower" else -mean


def _partial(board: Board, line: Line, metric: str) -> bool:
    """Whether a line of ours is over fewer rows than another."""
    most = max((other.counts[metric] for other in board.sheet.block.lines if not other.published), default=0)
    return not line.published and line.counts[metric] < most


def _cells(board: Board, line: Line, cells: Sequence[tuple[str, str, bool]], links: Mapping[tuple[str, str], str]) -> list[Cell]:
    block, link = board.sheet.block, links.get((board.sheet.block.collection, line.method))
    _, *means, (count, *_), (seconds, *_) = cells
    name = f'<a href="#{link}">{escape(line.method)}</a>' if link else escape(line.method)
    shown = [_mean(board, line, metric, *mean) for metric, mean in zip(block.metrics, means, strict=True)]
    rows = Cell(escape(count), {"data-value": "" if line.published else str(line.scored)})
    return [Cell(name), rows, *shown, Cell(escape(seconds))]


def _mean(board: Board, line: Line, metric: str, text: str, half: str, best: bool) -> Cell:
    """A mean; the cell carries its value and half of its interval in the table's unit, for the script."""
    sheet, mean = board.sheet, line.means[metric]
    if not line.counts[metric]:
        return Cell("-", {"data-value": ""})
    scale = 1e3 if sheet.units[metric] == "m" else 1.0
    interval = board.intervals.get((line.method, metric), Interval())
    about = {"data-value": repr(mean * scale)}
    if half:
        low, high = (scale * (mean + side * interval.half) for side in (-1, 1))
        about |= {
            "data-half": repr(interval.half * scale),
            "title": f"95 % interval {low:.4g} to {high:.4g}, over {interval.groups} {board.over}",
        }
    if _partial(board, line, metric):
        about |= {"data-partial": ""}
    shown = f"<strong>{escape(text)}</strong>" if best else escape(text)
    return Cell(shown + (f' <span class="half">± {escape(half)}</span>' if half else ""), about)


def _cited(results: Results) -> str:
    """What others published: where it is from, and the paper's tables where no collection here has figures of its own."""
    parts = [f"<p>{escape(text)}</p>" for text in dict.fromkeys(filter(None, results.citations.values()))]
    tables = elsewhere(results, None)
    parts += [f"<p>{escape(ELSEWHERE)}</p>"] if tables else []
    for caption, (header, *rows) in tables:
        lines = [[Cell(escape(text)) for text in row] for row in rows]
        parts.append(f"<h3>{escape(caption)}</h3>{sortable_table(caption, [Head(name) for name in header], [('published', lines)])}")
    return "".join(parts) or "<p>None.</p>"
