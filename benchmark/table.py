"""Tables of results: means over recordings and seeds, method by method, beside published figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from .plan import TASKS
from .results import Results
from .text import in_markdown

__all__ = [
    "Block",
    "Line",
    "Sheet",
    "blocks",
    "escape",
    "laid_out",
    "latex",
    "latex_table",
    "markdown",
    "markdown_table",
    "notes",
    "number",
    "remarks",
    "sheets",
    "terminal",
]


@dataclass(frozen=True)
class Line:
    """One method's means, and over how many rows each was taken; ``rows`` planned, ``scored`` of them with status ok."""

    method: str
    means: dict[str, float]
    counts: dict[str, int]
    rows: int = 0
    scored: int = 0
    fit_seconds: float = math.nan
    published: bool = False


@dataclass(frozen=True)
class Block:
    """One task of one collection: a table. ``equal`` are corrected metrics that say the same as those as published, and are left out."""

    collection: str
    task: str
    metrics: tuple[str, ...]
    lines: tuple[Line, ...]
    equal: tuple[str, ...] = ()

    def best(self, metric: str, direction: str) -> set[str]:
        """Methods with the best mean among those that were scored as often as any; none where there is nothing to compare."""
        ours = [line for line in self.lines if not line.published]
        most = max((line.counts[metric] for line in ours), default=0)
        full = {line.method: line.means[metric] for line in ours if line.counts[metric] == most > 0}
        if len(full) < 2:
            return set()
        value = min(full.values()) if direction == "lower" else max(full.values())
        return {method for method, mean in full.items() if mean == value}


def blocks(results: Results) -> list[Block]:
    """The tables, collection by collection and task by task. Metrics that score nothing in a task are left out."""
    found = []
    for collection in dict.fromkeys(row["collection"] for row in results.rows):
        for task in TASKS:
            rows = [row for row in results.rows if (row["collection"], row["task"]) == (collection, task)]
            if not rows:
                continue
            by_method: dict[str, list[dict]] = {}
            for row in rows:
                by_method.setdefault(row["method"], []).append(row)
            lines = [_line(method, rows, tuple(results.units), results.pooled) for method, rows in by_method.items()]
            lines += _published(results, collection, task)
            shown = tuple(metric for metric in results.units if any(line.counts.get(metric) for line in lines))
            equal = tuple(metric for metric in shown if _repeats(metric, lines))
            found.append(Block(collection, task, tuple(metric for metric in shown if metric not in equal), tuple(lines), equal))
    return found


CORRECTED = "_corrected"  # ends the name of a metric whose formula is applied as published under the name before it


def _repeats(metric: str, lines: Sequence[Line]) -> bool:
    """Whether a corrected metric says what the same metric says as published, in every line of ours."""
    published, ours = metric.removesuffix(CORRECTED), [line for line in lines if not line.published]
    if published == metric or any(published not in line.means for line in ours):
        return False
    return all(
        line.counts[metric] == line.counts[published] and (not line.counts[metric] or _same(line.means[metric], line.means[published]))
        for line in ours
    )


def _same(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=1e-9)  # sums of the same numbers in another order


def _line(method: str, rows: Sequence[dict], metrics: Sequence[str], pooled: Sequence[str]) -> Line:
    ok = [row for row in rows if row["status"] == "ok"]
    found = {metric: [row for row in ok if not math.isnan(row[metric])] for metric in metrics}
    means = {metric: _mean(metric, found[metric], metric in pooled) for metric in metrics}
    counts = {metric: len(found[metric]) for metric in metrics}
    fits = {(row["sources"], row["seed"]): row["fit_seconds"] for row in rows if math.isfinite(row["fit_seconds"])}
    seconds = sum(fits.values()) / len(fits) if fits else math.nan
    return Line(method, means, counts, len(rows), len(ok), seconds)


def _mean(metric: str, rows: Sequence[dict], pooled: bool) -> float:
    """Mean of a column over rows, or over all the frames that they were scored in."""
    weights = [row["frames"] - row[f"{metric}_unscorable"] if pooled else 1 for row in rows]
    return sum(weight * row[metric] for weight, row in zip(weights, rows, strict=True)) / sum(weights) if rows else math.nan


