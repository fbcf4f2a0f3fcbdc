"""Results of several runs and submissions as one: the same recordings, the same metrics, and each method told apart from the others."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from ..results import Results
from ..status import FAULTS

__all__ = ["Entry", "Gathered", "gather"]

NOT_SCORED = "it was not scored there"
LONGEST = 30  # characters of who submits, in a method's name


@dataclass(frozen=True)
class Entry:
    """One run or submission, the lines of tables that are from it, and where it comes from.

    kind        "run" or "submission"
    lines       (collection, method as tables name it)
    about       of a submission what ``submission.json`` says of itself, and its digest; of a run empty
    origin      how and when it was scored, see ``provenance.origin``
    checksums   {collection: {recording: data checksum}}
    devices     what it was scored on, and ``commits`` by which code of twinbench: rows of a cache may be older than the run
    """

    kind: str
    place: str
    lines: tuple[tuple[str, str], ...]
    about: Mapping
    origin: Mapping
    checksums: Mapping[str, Mapping[str, str]]
    devices: tuple[str, ...]
    commits: tuple[str, ...]

    @property
    def labels(self) -> list[str]:
        """Its methods, as tables name them."""
        return list(dict.fromkeys(label for _, label in self.lines))


@dataclass(frozen=True)
class Gathered:
    """``results`` with methods as tables name them, and the ``entries`` that they are from."""

    results: Results
    entries: tuple[Entry, ...]


def gather(found: Sequence[Results]) -> Gathered:
    """All of ``found`` as one. Results of a clean split are a collection of their own.

    A method that several of them have on one collection is named with where it comes from. Raises ValueError where two cannot be compared:
    by the content of a recording, or by what a metric means.
    """
    if not found:
        raise ValueError("a leaderboard needs at least one run or submission")
    found = [_split_apart(one) for one in found]
    units = _agreed(found, "units", lambda one: one.units)
    directions = _agreed(found, "directions", lambda one: one.directions)
    _agreed(found, "versions", lambda one: one.origin.get("metric_versions", {}))
    for what, column in {"data checksums": "data_checksum", "checksums of images": "images_checksum"}.items():
        _agreed(found, what, partial(_checksums, column))
    labels = _labels(found)
    rows, entries = [], []
    for number, one in enumerate(found):
        own = [_whole(row, units) | {"method": labels[number, row["collection"], row["method"]]} for row in one.rows]
        rows += own
        entries.append(_entry(one, own))
    pooled = tuple(name for name in units if any(name in one.pooled for one in found))
    published = {name: figures for one in found for name, figures in one.published.items()}
    citations = {name: text for one in found for name, text in one.citations.items()}
    return Gathered(Results(rows, units, directions, published, citations, pooled), tuple(entries))


def _split_apart(results: Results) -> Results:
    """The same with the name of the split in that of a collection, where it is not the published one."""
    named = {(row["collection"], row["split"]) for row in results.rows if row.get("split", "published") != "published"}
    if not named:
        return results
    new = {name: f"{name} ({split} split)" for name, split in named}
    rows = [{**row, "collection": new.get(row["collection"], row["collection"])} for row in results.rows]
    renamed = ({new.get(name, name): value for name, value in kept.items()} for kept in (results.published, results.citations))
    return replace(results, rows=rows, **dict(zip(("published", "citations"), renamed, strict=True)))


def _agreed(found: Sequence[Results], what: str, of) -> dict:
    """What all say of the same thing. Raises ValueError where two say otherwise, naming both."""
    said: dict = {}
    for one in found:
        for name, value in of(one).items():
            before, place = said.setdefault(name, (value, one.folder))
            if before != value:
                thing = " of ".join(reversed(name)) if isinstance(name, tuple) else name
                raise ValueError(f"{what} of {thing} must be the same everywhere, got {before} in {place} and {value} in {one.folder}")
    return {name: value for name, (value, _) in said.items()}


def _checksums(column: str, results: Results) -> dict[tuple[str, str], str]:
    """By collection and recording. A recording that could not be read has none; images that nobody looked at have none."""
    return {(row["collection"], row["scenario"]): row[column] for row in results.rows if row.get(column)}


def _whole(row: Mapping, metrics: Iterable[str]) -> dict:
    """The row with all metrics: those that were not asked for have no value."""
    missing = [name for name in metrics if name not in row]
    nothing = {f"{name}{end}": value for name in missing for end, value in (("", math.nan), ("_unscorable", 0), ("_reason", ""))}
    if row["status"] not in FAULTS:
        nothing |= {f"{name}_reason": NOT_SCORED for name in missing}
    return {**row, **nothing}


def _labels(found: Sequence[Results]) -> dict[tuple[int, str, str], str]:
    """What each method of a collection is called, by the number of its results: by its name, and where several have that, by its source."""
    places: dict[tuple[str, str], dict[int, None]] = {}
    for number, one in enumerate(found):
        for row in one.rows:
            places.setdefault((row["collection"], row["method"]), {})[number] = None
    labels: dict[tuple[int, str, str], str] = {}
    for (collection, method), numbers in places.items():
        sources = [_source(found[number]) for number in numbers]
        for k, (number, source) in enumerate(zip(numbers, sources, strict=True)):
            again = f", {sources[: k + 1].count(source)}" if source in sources[:k] else ""
            labels[number, collection, method] = f"{method} ({source}{again})" if len(numbers) > 1 else method
    return labels


def _source(results: Results) -> str:
    if about := results.origin.get("submission"):
        who = str(about.get("authors", ""))
        return f"submitted by {who if len(who) <= LONGEST else who[: LONGEST - 3] + '...'}"
    presets = ", ".join(dict.fromkeys(row["preset"] for row in results.rows if row.get("preset")))
    return f"run of {str(results.origin.get('started', ''))[:10] or 'unknown date'}, {presets}"


def _entry(results: Results, rows: Sequence[Mapping]) -> Entry:
    checksums: dict[str, dict[str, str]] = {}
    for (collection, recording), digest in _checksums("data_checksum", replace(results, rows=rows)).items():
        checksums.setdefault(collection, {})[recording] = digest
    about = results.origin.get("submission", {})
    lines = tuple(dict.fromkeys((row["collection"], row["method"]) for row in rows))
    devices, commits = (tuple(dict.fromkeys(str(row[name]) for row in rows if row.get(name))) for name in ("device", "commit"))
    return Entry("submission" if about else "run", str(results.folder or ""), lines, about, results.origin, checksums, devices, commits)
