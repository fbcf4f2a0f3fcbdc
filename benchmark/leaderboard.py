"""The leaderboard of a run: every mean with its 95 % interval and over how many rows it is, the best in bold, published figures apart."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..datasets.catalogue import CITATION, PUBLISHED
from .cache import replacing
from .plan import TASKS
from .results import Results
from .table import Sheet, escape, latex_table, markdown_table, number, remarks, sheets
from .text import cell, in_markdown

__all__ = [
    "ELSEWHERE",
    "Board",
    "Interval",
    "board_cells",
    "boards",
    "elsewhere",
    "half_width",
    "leaderboard_csv",
    "leaderboard_latex",
    "leaderboard_markdown",
    "said_of_boards",
    "write_leaderboard",
]

FEWEST = 3  # recordings over which an interval says something: of two, Student's t reaches six times their distance
COLUMNS = (
    "collection",
    "task",
    "method",
    "published",
    "metric",
    "unit",
    "better",
    "mean",
    "interval95",
    "interval_over",
    "rows",
    "planned",
    "best",
)


def half_width(groups: Sequence[tuple[float, float]]) -> float:
    """Half of the 95 % interval of a mean by Student's t, from ``(weight, mean)`` of its groups; NaN of fewer than two.

    The mean is a ratio, the sum of weighted values over the sum of weights, and its variance is linearised: k/(k-1) sum w^2 (x - m)^2 /
    (sum w)^2 for k groups, which for equal weights is the usual s^2 / k.

    >>> round(half_width([(1, 1.0), (1, 2.0), (1, 3.0)]), 3)  # 4.303 * 1 / sqrt(3)
    2.484
    """
    from scipy.special import stdtrit

    k = len(groups)
    if k < 2:
        return math.nan
    total = sum(weight for weight, _ in groups)
    mean = sum(weight * x for weight, x in groups) / total
    variance = k / (k - 1) * sum((weight * (x - mean)) ** 2 for weight, x in groups) / total**2
    return float(stdtrit(k - 1, 0.975)) * math.sqrt(variance)


@dataclass(frozen=True)
class Interval:
    """Half of a mean's 95 % interval, NaN where there is none, over ``groups`` recordings or seeds."""

    half: float = math.nan
    groups: int = 0


@dataclass(frozen=True)
class Board:
    """One table: a sheet, intervals by (method, metric), and what they are ``over``: "recordings", "seeds", or "" where there are none."""

    sheet: Sheet
    over: str = ""
    intervals: dict[tuple[str, str], Interval] = field(default_factory=dict)

    @property
    def best(self) -> set[tuple[str, str]]:
        """(method, metric) of the best means."""
        block, directions = self.sheet.block, self.sheet.directions
        return {(method, metric) for metric in block.metrics for method in block.best(metric, directions[metric])}


def boards(results: Results) -> list[Board]:
    """The leaderboard, table by table.

    Intervals are over recordings, seeds averaged in each, and so speak of other recordings like these. With fewer than three recordings
    they are over seeds, recordings averaged in each, and say how well a mean repeats.
    """
    found = []
    for sheet in sheets(results):
        block = sheet.block
        rows = [row for row in results.rows if (row["collection"], row["task"]) == (block.collection, block.task)]
        recordings, seeds = (len({key(row) for row in rows}) for key in (_recording, _seed))
        over = "recordings" if recordings >= FEWEST else "seeds" if seeds > 1 else ""
        intervals = {}
        for line in block.lines if over else ():
            for metric in block.metrics if not line.published else ():
                ok = [row for row in rows if row["method"] == line.method and row["status"] == "ok" and not math.isnan(row[metric])]
                groups = _grouped(ok, metric, metric in results.pooled, _recording if over == "recordings" else _seed)
                intervals[line.method, metric] = Interval(half_width(groups), len(groups))
        found.append(Board(sheet, over, intervals))
    return found


def _recording(row: dict):
    return row["scenario"] if row["task"] != "transfer" else (row["sources"], row["scenario"])


def _seed(row: dict) -> int:
    return row["seed"]


