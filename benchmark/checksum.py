"""What goes into the cache's keys: the content of recordings and the source code that worked on them.

Hashing recordings needs reading them, which takes longer than a cached run may; so the hashes of a folder's recordings are remembered
as long as none of its files changes.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ..datasets.scenario import Images, Scenario
from .cache import Cache, digest

__all__ = ["Checksums", "checksum", "code", "method_code"]

_PACKAGE = Path(__file__).resolve().parents[1]


def checksum(scenario: Scenario) -> str:
    """Hexadecimal SHA-256 of everything a scenario holds but its name and its images (which are read lazily)."""
    state = hashlib.sha256()
    _feed(state, {f.name: getattr(scenario, f.name) for f in fields(scenario) if f.name != "name"})
    return state.hexdigest()


def _feed(state, value) -> None:
    if isinstance(value, np.ndarray):
        state.update(f"{value.dtype.str}{value.shape}".encode())
        state.update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value) and not isinstance(value, Images):
        _feed(state, {f.name: getattr(value, f.name) for f in fields(value)})
    elif isinstance(value, dict):
        for key in sorted(value):
            state.update(f"<{key}>".encode())
            _feed(state, value[key])
    elif isinstance(value, tuple):
        _feed(state, {str(i): item for i, item in enumerate(value)})
    elif not isinstance(value, Images):
        state.update(f"{type(value).__name__} {value!r};".encode())


@cache
def code(*rooms: str) -> str:
    """Hexadecimal SHA-256 of every Python file in these rooms of the package, and of the numbers (JSON) that they read."""
    return _hash(sorted(file for room in rooms for kind in ("*.py", "*.json") for file in (_PACKAGE / room).rglob(kind)))


def method_code(method: Callable) -> str:
    """Hexadecimal SHA-256 of what a fit depends on: ``physics/``, ``methods/``, the method's own room, or a plug-in's own file."""
    shared = code(*dict.fromkeys(("physics", "methods", getattr(method, "room", "methods"))))
    try:
        file = Path(inspect.getsourcefile(method) or "").resolve()
    except TypeError:
        return shared
    return shared if not file.is_file() or _PACKAGE / "methods" in file.parents else digest(shared, _hash([file]))


def _hash(files) -> str:
    state = hashlib.sha256()
    for file in files:
        state.update(f"{file.name}\n".encode())
        state.update(file.read_bytes())
    return state.hexdigest()


class Checksums:
    """Checksums of recordings by name, remembered in ``cache`` under ``key`` where there is one."""

    def __init__(self, cache: Cache, key: str | None = None):
        self._cache, self._key = cache, key
        self._known: dict[str, str] = (cache.read("checksums", key) if key else None) or {}

    def learn(self, names: Iterable[str], load: Callable[[str], Scenario]) -> None:
        """Read with ``load`` those recordings whose checksums are not known yet."""
        unknown = [name for name in dict.fromkeys(names) if name not in self._known]
        for name in unknown:
            self._known[name] = checksum(load(name))
        if unknown and self._key is not None:
            self._cache.write("checksums", self._key, self._known)

    def __getitem__(self, name: str) -> str:
        return self._known[name]