def _published(results: Results, collection: str, task: str) -> list[Line]:
    figures = {key: value for key, value in results.published.get(collection, {}).items() if key[0] == task and key[2] in results.units}
    lines = []
    for method in dict.fromkeys(method for _, method, _ in figures):
        means = {metric: figures.get((task, method, metric), math.nan) for metric in results.units}
        counts = {metric: int(math.isfinite(mean)) for metric, mean in means.items()}
        label = method if method.endswith(("(published)", "not run here)")) else f"{method} (published)"
        lines.append(Line(label, means, counts, published=True))
    return lines


def notes(results: Results) -> list[str]:
    """One sentence for every twin of which its method says something, for every group of rows that have no score, for every cause of
    values that are missing in the others, and for every appearance that twins are shown with, where it is not the corrected one for all.
    """
    groups: dict[tuple, list[dict]] = {}
    twins = {(row["collection"], row["method"], row["sources"], row["seed"]): row.get("note") for row in results.rows}
    for row in results.rows:
        if row["status"] not in ("ok", "unreadable"):
            frame = f" at frame {row['diverged_frame']}" if row["status"] == "diverged" else ""
            key = (row["collection"], row["task"], row["method"], row["status"])
            groups.setdefault(key, []).append({**row, "where": f"{row['scenario']}{frame}"})
    said = [
        f"{collection}: {method} on {sources}, seed {seed}: {note}" for (collection, method, sources, seed), note in twins.items() if note
    ]
    for (collection, task, method, status), rows in groups.items():
        reasons = list(dict.fromkeys(row["reason"] for row in rows))
        where = ", ".join(row["where"] for row in rows[:3]) + (f" and {len(rows) - 3} more" if len(rows) > 3 else "")
        said.append(f"{collection}, {task}: {method} {status} in {len(rows)} (not in the means): {where}: {'; '.join(reasons[:3])}")
    return said + _unreadable(results) + _without_value(results) + _left_out(results) + _shown(results)


def _shown(results: Results) -> list[str]:
    """One sentence for each collection whose twins are not all shown with the corrected appearance."""
    said = []
    for collection in dict.fromkeys(row["collection"] for row in results.rows):
        looks: dict[str, dict[str, None]] = {}
        for row in results.rows:
            if row["collection"] == collection and row.get("appearance"):  # results of before have no such column
                looks.setdefault(row["appearance"], {})[row["method"]] = None
        if set(looks) - {"corrected"}:
            said.append(f"{collection}, appearance in images: " + "; ".join(f"{look}: {', '.join(names)}" for look, names in looks.items()))
    return said


def _unreadable(results: Results) -> list[str]:
    """One sentence for each recording that could not be read."""
    lost: dict[tuple[str, str], int] = {}
    for row in results.rows:
        if row["status"] == "unreadable":
            lost[row["collection"], row["reason"]] = lost.get((row["collection"], row["reason"]), 0) + 1
    return [f"{collection}: {count} rows not scored (not in the means): {reason}" for (collection, reason), count in lost.items()]


def _without_value(results: Results) -> list[str]:
    """One sentence for each set of rows and metrics that have no value for the same reasons."""
    causes: dict[tuple, list[str]] = {}
    for collection in dict.fromkeys(row["collection"] for row in results.rows):
        ok = [row for row in results.rows if row["collection"] == collection and row["status"] == "ok"]
        for metric in results.units:
            empty = [i for i, row in enumerate(ok) if math.isnan(row[metric]) and row.get(f"{metric}_reason")]
            reasons = tuple(dict.fromkeys(ok[i][f"{metric}_reason"] for i in empty))
            if empty:
                causes.setdefault((collection, tuple(empty), len(ok), reasons), []).append(metric)
    return [
        f"{collection}: no {', '.join(metrics)} in {len(empty)} of {count} rows: {'; '.join(reasons[:3])}"
        for (collection, empty, count, reasons), metrics in causes.items()
    ]