def _grouped(rows: Iterable[dict], metric: str, pooled: bool, key) -> list[tuple[float, float]]:
    """(weight, mean) of each group, weighted as the table's means are: by frames where ``pooled``, else row by row."""
    sums: dict[object, list[float]] = {}
    for row in rows:
        weight = row["frames"] - row[f"{metric}_unscorable"] if pooled else 1
        into = sums.setdefault(key(row), [0.0, 0.0])
        into[0] += weight
        into[1] += weight * row[metric]
    return [(weight, total / weight) for weight, total in sums.values()]


def board_cells(board: Board) -> list[list[tuple[str, str, bool]]]:
    """Of every line its cells: text, half of the interval as text or "", and whether it is the best."""
    sheet, rows = board.sheet, []
    for line, cells in zip(sheet.block.lines, sheet.cells, strict=True):
        row = []
        for i, (text, best) in enumerate(cells):
            metric = sheet.block.metrics[i - 1] if 0 < i <= len(sheet.block.metrics) else ""
            interval = board.intervals.get((line.method, metric), Interval())
            row.append((text.strip(), "" if math.isnan(interval.half) else number(interval.half, sheet.units[metric]), best))
        rows.append(row)
    return rows


def said_of_boards(found: Sequence[Board], results: Results) -> list[str]:
    """What stands below the tables."""
    said = {
        "recordings": "after ±: half of the 95 % interval by Student's t over the recordings, seeds averaged in each",
        "seeds": "after ±: half of the 95 % interval by Student's t over the seeds, recordings averaged in each: how well the mean "
        f"repeats, not how it would be on other recordings, of which fewer than {FEWEST} are here",
        "": f"no intervals: fewer than {FEWEST} recordings and one seed",
    }
    tasks: dict[str, list[str]] = {}
    for board in found:
        tasks.setdefault(board.over, []).append(f"{board.sheet.block.collection}, {board.sheet.block.task}")
    first, *others = remarks(results)
    beside = dict.fromkeys(board.sheet.block.collection for board in found if any(line.published for line in board.sheet.block.lines))
    cited = [f"{name}: figures that others report are from {results.citations[name]}" for name in beside if results.citations.get(name)]
    over = [said[over] if len(tasks) == 1 else f"{'; '.join(where)}: {said[over]}" for over, where in tasks.items()]
    return [first, *map(_capital, over), *others, *cited]


def elsewhere(results: Results, methods: Sequence[str] | None) -> list[tuple[str, list[list[str]]]]:
    """The paper's tables as (caption, rows with a header) where no collection of the run has published figures beside its own."""
    if any(results.published.values()):
        return []
    known = {key: value for key, value in PUBLISHED.items() if methods is None or key[1] in methods}
    tables = []
    for task in dict.fromkeys(row["task"] for row in results.rows):
        figures = {(method, metric): value for (of, method, metric), value in known.items() if of == task}
        metrics = [metric for metric in results.units if any(key[1] == metric for key in figures)]
        if not metrics:
            continue
        units = {"m": " [mm]", "": ""}
        header = ["method", *(f"{m}{units.get(results.units[m], f' [{results.units[m]}]')}" for m in metrics)]
        rows = [
            [f"{method} (published)", *(_as_printed(figures[method, metric], results.units[metric]) for metric in metrics)]
            for method in dict.fromkeys(method for method, _ in figures)
        ]
        tables.append((f"Published, {task}: {TASKS[task]}", [header, *rows]))
    return tables


def _as_printed(value: float, unit: str) -> str:
    text = number(value, unit)
    return (
        text.rstrip("0").rstrip(".") if unit == "m" else text
    )  # lengths were published in whole millimetres, the rest with three decimals


ELSEWHERE = f"Published figures of other recordings, the paper's 22; they cannot be compared with those above. {CITATION}"


