"""Two runs side by side: by how much each mean differs on the same recordings, with paired intervals, and what changed between them."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from .leaderboard import FEWEST, half_width
from .plan import TASKS
from .results import Results, read_results
from .table import laid_out, markdown_table, number
from .text import cell, in_markdown

if TYPE_CHECKING:
    import pandas

__all__ = ["Comparison", "Difference", "compare"]

COLUMNS = ("collection", "task", "method", "metric", "unit", "better", "a", "b", "difference", "interval95", "pairs", "interval_over")
HOW = (
    "A and B: means over the rows that both have, seeds averaged in each recording; B - A with half of its 95 % interval by Student's t "
    f"over the recordings' differences, none with fewer than {FEWEST} recordings. Marked: intervals without 0."
)


@dataclass(frozen=True)
class Difference:
    """One mean in both runs, in the metric's unit: ``a``, ``b``, and half of the 95 % interval of b - a over ``pairs`` recordings (NaN
    where there are too few).
    """

    collection: str
    task: str
    method: str
    metric: str
    a: float
    b: float
    half: float
    pairs: int

    @property
    def difference(self) -> float:
        """b - a."""
        return self.b - self.a

    @property
    def clear(self) -> bool:
        """Whether the interval excludes 0 by more than rounding."""
        return abs(self.difference) > self.half and not math.isclose(self.a, self.b, rel_tol=1e-9)  # False where there is no interval


@dataclass(frozen=True)
class Comparison:
    """What ``compare`` finds between the runs of these ``names``: differences, and sentences on the rest.

    only     on rows and metrics that one run has, or has a score of, and the other does not
    changed  on code, data, versions and options
    """

    names: tuple[str, str]
    differences: tuple[Difference, ...]
    units: Mapping[str, str]
    directions: Mapping[str, str]
    only: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()

    @property
    def frame(self) -> pandas.DataFrame:
        """The differences, in SI units."""
        import pandas

        return pandas.DataFrame([dict(zip(COLUMNS, values, strict=True)) for values in self._values()], columns=list(COLUMNS))

    def _values(self) -> Iterator[tuple]:
        for d in self.differences:
            over = "recordings" if math.isfinite(d.half) else ""
            what = d.collection, d.task, d.method, d.metric, self.units[d.metric], self.directions[d.metric]
            yield *what, d.a, d.b, d.difference, d.half, d.pairs, over

    def _tables(self) -> Iterator[tuple[str, list[str], list[list[str]]]]:
        """Caption, header and cells of each table."""
        for collection, task in dict.fromkeys((d.collection, d.task) for d in self.differences):
            rows = []
            for d in self.differences:
                if (d.collection, d.task) == (collection, task):
                    unit = self.units[d.metric]
                    shown = "mm" if unit == "m" else unit
                    half = "" if math.isnan(d.half) else f" ± {number(d.half, unit)}"
                    change = f"{'+' if d.difference >= 0 else ''}{number(d.difference, unit)}{half}{' *' if d.clear else ''}"
                    label = f"{d.metric} [{shown}]" if shown else d.metric
                    rows.append([d.method, label, number(d.a, unit), number(d.b, unit), change, str(d.pairs)])
            yield f"{collection}, {task}: {TASKS[task]}", ["method", "metric", "A", "B", "B - A", "recordings"], rows

    def _said(self) -> list[str]:
        if not self.differences:
            return ["Nothing can be paired: no recording, method, task and metric was scored in both runs.", *self.only, *self.changed]
        return [HOW, *self.only, *(self.changed or ("Code, data, versions and options are the same.",))]

    def terminal(self) -> str:
        """The tables as aligned text, and what changed below them."""
        parts = [f"A: {self.names[0]}\nB: {self.names[1]}"]
        for caption, header, rows in self._tables():
            parts.append("\n".join([caption, *laid_out([[name] for name in header], [[f"{text} " for text in row] for row in rows])]))
        return "\n\n".join([*parts, "\n".join(self._said())])

    __str__ = terminal

    def markdown(self) -> str:
        """The same in Markdown."""
        parts = [f"A: {in_markdown(self.names[0])}, B: {in_markdown(self.names[1])}"]
        for caption, header, rows in self._tables():
            parts.append(f"**{in_markdown(caption)}**\n\n{markdown_table(header, [[in_markdown(text) for text in row] for row in rows])}")
        return "\n\n".join([*parts, "\n".join(f"- {in_markdown(said)}" for said in self._said())]) + "\n"

    def csv(self) -> str:
        """The differences, one a line, in SI units."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(COLUMNS)
        for values in self._values():
            writer.writerow(cell("" if isinstance(value, float) and math.isnan(value) else value) for value in values)
        return text.getvalue()


