"""What was published beside ours as published and ours corrected, with the differences in the digits that the paper prints.

A method is compared under its own name (corrected) and under that name with ``-as-published`` behind.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import groupby
from pathlib import Path
from textwrap import fill

from .cache import replacing
from .results import Results
from .table import Line, blocks, escape, laid_out, latex_table, markdown_table
from .text import cell, in_markdown

__all__ = ["AS_PUBLISHED", "Figure", "Ours", "compared", "terminal", "write_published"]

AS_PUBLISHED = "-as-published"
DECIMALS = 3  # at least, of the paper's figures, lengths in metres
WIDTH = 100  # characters of a terminal
COLUMNS = ("collection", "task", "method", "metric", "unit", "published")
LEGEND = (
    "Ours are rounded to the digits that the paper prints, and the differences are those of the rounded figures. As published: what the "
    "reference implementation executes; corrected: what its equations say. Both are scored by the same metrics, over n rows (recordings x "
    "seeds) or as many as stand behind a figure. The paper's Spring-Gaus is averaged over the recordings on which it succeeded."
)


@dataclass(frozen=True)
class Ours:
    """A mean [SI units] over ``count`` rows of the ``rows`` that were planned."""

    mean: float
    count: int
    rows: int

    @classmethod
    def of(cls, line: Line | None, metric: str) -> Ours | None:
        return cls(line.means[metric], line.counts[metric], line.rows) if line and line.counts[metric] else None


@dataclass(frozen=True)
class Figure:
    """One published figure [SI units] beside ours, None where ours was not run or has no score."""

    collection: str
    task: str
    method: str
    metric: str
    unit: str
    published: float
    as_published: Ours | None
    corrected: Ours | None

    @property
    def decimals(self) -> int:
        """How many the paper prints, lengths in metres."""
        return max(DECIMALS, -int(Decimal(str(self.published)).as_tuple().exponent))

    def rounded(self, value: float) -> Decimal:
        """``value`` with as many decimals.

        >>> Figure("c", "transfer", "phystwin", "chamfer", "m", 0.013, None, None).rounded(0.01262)
        Decimal('0.013')
        """
        return Decimal(f"{value:.{self.decimals}f}")

    def difference(self, ours: Ours) -> Decimal:
        """Ours less the published figure, both as printed."""
        return self.rounded(ours.mean) - self.rounded(self.published)

    def shown(self, value: Decimal, *, sign: bool = False) -> str:
        """As tables print it: lengths in millimetres."""
        value = value.scaleb(3) if self.unit == "m" else value
        return f"{value:+f}" if sign and value else f"{value:f}"


def compared(results: Results) -> list[Figure]:
    """Every published figure of a method that was run, in one of its two modes or both."""
    found = []
    for block in blocks(results):
        ours = {line.method: line for line in block.lines if not line.published}
        for (task, method, metric), value in results.published.get(block.collection, {}).items():
            lines = [ours.get(f"{method}{AS_PUBLISHED}"), ours.get(method)]
            if task == block.task and metric in block.metrics and any(lines):
                modes = [Ours.of(line, metric) for line in lines]
                found.append(Figure(block.collection, task, method, metric, results.units[metric], value, *modes))
    return found


@dataclass(frozen=True)
class _Table:
    caption: str
    header: tuple[str, ...]
    rows: list[list[str]]


def _tables(found: Sequence[Figure]) -> list[_Table]:
    header = ("method", "metric", "published", "as published", "difference", "corrected", "difference")
    tables = []
    for (collection, task), group in groupby(found, key=lambda figure: (figure.collection, figure.task)):
        figures = list(group)
        n = max((mode.rows for figure in figures for mode in (figure.as_published, figure.corrected) if mode), default=0)
        tables.append(_Table(f"{collection}, {task}: published and ours, n = {n}", header, [_row(figure, n) for figure in figures]))
    return tables


def _row(figure: Figure, n: int) -> list[str]:
    unit = {"m": " [mm]", "": ""}.get(figure.unit, f" [{figure.unit}]")
    cells = [figure.method, f"{figure.metric}{unit}", figure.shown(figure.rounded(figure.published))]
    for ours in (figure.as_published, figure.corrected):
        if ours is None:
            cells += ["-", "-"]
        else:
            cells.append(figure.shown(figure.rounded(ours.mean)) + (f" (n={ours.count})" if ours.count < n else ""))
            cells.append(figure.shown(figure.difference(ours), sign=True))
    return cells


def terminal(found: Sequence[Figure]) -> str:
    """The tables as aligned text."""
    parts = []
    for table in _tables(found):
        body = [[f"{text} " for text in row] for row in table.rows]
        parts.append("\n".join([table.caption, *laid_out([name.split() for name in table.header], body)]))
    return "\n\n".join([*parts, fill(LEGEND, WIDTH)])


def _markdown(found: Sequence[Figure]) -> str:
    parts = [
        f"**{in_markdown(table.caption)}**\n\n{markdown_table(table.header, [[*map(in_markdown, row)] for row in table.rows])}"
        for table in _tables(found)
    ]
    return "\n\n".join([*parts, LEGEND]) + "\n"


def _latex(found: Sequence[Figure]) -> str:
    parts = ["% needs \\usepackage{booktabs,graphicx}"]
    for table in _tables(found):
        methods = [list(rows) for _, rows in groupby(table.rows, key=lambda row: row[0])]
        parts.append(latex_table(table.caption, table.header, [[[*map(escape, row)] for row in rows] for rows in methods]))
    return "\n\n".join([*parts, rf"{{\footnotesize {escape(LEGEND)}}}"]) + "\n"


def _csv(found: Sequence[Figure], path: Path) -> None:
    """One line for each figure, in SI units, ours with all digits."""
    modes = ("as_published", "corrected")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*COLUMNS, *(f"{mode}{end}" for mode in modes for end in ("", "_difference", "_n", "_planned"))])
        for figure in found:
            line = [getattr(figure, name) for name in COLUMNS]
            for ours in (getattr(figure, mode) for mode in modes):
                line += [ours.mean, figure.difference(ours), ours.count, ours.rows] if ours else [""] * 4
            writer.writerow(map(cell, line))


def write_published(results: Results, folder: Path) -> list[Path]:
    """Write ``published.md``, ``.csv``, ``.tex`` and, where matplotlib is there, ``.png``; nothing where nothing published was run."""
    from .published_figure import draw, undrawable

    found = compared(results)
    if not found:
        return []
    writers = {
        "md": lambda path: path.write_text(_markdown(found), encoding="utf-8"),
        "csv": lambda path: _csv(found, path),
        "tex": lambda path: path.write_text(_latex(found), encoding="utf-8"),
    }
    written = [Path(folder) / f"published.{kind}" for kind in writers]
    for path, write in zip(written, writers.values(), strict=True):
        with replacing(path) as temporary:
            write(temporary)
    if not undrawable():
        written.append(Path(folder) / "published.png")
        draw(found, written[-1])
    return written
