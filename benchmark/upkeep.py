"""Which entries of a cache nothing would use any more, and the removal of them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache as once
from functools import cached_property
from pathlib import Path

from .cache import Cache, Entry
from .opening import description_origin
from .options import SPLITS
from .origin import code_changes
from .sources import SOURCES

__all__ = ["Upkeep", "prune"]

DAY = 86400.0  # s


class Upkeep:
    """Says of each entry why nothing would use it: with the code that is installed, and the recordings where they were.

    What cannot be known counts as used: entries of scripts and of plug-ins that are not installed here, and of recordings whose folder was
    changed, but not read since.
    """

    def __init__(self, cache: Cache, *, older_than: float | None = None):
        self._cache, self._older_than = cache, older_than
        self._keys, self._known = once(_keys), once(self._checksums)

    def unused(self, entry: Entry) -> str:
        """The reason, or ""."""
        days = (time.time() - entry.stored) / DAY
        if not self._cache.sound(entry):
            return "damaged, or of another version"
        if self._older_than is not None and days > self._older_than:
            return f"older than {self._older_than:g} days"
        if entry.kind == "checksums":
            return "" if entry.key in self._listings else "its recordings changed"
        if entry.made is None:
            return ""
        return self._code(entry.made) or self._data(entry)

    def _code(self, made: dict) -> str:
        """Why another code would be used now, or ""."""
        old, now = made["inputs"].get("code", {}), SOURCES.present(*made["subject"].get("modules", ()))
        return "its code changed" if now is not None and code_changes(old, now) else ""

    def _data(self, entry: Entry) -> str:
        made = entry.made
        assert made is not None  # who comes here has asked
        folder, names = made["subject"].get("folder", ""), made["subject"].get("data", [])
        if not folder:
            return ""
        if not Path(folder).exists():
            return "its recordings are gone"
        if entry.kind == "collections":
            return "" if entry.key in self._keys(folder) else "its recordings changed"
        known = self._known(folder)
        changed = (known.get(name, value) != value for name, value in zip(names, made["inputs"]["data"], strict=False))
        return "its recordings changed" if any(changed) else ""

    def _checksums(self, folder: str) -> dict[str, str]:
        """What is known of the recordings in a folder as it is now."""
        known = [self._cache.read("checksums", key) or {} for key in self._keys(folder)]
        return {name: value for found in known for name, value in found.items()}

    @cached_property
    def _listings(self) -> set[str]:
        """Keys of the descriptions that are used."""
        return {entry.key for entry in self._cache.entries("collections") if not self.unused(entry)}


def _keys(folder: str) -> list[str]:
    """Keys of the descriptions of a folder as it is now."""
    return [description_origin(Path(folder), split).key for split in SPLITS]


def prune(cache: Cache, *, older_than: float | None = None, dry_run: bool = False) -> Iterator[tuple[str, int, str]]:
    """Remove what nothing would use, or what is older than so many days, and what killed runs left: kind, bytes and reason of each.

    Nothing is removed in a ``dry_run``.
    """
    for _, size in cache.sweep(dry=dry_run):
        yield "temporary", size, "left by a run that was killed"
    upkeep = Upkeep(cache, older_than=older_than)
    for entry in list(cache.entries()):
        if why := upkeep.unused(entry):
            if not dry_run:
                cache.drop(entry)
            yield entry.kind, entry.bytes, why