def _left_out(results: Results) -> list[str]:
    """One sentence for each collection's columns that would repeat others, for all its tasks or by task."""
    tasks: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    found = blocks(results)
    for block in found:
        if block.equal:
            tasks.setdefault((block.collection, block.equal), []).append(block.task)
    counts = {collection: sum(block.collection == collection for block in found) for collection, _ in tasks}
    return [
        f"{collection}{'' if len(among) == counts[collection] else ', ' + ', '.join(among)}: {', '.join(equal)} not shown: "
        f"equal to {', '.join(metric.removesuffix(CORRECTED) for metric in equal)}"
        for (collection, equal), among in tasks.items()
    ]


@dataclass(frozen=True)
class Sheet:
    """A table as every format prints it: ``cells`` of each of the block's lines, as text and whether it is the best of its column.

    ``units`` and ``directions`` are those of all metrics.
    """

    block: Block
    caption: str
    header: tuple[str, ...]
    cells: tuple[tuple[tuple[str, bool], ...], ...]
    units: Mapping[str, str]
    directions: Mapping[str, str]


def sheets(results: Results) -> list[Sheet]:
    """All tables."""
    return [
        Sheet(
            block,
            _caption(block),
            tuple(_header(block, dict(results.units))),
            tuple(tuple(_cells(block, line, results)) for line in block.lines),
            results.units,
            results.directions,
        )
        for block in blocks(results)
    ]


def remarks(results: Results) -> list[str]:
    """What stands below the tables: how to read them, then ``notes``."""
    return [_legend(results), *notes(results)]


def _header(block: Block, units: dict[str, str]) -> list[str]:
    shown = {"m": " [mm]", "": ""}
    return ["method", *(metric + shown.get(units[metric], f" [{units[metric]}]") for metric in block.metrics), "n", "fit [s]"]


def _cells(block: Block, line: Line, results: Results) -> list[tuple[str, bool]]:
    """Text of each cell of a line, and whether it is the best of its column. Lengths in millimetres, as published where published."""
    cells = [(line.method, False)]
    for metric in block.metrics:
        mean, count = line.means[metric], line.counts[metric]
        if not count:
            cells.append(("-", False))
            continue
        text = number(mean, results.units[metric])
        if line.published:
            text = text.rstrip("0").rstrip(".").ljust(len(text))  # never more digits than were published, the point in its place
        elif count < line.scored:
            text += f" (n={count})"
        cells.append((text, line.method in block.best(metric, results.directions[metric])))
    n = "" if line.published else str(line.rows) if line.scored == line.rows else f"{line.scored} of {line.rows}"
    return [*cells, (n, False), ("" if math.isnan(line.fit_seconds) else f"{line.fit_seconds:.1f}", False)]


def number(value: float, unit: str) -> str:
    """A value as tables print it: lengths in millimetres."""
    return f"{value * 1e3:.2f}" if unit == "m" else f"{value:.3f}"


def _caption(block: Block) -> str:
    return f"{block.collection}, {block.task}: {TASKS[block.task]}"


def terminal(results: Results, *, width: int = 100) -> str:
    """The tables as aligned text; the best of a column carries an asterisk.

    Names of columns are stacked where lines exceed ``width``, and what is no length comes below the lengths where that is not enough.
    """
    parts = []
    for block in blocks(results):
        lines = _fitting(block, results, width)
        lengths = tuple(metric for metric in block.metrics if results.units[metric] == "m")
        others = tuple(metric for metric in block.metrics if metric not in lengths)
        if lengths and others and max(map(len, lines)) > width:
            lines = [line for part in (lengths, others) for line in _fitting(replace(block, metrics=part), results, width)]
        parts.append("\n".join([_caption(block), *lines]))
    return "\n\n".join([*parts, "\n".join([_legend(results), *notes(results)])])


def _fitting(block: Block, results: Results, width: int) -> list[str]:
    """Lines of one table, with the names of columns stacked where it would be wider than ``width``."""
    header = _header(block, dict(results.units))
    body = [[_aligned(text, best) for text, best in _cells(block, line, results)] for line in block.lines]
    lines = laid_out([name.split() for name in header], body)
    return lines if max(map(len, lines)) <= width else laid_out([name.replace("_", "_ ").split() for name in header], body)


