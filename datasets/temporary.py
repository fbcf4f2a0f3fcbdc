"""Files that appear whole or not at all, and the sweeping of what killed processes left of them.

What is being written has a temporary name, and its writer holds a lock on it, which the system lets go of when the process ends, however it
ends. So who comes next can tell what was left over from what is in use, whatever process or container wrote it.
"""

from __future__ import annotations

import os
import re
import shutil
import stat
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # no such locks: left-overs are told by their age
    fcntl: Any = None

__all__ = ["idle", "lasting", "locked", "remove", "replacing", "scratch", "sweep"]

HOUR = 3600.0  # s
DAY = 86400.0  # s; longer than any write of a live process, where it cannot be asked whether it lives
_NAME = re.compile(r"\..*\.[0-9a-f]{32}(\.part)?")  # without .part: of versions that held no lock


@contextmanager
def replacing(path: Path, *, through: Path | None = None) -> Iterator[Path]:
    """A temporary file that takes the place of ``path`` in one rename, or is removed if anything goes wrong.

    It lies beside ``path``, or in the folder ``through`` on the same disk; left-overs there are swept. Raises OSError naming ``path`` where
    the disk refuses.
    """
    folder = through or path.parent
    with _naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(parents=True, exist_ok=True)
        sweep(folder)
        with _held(folder, path.name, _create) as temporary:
            yield temporary
            temporary.replace(path)


@contextmanager
def scratch(folder: Path, path: Path) -> Iterator[Path]:
    """A temporary folder in ``folder``, in which what shall be ``path`` is prepared, and which is removed with what is left in it.

    Left-overs in ``folder`` are swept. Raises OSError naming ``path`` where the disk refuses.
    """
    with _naming(path):
        folder.mkdir(parents=True, exist_ok=True)
        sweep(folder)
        with _held(folder, path.name, _create_folder) as temporary:
            yield temporary


@contextmanager
def lasting(folder: Path, path: Path) -> Iterator[Path]:
    """As ``scratch``, for the time of a whole command: it stays for days, also where a disk has no locks and left-overs are told by their
    age; and errors in the block are not the disk's.
    """
    made, done = scratch(folder, path), threading.Event()
    temporary = made.__enter__()

    def touch() -> None:
        while not done.wait(HOUR):
            with suppress(OSError):
                os.utime(temporary)

    threading.Thread(target=touch, daemon=True).start()
    try:
        yield temporary
    finally:
        done.set()
        made.__exit__(None, None, None)


def sweep(folder: Path, *, dry: bool = False) -> list[tuple[Path, int]]:
    """Remove the temporary files and folders in ``folder`` that nobody is writing, unless ``dry``; which, and the bytes in each."""
    try:
        found = [folder / entry.name for entry in os.scandir(folder) if _NAME.fullmatch(entry.name)]
    except OSError:
        return []
    swept = []
    for left in found:
        with suppress(OSError), idle(left) as unused:
            if unused:
                swept.append((left, size(left)))
                if not dry:
                    remove(left)
    return swept


def size(path: Path) -> int:
    """Bytes in a file, or in all files below a folder. Links are not followed."""
    folder = not path.is_symlink() and path.is_dir()
    total = 0
    for file in [Path(root) / name for root, _, names in os.walk(path) for name in names] if folder else [path]:
        with suppress(OSError):
            total += file.lstat().st_size
    return total


def remove(path: Path) -> None:
    """Remove whatever is at ``path``; nothing happens where nothing is, or where it cannot be removed."""
    with suppress(OSError):
        if stat.S_ISDIR(path.lstat().st_mode):
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Nobody else is in such a block for ``folder`` at the same time, where the disk has locks."""
    if fcntl is None:
        yield
        return
    found = os.open(folder, os.O_RDONLY)
    try:
        _lock(found)
        yield
    finally:
        os.close(found)


def _lock(found: int) -> None:
    with suppress(OSError):  # a disk without locks
        fcntl.flock(found, fcntl.LOCK_EX)


@contextmanager
def _held(folder: Path, name: str, create) -> Iterator[Path]:
    """A new temporary name in ``folder``, locked as long as this lasts and gone afterwards."""
    while True:
        temporary = folder / f".{name[:150]}.{uuid.uuid4().hex}.part"
        found = create(temporary)
        if found is None:
            break
        _lock(found)
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(found), os.lstat(temporary)):
                break
        os.close(found)  # swept before it was locked
    try:
        yield temporary
    finally:
        remove(temporary)
        if found is not None:
            os.close(found)


def _create(temporary: Path) -> int | None:
    found = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    if fcntl is not None:
        return found
    return os.close(found)  # where there are no such locks, a file that is open cannot be renamed


def _create_folder(temporary: Path) -> int | None:
    while True:
        temporary.mkdir()
        if fcntl is None:
            return None
        with suppress(FileNotFoundError):  # swept before it was opened
            return os.open(temporary, os.O_RDONLY)


@contextmanager
def idle(left: Path) -> Iterator[bool]:
    """Whether nobody is writing ``left`` any more, and nobody can begin to as long as this lasts."""
    old = time.time() - left.lstat().st_mtime > DAY
    if not left.name.endswith(".part") or fcntl is None:
        yield old
        return
    found = os.open(left, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        try:
            fcntl.flock(found, fcntl.LOCK_EX | fcntl.LOCK_NB)
            unused = True
        except BlockingIOError:
            unused = False
        except OSError:  # a disk without locks
            unused = old
        yield unused
    finally:
        os.close(found)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """A full disk does not say which file it was."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, f"{path} cannot be written ({error.strerror or error}); nothing of it was kept") from error
