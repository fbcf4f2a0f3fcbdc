"""Opening pickles from other people: numpy arrays, dicts, lists, tuples and scalars come out; nothing in the file is ever run.

A pickle is a program. Here it is read by a machine that knows the opcodes of data alone (``pickle_machine``), and what it makes is
weighed before it is handed on, so that no size, depth or sharing in a file can crash, hang or exhaust what uses it.
"""

from __future__ import annotations

import stat
from pathlib import Path

import numpy as np

from .pickle_arrays import Refused
from .pickle_machine import Machine

__all__ = ["array_of", "load", "numbers_of"]

MAX_BYTES = 2**31  # of a file
BUDGET = 64 << 20  # bytes that any file may make
BUDGET_PER_BYTE = 16  # and as many more for each byte of it: a pair of small integers, 6 in a file, takes 90 in Python
MAX_DEPTH = 100  # levels of nesting
_NUMBERS = (bool, int, float)


def load(path: str | Path):
    """The object in the pickle at ``path``: numpy arrays and scalars, dict, list, tuple, str, bytes, int, float, bool, None.

    Keys of dicts are str, int, float, bytes, bool or None. What comes out is nested at most 100 levels deep and takes, also with all
    that it shares written out, at most 16 times the file and 64 MiB.
    Raises ValueError, naming the file, where it cannot be read, is damaged, or asks for anything else.
    """
    path = Path(path)
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            raise ValueError(f"{path}: cannot be read (not a file)")
        if about.st_size > MAX_BYTES:
            raise ValueError(f"{path}: must hold at most {MAX_BYTES} bytes, got {about.st_size}")
        data = path.read_bytes()
    except (OSError, MemoryError) as error:
        raise ValueError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or type(error).__name__})") from error
    machine = Machine(data, BUDGET + BUDGET_PER_BYTE * len(data))
    try:
        result = machine.run()
        _Scale(machine.budget).weigh(result)
        return result
    except Refused as error:
        raise ValueError(f"{path}: refused, {_said(error)}; a case may hold only numpy arrays, dicts, lists and scalars") from None
    except Exception as error:  # a damaged program can fail in any way
        raise ValueError(f"{path}: not a complete pickle ({machine.where()}: {_said(error)})") from None


def _said(error):
    """What an error says, with what a terminal might obey spelled out: names and numbers in it are the file's."""
    text = (str(error) or type(error).__name__)[:300]
    return text if text.isprintable() else ascii(text)[1:-1]


class _Scale:
    """Weighs data with all that it shares written out, in time proportional to what there is. Raises Refused over ``limit`` bytes."""

    def __init__(self, limit: int):
        self.limit, self.known = limit, {}  # id: (levels, bytes), or None while under way

    def weigh(self, item, depth: int = 0) -> tuple[int, int]:
        """Levels of nesting and bytes of ``item``. What is no data, is too deep or contains itself is refused."""
        kind = type(item)
        if kind in _NUMBERS or item is None:
            return 0, 8
        if kind in (str, bytes):
            return 0, 8 + len(item)
        if isinstance(item, np.generic) or (kind is np.ndarray and not item.dtype.hasobject):
            return 0, 100 + item.size * max(item.itemsize, 8)  # beside floats in a list, numpy makes floats of bools
        if kind not in (dict, list, tuple, np.ndarray):
            raise Refused(f"it holds a {kind.__name__}")
        if id(item) not in self.known:
            self.known[id(item)] = None
            self.known[id(item)] = self._weigh_parts(item, depth + 1)
        if self.known[id(item)] is None:
            raise Refused("it contains itself")
        return self.known[id(item)]

    def _weigh_parts(self, item, depth):
        levels, size = 0, 56
        for part in _parts(item) if depth <= MAX_DEPTH else ():
            if type(part) in _NUMBERS:  # most are
                size += 8
                continue
            inner = self.weigh(part, depth)
            levels, size = max(levels, inner[0]), size + inner[1]
        if max(depth, levels + 1) > MAX_DEPTH:
            raise Refused(f"it is nested more than {MAX_DEPTH} levels deep")
        if size > self.limit:
            raise Refused(f"it takes more than {self.limit} bytes with all that it shares written out, too much for its size")
        return levels + 1, size


def _parts(item):
    """All that a container holds."""
    if type(item) is dict:
        return (part for pair in item.items() for part in pair)
    return item.flat if type(item) is np.ndarray else item


def array_of(value, file: str | Path, name: str) -> np.ndarray:
    """``value``, which must be an array of numbers. Raises ValueError naming the file and, as ``name``, what it holds there."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
        raise ValueError(f"{file}: {name} must be an array of numbers, got {_kind(value)}")
    return value


def numbers_of(value, file: str | Path, name: str) -> np.ndarray:
    """As ``array_of``, but ``value`` may also be lists of numbers or of such arrays, nested, equally long."""
    if foreign := _foreign([value], set()):
        raise ValueError(f"{file}: {name} must be an array of numbers or lists of them, got {_kind(*foreign)}")
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"{file}: {name} must be lists of equally many numbers ({error})") from None
    return array_of(array, file, name)


def _foreign(parts, seen):
    """The first of ``parts``, and of the lists among them, that is no number, in a tuple of its own; empty where all are."""
    for part in parts:
        if type(part) in (list, tuple):
            if id(part) not in seen:
                seen.add(id(part))
                if found := _foreign(part, seen):
                    return found
        elif type(part) not in _NUMBERS and not (isinstance(part, (np.ndarray, np.generic)) and part.dtype.kind in "biuf"):
            return (part,)
    return ()


def _kind(value):
    if isinstance(value, np.ndarray):
        return f"one of type {value.dtype}"
    return "None" if value is None else f"a {type(value).__name__}"
