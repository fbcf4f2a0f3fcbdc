"""What an entry of the cache is made from: its key, and why it is another one than the last time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from .cache import FOLDERS, Cache, Entry, digest

__all__ = ["Forerunners", "Origin", "changes", "code_changes", "spoken"]

NAMED = 3  # files that a reason names; of more it says how many

SUBJECT, OPTIONS = ("method", "recordings", "collection", "target", "task"), ("seed", "preset", "device", "split", "look")


@dataclass(frozen=True)
class Origin:
    """What an entry is made from, JSON-able.

    inputs    all that its key covers: ``code``, digests by file; ``data``, a list of checksums; options
    subject   whose it is, which is not in the key: ``method``, ``recordings``, ``collection``; ``data``, what its inputs' checksums are of;
              ``modules`` whose code it is; ``folder`` of the recordings, "" where there is none
    """

    inputs: Mapping
    subject: Mapping

    @cached_property
    def key(self) -> str:
        """The name of the entry."""
        return digest(self.inputs)

    @property
    def made(self) -> dict:
        """What the entry keeps of this."""
        return {"inputs": self.inputs, "subject": self.subject}


def changes(before: Mapping, after: Mapping) -> str:
    """How ``after`` differs from ``before``, both what entries were ``made`` from: "physics/forward.py changed"; "" where it does not."""
    old, new = before["inputs"], after["inputs"]
    names, was, now = after["subject"].get("data", []), old.get("data", []), new.get("data", [])
    if len(was) == len(now):
        data = [f"{spoken(name)} changed" for name, one, other in zip(names, was, now, strict=True) if one != other]
    else:
        data = ["other images of the recordings are looked at"]
    options = ["the method's options changed"] if old.get("method") != new.get("method") else []
    shown = ["it is shown with other Gaussians"] if old.get("kind") != new.get("kind") else []
    metrics = ["a metric has another version, or can be had now or no longer"] if old.get("metrics") != new.get("metrics") else []
    return ", ".join([*data, *code_changes(old.get("code", {}), new.get("code", {})), *options, *shown, *metrics])


def code_changes(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """What happened to the code, given digests by file."""
    others = [file for file in new if file in old and old[file] != new[file]]
    changed = _listed([f"{file} ({old[file]}, now {new[file]})" if file.startswith("package ") else file for file in others])
    added, gone = _listed([file for file in new if file not in old]), _listed([file for file in old if file not in new])
    return [
        *([f"{changed} changed"] if changed else []),
        *([f"it now imports {added}"] if added else []),
        *([f"it no longer imports {gone}"] if gone else []),
    ]


def spoken(name: str) -> str:
    """What is looked at of a recording, in words: "images of plush_lift"."""
    return " of ".join(reversed(name.split("\n")))


def _listed(files: list[str]) -> str:
    more = len(files) - NAMED
    shown = files[:NAMED] + ([f"{more} more"] if more > 0 else [])
    return " and ".join(filter(None, (", ".join(shown[:-1]), *shown[-1:])))


class Forerunners:
    """The entries of one kind in a cache, read once when first asked about: which came before an origin's."""

    def __init__(self, cache: Cache, kind: str):
        self._cache, self._kind = cache, kind

    @cached_property
    def _known(self) -> list[Entry]:
        return sorted((entry for entry in self._cache.entries(self._kind) if entry.made), key=lambda entry: -entry.stored)

    def newest(self, origin: Origin) -> Entry | None:
        """The newest entry for the same method, recordings and options, or None."""
        return next((entry for entry in self._known if _what(entry.made or {}) == _what(origin.made)), None)

    def why(self, origin: Origin) -> str:
        """Why the entry is not there: what changed since the newest one like it; "" where there was none."""
        name = origin.key if self._kind in FOLDERS else f"{origin.key[:2]}/{origin.key}.json"
        if (self._cache.root / self._kind / name).exists():
            return "its entry in the cache is damaged"
        found = self.newest(origin)
        return changes(found.made or {}, origin.made) if found else ""


def _what(made: Mapping) -> list:
    """What entries have in common of which one replaces the other."""
    subject, inputs = made["subject"], made["inputs"]
    metrics = [name for name, *_ in inputs.get("metrics", ())]
    return [metrics, *(subject.get(name) for name in SUBJECT), *(inputs.get(name) for name in OPTIONS)]
