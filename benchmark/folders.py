"""Where results go: every run into a folder of its own, named by when it began, with ``latest`` beside it. Nothing is written over."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from datetime import datetime
from pathlib import Path

from ..datasets.temporary import scratch

__all__ = ["LATEST", "name_for", "publish", "run_folder"]

LATEST = "latest"
LONGEST = 100  # characters of a folder's name: systems allow 255


def name_for(collections: Iterable[str], experiment: str = "") -> str:
    """The name of the folder of all runs on these recordings.

    >>> name_for(["cable (a)", "cable (b)"], "stages")
    'cable-a+cable-b-stages'
    """
    names = [re.sub(r"[^\w.]+", "-", name).strip("-.") or "recordings" for name in dict.fromkeys(collections)]
    joined = "+".join(names)
    if len(joined) > LONGEST:
        joined = f"{names[0][:LONGEST]}+{len(names) - 1}-more" if len(names) > 1 else joined[:LONGEST]
    return "-".join(filter(None, (joined, experiment)))


def publish(place: Path, began: datetime, write: Callable[[Path], object]) -> Path:
    """The new folder in ``place``, named by the time that a run ``began``, with all that ``write(folder)`` writes; it appears whole.

    Raises OSError where the disk refuses, and leaves nothing behind then.
    """
    place = Path(place)
    with scratch(place, place / LATEST) as temporary:
        folder, link = temporary / "run", temporary / LATEST
        folder.mkdir()
        write(folder)
        final = _moved(folder, place / began.strftime("%Y-%m-%d_%H-%M-%S"))
        try:
            link.symlink_to(final.name, target_is_directory=True)
        except (OSError, NotImplementedError):  # where there are no links: a text file with the name
            link.write_text(f"{final.name}\n", encoding="utf-8")
        link.replace(place / LATEST)
    return final


def _moved(temporary: Path, wanted: Path) -> Path:
    """Where the folder is now: where it is ``wanted``, or, where another run began in the same second, with a number behind."""
    number, final = 1, wanted
    while True:
        try:
            if not final.exists():  # an empty folder would be replaced
                return temporary.rename(final)
        except OSError:
            if not final.exists():
                raise
        number += 1
        final = wanted.with_name(f"{wanted.name}_{number}")


def run_folder(path: Path) -> Path:
    """The folder of one run: ``path`` itself, or the latest in it."""
    path = Path(path)
    pointer = path / LATEST
    if pointer.is_symlink():
        return path / os.readlink(pointer)
    if pointer.is_file():
        return path / Path(pointer.read_text(encoding="utf-8").strip()).name
    return path
