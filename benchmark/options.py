"""What options of the command line are checked for."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from pathlib import Path

__all__ = ["known", "writable"]


def known(kind: str, names: Iterable[str], choices: Iterable[str]) -> None:
    """Raises ValueError, with the nearest choice, where one of ``names`` is none."""
    from ..datasets.collection import nearest

    for name in names:
        if name not in choices:
            raise ValueError(f"unknown {kind} {name!r}; {nearest(name, choices)}")


def writable(path: Path, *, option: str = "--out") -> Path:
    """``path`` as a folder that can be written to, which is better known before hours of work than after."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise ValueError(f"{path}: not a folder that results can be written to ({error.strerror}); choose another with {option}") from error
    return path
