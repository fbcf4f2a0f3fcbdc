"""A piece of work on its way to a worker on another machine and back, and what the worker looks at before it begins.

The worker must run the same code and see the same files: both are checked before every piece, and cost milliseconds.
"""

from __future__ import annotations

import logging
import os
import pickle
import platform
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path

from ...datasets.temporary import lasting
from .base import failed

__all__ = ["Place", "Unshared", "future_of", "pack", "perform", "place"]

PACKAGE = Path(__file__).resolve().parents[2]
ROOMS = ("datasets", "metrics", "physics", "methods", "diagnosis", "benchmark")


class Unshared(ValueError):
    """A worker does not see what it needs, or runs another twinbench."""


@dataclass(frozen=True)
class Place:
    """Where a command was called, and what its workers must find there.

    folder    working directory
    reads     files and folders that must be there
    marks     names that were just written into the folders in which workers write
    modules   where Python looks for modules
    code      digest of twinbench's own code
    level     level of the log
    """

    folder: str
    reads: tuple[str, ...]
    marks: tuple[str, ...]
    modules: tuple[str, ...]
    code: str
    level: int

    def enter(self) -> None:
        """Go there. Raises Unshared naming the path that is not seen here."""
        node = platform.node() or "worker"
        if code_digest() != self.code:
            raise Unshared(f"{node} runs another twinbench, from {PACKAGE}: install the same code there, and restart its workers")
        for path in (self.folder, *self.reads):
            if not os.path.exists(path):
                raise Unshared(f"{node} does not see {path}: workers need the file system of the command")
        for mark in self.marks:
            if not os.path.exists(mark):
                raise Unshared(f"{node} sees another {os.path.dirname(mark)} than the command: workers write there, so it must be shared")
        os.chdir(self.folder)
        sys.path += [path for path in self.modules if path not in sys.path]
        logging.getLogger("twinbench").setLevel(self.level)


@cache
def code_digest() -> str:
    """SHA-256 of all files of twinbench's own code, as they are when this is first asked."""
    seen = sha256()
    for file in sorted(file for room in ROOMS for suffix in ("py", "cu") for file in (PACKAGE / room).rglob(f"*.{suffix}")):
        seen.update(f"{file.relative_to(PACKAGE)}\n".encode() + file.read_bytes())
    return seen.hexdigest()


@contextmanager
def place(reads: Sequence = (), writes: Sequence = ()) -> Iterator[Place]:
    """The place of this command. As long as this lasts, each folder of ``writes`` holds a mark that a worker must see.

    Raises OSError where one of them cannot be written.
    """
    with ExitStack() as stack:
        marks = [stack.enter_context(lasting(Path(folder).resolve(), Path(folder) / "shared")) for folder in writes]
        level = logging.getLogger("twinbench").getEffectiveLevel()
        there = tuple(os.path.abspath(path) for path in reads)
        yield Place(os.getcwd(), there, tuple(map(str, marks)), tuple(map(os.path.abspath, sys.path)), code_digest(), level)


def pack(where: Place, piece: Callable[[], object]) -> bytes:
    """``piece`` for ``perform``. Raises as ``pickle.dumps`` does."""
    return pickle.dumps((where, pickle.dumps(piece)))


def perform(packed: bytes) -> bytes:
    """Do what was packed, in a process of its own; what comes of it, or what it raised, for ``future_of``."""
    try:
        where, piece = pickle.loads(packed)
        where.enter()
        return pickle.dumps((pickle.loads(piece)(), None))
    except Exception as error:
        error.add_note(f"On {platform.node()}:\n{traceback.format_exc()}")
        return pickle.dumps((None, _portable(error)))


def future_of(outcome: bytes) -> Future:
    """What ``perform`` returned, as a finished future. Raises Unshared where that is what the worker said."""
    value, error = pickle.loads(outcome)
    if isinstance(error, Unshared):
        raise error
    if error is not None:
        return failed(error)
    future: Future = Future()
    future.set_result(value)
    return future


def _portable(error: Exception) -> Exception:
    """``error``, or, where it cannot be sent, one that says the same."""
    try:
        pickle.loads(pickle.dumps(error))
        return error
    except Exception:  # an exception may refuse to be pickled in any way
        return RuntimeError(f"{type(error).__name__}: {error}")
