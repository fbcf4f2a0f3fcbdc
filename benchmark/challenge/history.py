"""What the ledger of a set proves: how much of it is what was published, and what looks wrong in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise

from ...datasets.concealed.folder import Folder
from ...datasets.concealed.seal import HASH, digest
from .book import Answers, entrants_of

__all__ = ["History", "histories", "history"]


@dataclass(frozen=True)
class History:
    """head: hash of the last of ``entries`` entries, to be published; notes: what was found, in sentences."""

    head: str
    entries: int
    notes: tuple[str, ...]


def history(folder: Folder, published: str | None = None) -> History:
    """The ledger of ``folder``, checked against the head that was ``published``, if one is given.

    Raises ValueError where the chain is broken, the ledger belongs to another set, or has no entry with that head: it was cut or rewritten.
    """
    entries, notes = folder.history(), []
    if published is None:
        notes.append("no published head was given: that nothing was cut off or written anew rests on whoever held the ledger (--head)")
    else:
        if not HASH.fullmatch(published):
            raise ValueError(f"--head must be 64 of 0-9 a-f, as it was published, got {published!r}")
        place = next((k for k, e in enumerate(entries, 1) if e["hash"] == published), None)
        if place is None:
            count = "1 entry" if len(entries) == 1 else f"{len(entries)} entries"
            raise ValueError(f"{folder.ledger.file}: has {count}, none with the head {published}: it was cut or written anew")
        since = ", ".join(e["event"] for e in entries[place:]) or "nothing"
        notes.append(f"up to entry {place} of {len(entries)}, whose head was published, all is as it was then; added since: {since}")
    times = [_time(e) for e in entries]
    for k, (one, later) in enumerate(pairwise(times), 2):
        if later < one:
            notes.append(f"entry {k} is dated before entry {k - 1}: a clock was wrong, or a date was chosen")
    if folder.ledger.unfinished:
        notes.append("the last line is half-written, by a process that was killed or by who cut it; the next entry takes its place")
    return History(entries[-1]["hash"], len(entries), (*notes, *_copies(folder)))


def histories(folders: Sequence[Folder]) -> History:
    """Those of several sets: what was found in each, by its name."""
    found = {folder.root.resolve().name: history(folder) for folder in folders}
    notes = tuple(f"{name}: {note}" for name, one in found.items() for note in one.notes)
    return History(", ".join(one.head for one in found.values()), sum(one.entries for one in found.values()), notes)


def _time(entry):
    found = datetime.fromisoformat(entry["time"])
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def _copies(folder):
    """Entrants whose answers say the same of every case."""
    cases, seen = list(folder.published()["cases"]), {}
    for name in entrants_of(folder):
        found = Answers(folder, name).read(cases)
        if len(found) > 1:
            same = {case: {k: v for k, v in one.plain().items() if k != "seconds"} for case, one in found.items()}
            seen.setdefault(digest(same), []).append(name)
    return [f"{' and '.join(names)} gave the same answers to every case" for names in seen.values() if len(names) > 1]
