"""Opening files that other people made: regular files only, so that nothing hangs, and no more than they may hold."""

from __future__ import annotations

import json
import math
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from . import safe_pickle
from .findings import shown

__all__ = ["check_file", "load_pickle", "open_regular", "present", "read_bytes", "read_json"]

MAX_JSON = 2**24  # bytes; metadata of a recording is some kilobytes
MAX_DEPTH = 32  # nested lists and objects; intrinsics need 4
MAX_DIGITS = 18  # of an integer: what has more does not fit 64 bits
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket"}


def present(file: Path) -> bool:
    """Whether something is there by that name, be it a file that cannot be opened or a link that leads nowhere."""
    return os.path.lexists(file)


def check_file(file: Path) -> int:
    """Bytes of the regular file ``file``. Raises ValueError naming it where there is none, it cannot be reached or is something else."""
    try:
        return _size(file, os.stat(file))
    except OSError as failure:
        raise _unreadable(file, failure) from None


@contextmanager
def open_regular(file: Path, limit: int = 2**31) -> Iterator[BinaryIO]:
    """The regular file ``file`` of at most ``limit`` bytes, open for reading. Raises ValueError naming it."""
    try:
        # a named pipe would wait for its writer for ever: it is opened without waiting, and refused
        descriptor = os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        try:
            if (size := _size(file, os.fstat(descriptor))) > limit:
                raise ValueError(f"{file}: must hold at most {limit} bytes, got {size}")
            with open(descriptor, "rb", closefd=False) as stream:
                yield stream
        finally:
            os.close(descriptor)
    except OSError as failure:
        check_file(file)  # what cannot be opened may be a socket
        raise _unreadable(file, failure) from None


def read_bytes(file: Path, limit: int = 2**31) -> bytes:
    """The content of a regular file of at most ``limit`` bytes. Raises ValueError naming it."""
    with open_regular(file, limit) as stream:
        return stream.read(limit)


def load_pickle(file: Path):
    """What ``safe_pickle`` finds in a regular file. Raises ValueError naming it."""
    check_file(file)
    return safe_pickle.load(file)


def _size(file, about):
    if not stat.S_ISREG(about.st_mode):
        raise ValueError(f"{file}: must be a regular file, got {_KINDS.get(stat.S_IFMT(about.st_mode), 'something else')}")
    return about.st_size


def _unreadable(file, failure):
    if isinstance(failure, FileNotFoundError) and not present(file):
        return ValueError(f"{file}: missing")
    return ValueError(f"{file}: cannot be read ({failure.strerror or failure})")


def read_json(file: Path) -> dict:
    """The JSON object in ``file``, of finite numbers, with every key once.

    Raises ValueError naming the file, and the field, where it is missing, damaged, nested more than ``MAX_DEPTH`` deep, or holds a number
    that is not finite or has more than ``MAX_DIGITS`` digits.
    """
    data = read_bytes(file, MAX_JSON)
    try:
        value = json.loads(data.decode("utf-8"), object_pairs_hook=_once, parse_int=_integer)
    except RecursionError:
        raise ValueError(f"{file}: must be nested at most {MAX_DEPTH} deep, got more") from None
    except _Twice as twice:
        raise ValueError(f"{file}: {twice} must be given once, got it twice") from None
    except ValueError as failure:
        raise ValueError(f"{file}: not a JSON file ({failure})") from None
    if not isinstance(value, dict):
        raise ValueError(f"{file}: must hold a JSON object, got a {type(value).__name__}")
    if wrong := _wrong(value, ()):
        raise ValueError(f"{file}: {wrong}")
    return value


def _wrong(item, path):
    """What is wrong with ``item`` or anything in it, or "". It descends no deeper than it allows."""
    if len(path) > MAX_DEPTH:
        return f"{_named(path[:3])} must be nested at most {MAX_DEPTH} deep, got more"
    if isinstance(item, float) and not math.isfinite(item):
        return f"{_named(path)} must be a finite number of at most {MAX_DIGITS} digits, got {item}"
    for text in item if isinstance(item, dict) else [item] if isinstance(item, str) else ():
        if text.encode(errors="replace") != text.encode(errors="surrogatepass"):
            return f"{_named(path)} must be text, got half a character in {shown(text)}"
    inside = item.items() if isinstance(item, dict) else enumerate(item) if isinstance(item, list) else ()
    return next(filter(None, (_wrong(part, (*path, key)) for key, part in inside)), "")


class _Twice(Exception):
    """A key that an object has twice; of two values nobody knows which is meant."""


def _once(pairs):
    found = {}
    for key, value in pairs:
        if key in found:
            raise _Twice(shown(key))
        found[key] = value
    return found


def _integer(text):
    return int(text) if len(text) <= MAX_DIGITS else math.inf


def _named(path):
    """A field as one would write it: metadata.intrinsics[0][2]."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" if part.isidentifier() else f"[{shown(part)}]" for part in path)
    return "".join(parts).lstrip(".") or "the object"