def leaderboard_markdown(results: Results, *, says: str = "", published: Sequence[str] | None = None) -> str:
    """The leaderboard in Markdown: the best in bold, published figures in italics, of these methods of the paper or all."""
    parts, found = ["# Leaderboard", *([says] if says else [])], boards(results)
    for board in found:
        rows = []
        for line, cells in zip(board.sheet.block.lines, board_cells(board), strict=True):
            marked = [(in_markdown(text), half, best) for text, half, best in cells]
            texts = [(f"**{text}**" if best else text) + (f" ± {half}" if half else "") for text, half, best in marked]
            rows.append([f"*{text}*" if text and line.published else text for text in texts])
        parts.append(f"## {in_markdown(board.sheet.caption)}\n\n{markdown_table(board.sheet.header, rows)}")
    parts.append("\n".join(f"- {in_markdown(said)}" for said in said_of_boards(found, results)))
    if tables := elsewhere(results, published):
        parts.append(f"## {ELSEWHERE.split(';')[0]}\n\n{ELSEWHERE}")
        parts += [f"**{caption}**\n\n{markdown_table(header, rows)}" for caption, (header, *rows) in tables]
    return "\n\n".join(parts) + "\n"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:] if text.startswith(("after", "no intervals")) else text


def leaderboard_latex(results: Results, *, says: str = "", published: Sequence[str] | None = None) -> str:
    """The leaderboard in LaTeX, to be put into a document with \\input; the best in bold, published figures below a rule."""
    parts, found = ["% needs \\usepackage{booktabs,graphicx}"], boards(results)
    for board in found:
        ours, theirs = [], []
        for line, cells in zip(board.sheet.block.lines, board_cells(board), strict=True):
            texts = [rf"\textbf{{{escape(text)}}}" if best else escape(text) for text, _, best in cells]
            texts = [text + (rf" $\pm$ {half}" if half else "") for text, (_, half, _) in zip(texts, cells, strict=True)]
            (theirs if line.published else ours).append(texts)
        parts.append(latex_table(board.sheet.caption, board.sheet.header, [ours, theirs]))
    notes = [*([says] if says else []), *said_of_boards(found, results)]
    tables = elsewhere(results, published)
    parts += [latex_table(caption, header, [[list(map(escape, row)) for row in rows]]) for caption, (header, *rows) in tables]
    notes += [ELSEWHERE] if tables else []
    items = "\n".join(rf"\item {escape(note)}" for note in notes).replace("/", r"/\allowbreak{}")
    parts.append(f"{{\\footnotesize\\sloppy\n\\begin{{itemize}}\n{items}\n\\end{{itemize}}\n}}")
    return "\n\n".join(parts) + "\n"


def leaderboard_csv(results: Results) -> str:
    """One line for each method and metric of each table, in SI units."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for board in boards(results):
        block = board.sheet.block
        for line in block.lines:
            for metric in block.metrics:
                if line.counts[metric]:
                    interval = board.intervals.get((line.method, metric), Interval())
                    numbers = line.means[metric], "" if math.isnan(interval.half) else interval.half
                    over = f"{interval.groups} {board.over}" if numbers[1] != "" else ""
                    counts = ("", "") if line.published else (line.counts[metric], line.rows)
                    named = (block.collection, block.task, line.method, line.published, metric, results.units[metric])
                    best = (line.method, metric) in board.best and not line.published
                    writer.writerow(map(cell, [*named, results.directions[metric], *numbers, over, *counts, best]))
    return text.getvalue()


def write_leaderboard(results: Results, folder: Path, *, says: str = "", published: Sequence[str] | None = None) -> list[Path]:
    """Write ``leaderboard.md``, ``leaderboard.csv`` and ``leaderboard.tex``; each replaces its forerunner in one rename.

    ``says`` is what the tables ask, ``published`` the methods of the paper that stand beside them (None means all).
    """
    texts = {
        "leaderboard.md": leaderboard_markdown(results, says=says, published=published),
        "leaderboard.csv": leaderboard_csv(results),
        "leaderboard.tex": leaderboard_latex(results, says=says, published=published),
    }
    for name, text in texts.items():
        with replacing(Path(folder) / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return [Path(folder) / name for name in texts]