def laid_out(names: Sequence[Sequence[str]], body: list[list[str]]) -> list[str]:
    """Lines of one table: the words of each column's name above each other, and rules."""
    height = max(len(words) for words in names)
    head = [[f"{word} " for word in row] for row in zip(*([""] * (height - len(words)) + list(words) for words in names), strict=True)]
    widths = [max(len(cell) for cell in column) for column in zip(*head, *body, strict=True)]
    above, below = ([_joined(row, widths) for row in rows] for rows in (head, body))
    rule = "-" * max(len(line) for line in (*above, *below))
    return [rule, *above, rule, *below, rule]


def _aligned(text: str, best: bool) -> str:
    return text + ("*" if best else " ")


def _joined(cells: Sequence[str], widths: Sequence[int]) -> str:
    first, *others = (cell.rjust(width) for cell, width in zip(cells, widths, strict=True))
    return "  ".join([cells[0].ljust(len(first)), *others]).rstrip()


def _legend(results: Results) -> str:
    shown = {metric for block in blocks(results) for metric in block.metrics}
    higher = [metric for metric, direction in results.directions.items() if direction == "higher" and metric in shown]
    better = "Lower is better" + (f", except {', '.join(higher)}" if higher else "")
    pooled = [metric for metric in results.pooled if metric in shown]
    frames = f", of {', '.join(pooled)} over all their frames" if pooled else ""
    return f"Means over n rows (recordings x seeds){frames}. {better}; marked: the best of the methods with most rows."


def markdown(results: Results) -> str:
    """The tables in Markdown; the best of a column is bold."""
    parts = []
    for block in blocks(results):
        cells = [[(in_markdown(text.strip()), best) for text, best in _cells(block, line, results)] for line in block.lines]
        rows = [[f"**{text}**" if best else text for text, best in row] for row in cells]
        table = markdown_table(_header(block, dict(results.units)), rows)
        parts.append(f"**{in_markdown(_caption(block))}**\n\n{table}")
    return "\n\n".join([*parts, _legend(results), *(f"- {in_markdown(note)}" for note in notes(results))]) + "\n"


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """One table. ``header`` is plain text, the cells of ``rows`` are Markdown; columns but the first are aligned on the right."""
    names, rule = [name.replace("|", r"\|") for name in header], ["---", *["---:"] * (len(header) - 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in [names, rule, *rows])


def latex(results: Results) -> str:
    """The tables in LaTeX (packages booktabs and graphicx); the best of a column is bold."""
    parts = ["% needs \\usepackage{booktabs,graphicx}"]
    for block in blocks(results):
        rows = [
            [f"\\textbf{{{escape(text)}}}" if best else escape(text.strip()) for text, best in _cells(block, line, results)]
            for line in block.lines
        ]
        parts.append(latex_table(_caption(block), _header(block, dict(results.units)), [rows]))
    return "\n\n".join(parts) + "\n"


def latex_table(caption: str, header: Sequence[str], groups: Sequence[Sequence[Sequence[str]]]) -> str:
    """One table with a rule above each of the ``groups`` of rows, whose cells are LaTeX; ``caption`` and ``header`` are plain text.

    Words of the header stand above each other, and what still is wider than the page is made smaller.
    """
    names = [r"\\".join(map(escape, name.replace("_", "_ ").split())) for name in header]
    lines = [" & ".join([names[0], *(rf"\shortstack[r]{{{name}}}" for name in names[1:])]) + r" \\"]
    for rows in groups:
        lines += [r"\midrule", *(" & ".join(row) + r" \\" for row in rows)] if rows else []
    begin = [r"\begin{table}", r"\centering\footnotesize\setlength{\tabcolsep}{3pt}", rf"\caption{{{escape(caption)}.}}"]
    begin += [r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%", rf"\begin{{tabular}}{{l{'r' * (len(header) - 1)}}}"]
    return "\n".join([*begin, r"\toprule", *lines, r"\bottomrule", r"\end{tabular}}", r"\end{table}"])


def escape(text: str) -> str:
    """``text`` for LaTeX. A bracket after the end of a line or an item would be an option of theirs: it stands in a group."""
    replaced = {"\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    replaced |= {"[": "{[}", "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "±": r"$\pm$"}
    return "".join(replaced.get(character, "\\" + character if character in "_%&#$" else character) for character in text)
