"""The ledger of a sealed set: what was done with it and when, in lines to which is only added."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from .seal import HASH, NAME, content, digest, parsed

__all__ = ["GENESIS", "Ledger"]

GENESIS = "0" * 64
# what an entry of each event says, beside its time and its place in the chain; "rival" is an entrant: hashes cover the old word
COUNT = re.compile("[0-9]{1,9}")
EVENTS = {"made": {"root": HASH}, "answered": {"rival": NAME, "root": HASH, "answers": COUNT}, "opened": {"set": HASH}}


@dataclass(frozen=True)
class Ledger:
    """A file of JSON lines to which is only added. Every line holds the hash of the line before it, so that none can be changed or left out
    without all later hashes changing; whoever knows the last one (``head``) can tell. Lines that are cut off at the end only show so.
    """

    file: Path

    def read(self) -> list[dict]:
        """All entries, oldest first; a last line that was being written when the process was killed is none.

        Raises ValueError naming the line at which the chain is broken, or that is no entry.
        """
        return self._read()[0]

    @property
    def unfinished(self) -> bool:
        """Whether the last line is half-written; the next entry takes its place."""
        return self._read()[1] is not None

    @property
    def head(self) -> str:
        """The hash of the last entry: what is to be published beside what it says."""
        return ([{"hash": GENESIS}] + self.read())[-1]["hash"]

    def append(self, event: str, **about) -> dict:
        """Add an entry and return it. Raises ValueError where the chain is broken already, or for what is no entry."""
        Path(self.file).parent.mkdir(parents=True, exist_ok=True)
        with Path(self.file).open("a+b") as stream, _alone(stream):
            entries, unfinished = self._read()
            if unfinished is not None:
                stream.truncate(unfinished)
            before = entries[-1]["hash"] if entries else GENESIS
            entry = {"event": event, "time": datetime.now(UTC).isoformat(timespec="seconds"), **about, "before": before}
            _check(entry, self.file)
            entry |= {"hash": digest(entry)}
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - 1))
            open_line = stream.read() not in (b"", b"\n")
            stream.write(b"\n" * open_line + json.dumps(entry, ensure_ascii=False, allow_nan=False).encode() + b"\n")
            stream.flush()
            os.fsync(stream.fileno())
        return entry

    def _read(self):
        """The entries, and where in the file an unfinished line begins (None: nowhere)."""
        if not Path(self.file).exists():
            return [], None
        data = content(self.file)
        *lines, rest = data.split(b"\n")
        if rest and not _is_json(rest):
            return self._entries(lines), len(data) - len(rest)
        return self._entries(lines + [rest] * bool(rest)), None

    def _entries(self, lines):
        entries, before = [], GENESIS
        for number, line in enumerate(lines, 1):
            try:
                entry = parsed(line)
                told = entry.pop("hash")
            except (ValueError, KeyError, AttributeError, TypeError):
                raise ValueError(f"{self.file}: line {number} is no entry of a ledger") from None
            if entry.get("before") != before or digest(entry) != told:
                raise ValueError(f"{self.file}: line {number} was changed, or a line before it is missing: the chain of hashes is broken")
            _check(entry, f"{self.file}: line {number}")
            entries.append(entry | {"hash": told})
            before = told
        return entries


def _is_json(line):
    try:
        parsed(line)
    except ValueError:
        return False
    return True


def _check(entry, line):
    known = EVENTS.get(entry.get("event")) if isinstance(entry.get("event"), str) else None
    if known is None:
        raise ValueError(f"{line}: event must be one of {', '.join(EVENTS)}, got {entry.get('event')!r}")
    try:
        datetime.fromisoformat(entry.get("time"))
    except (TypeError, ValueError):
        raise ValueError(f"{line}: time must be a date and time (ISO 8601), got {entry.get('time')!r}") from None
    for key, pattern in known.items():
        kind = int if pattern is COUNT else str
        if type(entry.get(key)) is not kind or not pattern.fullmatch(str(entry[key])):
            raise ValueError(f"{line}: {key} must be {pattern.pattern}, got {entry.get(key)!r}")


@contextmanager
def _alone(stream) -> Iterator[None]:
    """Nobody else adds meanwhile; a process that is killed holds nothing up."""
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    fcntl.flock(stream, fcntl.LOCK_EX)
    try:
        yield
    finally:
        fcntl.flock(stream, fcntl.LOCK_UN)