def compare(a: Results | str | PathLike, b: Results | str | PathLike) -> Comparison:
    """How run ``b`` differs from run ``a``: results, folders of runs, or folders above them (then the latest run in each).

    A row is paired with the row of the same collection, task, recording, sources, method and seed. Raises ValueError where a folder holds
    no results.
    """
    found = [one if isinstance(one, Results) else read_results(Path(one)) for one in (a, b)]
    first, second = (str(one.folder or "results in memory") for one in found)
    rows = [{_key(row): row for row in one.rows} for one in found]
    metrics = [name for name in found[0].units if found[1].units.get(name) == found[0].units[name]]
    return Comparison(
        (first, second),
        tuple(_differences(rows[0], rows[1], metrics, found[0])),
        {name: found[0].units[name] for name in metrics},
        {name: found[0].directions[name] for name in metrics},
        tuple(_alone(rows, found)),
        tuple(_changes(rows, found)),
    )


def _key(row: Mapping) -> tuple:
    return tuple(row[name] for name in ("collection", "task", "scenario", "sources", "method", "seed"))


def _differences(a: Mapping, b: Mapping, metrics: Iterable[str], results: Results) -> Iterator[Difference]:
    both = [key for key in a if key in b and a[key]["status"] == b[key]["status"] == "ok"]
    tables: dict[tuple[str, str, str], list[tuple]] = {}
    for key in both:
        collection, task, _, _, method, _ = key
        tables.setdefault((collection, task, method), []).append(key)
    for (collection, task, method), keys in tables.items():
        for metric in metrics:
            pairs = _pairs([(a[key], b[key]) for key in keys], metric, metric in results.pooled)
            if pairs:
                weights = [weight for weight, _, _ in pairs]
                mean_a, mean_b = (sum(pair[0] * pair[k] for pair in pairs) / sum(weights) for k in (1, 2))
                half = half_width([(weight, y - x) for weight, x, y in pairs]) if len(pairs) >= FEWEST else math.nan
                yield Difference(collection, task, method, metric, mean_a, mean_b, half, len(pairs))


def _pairs(rows: Iterable[tuple[Mapping, Mapping]], metric: str, pooled: bool) -> list[tuple[float, float, float]]:
    """(weight, mean in A, mean in B) of each recording, seeds averaged; ``pooled`` metrics are weighted by the frames that count."""
    sums: dict[tuple, list[float]] = {}
    for a, b in rows:
        if math.isnan(a[metric]) or math.isnan(b[metric]):
            continue
        weight = min(row["frames"] - row[f"{metric}_unscorable"] for row in (a, b)) if pooled else 1
        into = sums.setdefault((a["sources"], a["scenario"]), [0.0, 0.0, 0.0])
        for k, value in enumerate((1.0, a[metric], b[metric])):
            into[k] += weight * value
    return [(weight, x / weight, y / weight) for weight, x, y in sums.values() if weight]


def _alone(rows: list[dict], results: list[Results]) -> Iterator[str]:
    """Sentences on what one run has and the other has not."""
    for name, own, other in (("A", rows[0], rows[1]), ("B", rows[1], rows[0])):
        groups: dict[tuple[str, str], int] = {}
        for key, row in own.items():
            if key not in other:
                groups[row["collection"], row["method"]] = groups.get((row["collection"], row["method"]), 0) + 1
        for (collection, method), count in groups.items():
            yield f"Only in {name}: {count} rows of {method} on {collection}"
        lost = [row for key, row in own.items() if row["status"] == "ok" and key in other and other[key]["status"] != "ok"]
        for row in lost:
            said = other[_key(row)]
            yield (
                f"Scored in {name} only: {row['method']} on {row['scenario']} ({row['collection']}, {row['task']}, seed {row['seed']}): "
                f"{said['status']} in the other: {said['reason']}"
            )
    for name, own, other in (("A", *results), ("B", *reversed(results))):
        if metrics := [metric for metric in own.units if metric not in other.units]:
            yield f"Only in {name}: the metrics {', '.join(metrics)}"


def _changes(rows: list[dict], results: list[Results]) -> Iterator[str]:
    """Sentences on what is not the same in both: data, code, versions, options."""
    both = [(rows[0][key], rows[1][key]) for key in rows[0] if key in rows[1]]
    data = {(a["collection"], a["scenario"]) for a, b in both if a["data_checksum"] != b["data_checksum"]}
    if data:
        yield f"Data changed: {', '.join(f'{name} ({collection})' for collection, name in sorted(data))}"
    code = {a["method"] for a, b in both if a["code_checksum"] != b["code_checksum"]}
    if code:
        yield f"Code changed of {', '.join(sorted(code))}"
    for column in ("commit", "twinbench", "device", "python", "numpy", "torch", "warp", "preset", "split"):
        values = [sorted({str(row.get(column) or "none") for row in own.values()}) for own in rows]
        if values[0] != values[1]:
            yield f"{column}: {', '.join(values[0])} in A, {', '.join(values[1])} in B"
    origins = [one.origin for one in results]
    for part in ("plugins", "options"):
        first, second = (origin.get(part, {}) for origin in origins)
        for name in dict.fromkeys((*first, *second)):
            if name not in ("preset", "device", "split", "jobs") and first.get(name) != second.get(name):
                yield f"{part.removesuffix('s')} {name}: {_said(first.get(name))} in A, {_said(second.get(name))} in B"


def _said(value) -> str:
    return (", ".join(map(str, value)) if isinstance(value, list) else str(value or "")) or "none"
