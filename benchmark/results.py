"""Rows on disk: Parquet and CSV with all provenance, the tables in Markdown and LaTeX, and what the numbers mean (``about.json``)."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..datasets.collection import Collection
from ..metrics.base import Metric
from .cache import replacing
from .folders import run_folder
from .text import cell, shown

if TYPE_CHECKING:
    import pandas

__all__ = ["Results", "read_results", "write_results"]

COLUMNS = ("collection", "method", "task", "scenario")  # without which rows are none of a run


@dataclass(frozen=True, repr=False)
class Results:
    """Rows, the units and directions of their metrics, and published figures beside them. Their text is as ``text.shown`` has it.

    published   {collection: {(task, method, metric): value in the metric's unit}}
    pooled      metrics whose means are over the frames of all recordings, not over recordings
    origin      how and when they came about: command line, options, commit, versions (see ``provenance.origin``)
    folder      where they were written, if they were
    """

    rows: Sequence[dict]
    units: Mapping[str, str]
    directions: Mapping[str, str]
    published: Mapping[str, Mapping[tuple[str, str, str], float]] = field(default_factory=dict)
    citations: Mapping[str, str] = field(default_factory=dict)
    pooled: Sequence[str] = ()
    origin: Mapping = field(default_factory=dict)
    folder: Path | None = None

    def __post_init__(self):
        for name in ("rows", "published", "citations", "origin"):
            object.__setattr__(self, name, _shown(getattr(self, name)))

    def __repr__(self):
        counts = (len({row[name] for row in self.rows}) for name in ("collection", "method"))
        return "Results({} rows of {} collections and {} methods; print them for the tables)".format(len(self.rows), *counts)

    def __str__(self):
        from .table import terminal

        return terminal(self)

    @property
    def frame(self) -> pandas.DataFrame:
        """All rows, one for each recording, method, task and seed; scores in SI units."""
        import pandas

        return pandas.DataFrame(list(self.rows), columns=_columns(self.rows))

    def table(self, task: str, collection: str | None = None) -> pandas.DataFrame:
        """The means of one table in SI units, by method; beside them how many ``rows`` there are, how many of them ``scored``, and
        ``fit_seconds``. Published figures follow, marked in ``published``.

        ``collection`` must be named where there are several. Raises ValueError for a table that is not there.
        """
        import pandas

        from .table import blocks

        found = {(block.collection, block.task): block for block in blocks(self)}
        names = list(dict.fromkeys(name for name, _ in found))
        if collection is None and len(names) > 1:
            raise ValueError(f"there are results of several collections; name one of {', '.join(names)}")
        wanted = (collection or next(iter(names), ""), task)
        if wanted not in found:
            raise ValueError(f"there is no table of {wanted[0]}, {task}; there are {', '.join(map(', '.join, found)) or 'none'}")
        block = found[wanted]
        lines = [
            {name: line.means[name] for name in self.units}
            | {"rows": line.rows, "scored": line.scored, "fit_seconds": line.fit_seconds, "published": line.published}
            for line in block.lines
        ]
        return pandas.DataFrame(lines, index=pandas.Index([line.method for line in block.lines], name="method"))

    @classmethod
    def of(cls, rows: Sequence[dict], metrics: Mapping[str, Metric], collections: Sequence[Collection]) -> Results:
        """The results of a run."""
        return cls(
            rows,
            {name: metric.unit for name, metric in metrics.items()},
            {name: metric.direction for name, metric in metrics.items()},
            {collection.name: dict(collection.published) for collection in collections},
            {collection.name: collection.citation for collection in collections},
            tuple(name for name, metric in metrics.items() if metric.pooled),
        )

    def beside(self, methods: Sequence[str] | None) -> Results:
        """The same with published figures of these methods only; None means all."""
        if methods is None:
            return self
        kept = {name: {key: v for key, v in found.items() if key[1] in methods} for name, found in self.published.items()}
        return replace(self, published=kept)


def write_results(results: Results, folder: Path) -> list[Path]:
    """Write ``rows.parquet``, ``rows.csv``, ``about.json``, ``table.md`` and ``table.tex``; each replaces its forerunner in one rename."""
    from .table import latex, markdown

    texts = {"about.json": json.dumps(_about(results), indent=1), "table.md": markdown(results), "table.tex": latex(results)}
    written = []
    for name, write in {"rows.parquet": _parquet, "rows.csv": _csv}.items():
        with replacing(Path(folder) / name) as temporary:
            write(results.rows, temporary)
        written.append(Path(folder) / name)
    for name, text in texts.items():
        with replacing(Path(folder) / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
        written.append(Path(folder) / name)
    return written


def read_results(folder: Path) -> Results:
    """What ``write_results`` wrote into the folder of a run, or the latest of a folder of runs.

    Raises ValueError where it is not there or damaged.
    """
    folder = run_folder(folder)
    for name in ("rows.parquet", "about.json"):
        if not (folder / name).is_file():
            raise ValueError(f"no results in {folder}: {name} is missing (twinbench run writes it)")
    try:
        import pyarrow.parquet

        rows = pyarrow.parquet.read_table(folder / "rows.parquet").to_pylist()
        about = json.loads((folder / "about.json").read_text(encoding="utf-8"))
        published = {name: {tuple(key): value for *key, value in found} for name, found in about["published"].items()}
        known = about["units"], about["directions"], published, about["citations"], tuple(about.get("pooled", ()))
        found = Results(rows, *known, about.get("run", {}), folder)
    except KeyError as error:
        raise ValueError(f"the results in {folder} cannot be read: about.json has no {error}") from error
    except (OSError, ValueError, TypeError, AttributeError) as error:  # pyarrow's errors are ValueErrors or OSErrors
        raise ValueError(f"the results in {folder} cannot be read: {error}") from error
    if missing := [name for name in COLUMNS if rows and name not in rows[0]]:
        raise ValueError(f"the results in {folder} cannot be read: rows.parquet has no column {missing[0]!r}")
    for name in (name for name in found.units if any(isinstance(row.get(name), str) for row in rows)):
        raise ValueError(f"the results in {folder} cannot be read: {name} must be numbers in rows.parquet, got text")
    return found


def _about(results: Results) -> dict:
    published = {name: [[*key, value] for key, value in found.items()] for name, found in results.published.items()}
    return {
        "units": dict(results.units),
        "directions": dict(results.directions),
        "published": published,
        "citations": dict(results.citations),
        "pooled": list(results.pooled),
        "run": dict(results.origin),
    }


def _shown(value):
    """``value`` with nothing in its text that acts on a terminal."""
    if isinstance(value, str):
        return shown(value)
    if isinstance(value, Mapping):
        return {_shown(key): _shown(one) for key, one in value.items()}
    return type(value)(map(_shown, value)) if isinstance(value, list | tuple) else value


def _columns(rows: Sequence[dict]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))


def _parquet(rows: Sequence[dict], path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    columns = {name: [row.get(name) for row in rows] for name in _columns(rows)}
    types = {name: pyarrow.int64() for name in columns if all(value is None for value in columns[name])}
    table = pyarrow.table({name: pyarrow.array(values, types.get(name)) for name, values in columns.items()})
    pyarrow.parquet.write_table(table, path)


def _csv(rows: Sequence[dict], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, _columns(rows), restval="")
        writer.writeheader()
        writer.writerows({name: cell(value) for name, value in row.items()} for row in rows)
