"""What commands share: the options that several have, and what they are checked for."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated

from tyro.conf import arg

__all__ = [
    "DEVICES",
    "PRESETS",
    "SPLITS",
    "Names",
    "chosen",
    "chosen_methods",
    "chosen_metrics",
    "first_line",
    "known",
    "usable",
    "writable",
    "writable_file",
]

PRESETS, DEVICES, SPLITS = ("quick", "full"), ("cpu", "cuda"), ("published", "clean")
Names = Annotated[tuple[str, ...], arg(metavar="NAME ...")]


def known(kind: str, names: Iterable[str], choices: Iterable[str]) -> None:
    """Raises ValueError, with the nearest choice or why it was left out, where one of ``names`` is none."""
    from ..datasets.plugins import unknown

    for name in names:
        if name not in choices:
            raise unknown(kind, name, choices)


def usable(device: str, executor: str = "local") -> None:
    """Raises ValueError for an unknown ``device``, or one that this machine has not, if it is the one that works: better before hours of
    work than after."""
    from .provenance import device_name

    known("device", [device], DEVICES)
    if executor == "local":
        device_name(device)


def writable(path: Path, *, option: str = "--out") -> Path:
    """``path`` as a folder that can be written to, which is better known before hours of work than after."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=path).close()  # permissions do not tell: root has all, also where nothing can be written
    except OSError as error:
        raise ValueError(f"{path}: not a folder that results can be written to ({error.strerror}); choose another with {option}") from error
    return path


def writable_file(path: Path, *, option: str = "--out") -> Path:
    """``path`` as a file that can be written, as ``writable`` says it of folders."""
    if path.is_dir():
        raise ValueError(f"{path}: not a file that can be written (a folder is there); choose another with {option}")
    writable(path.parent, option=option)
    return path


def first_line(thing) -> str:
    """Of a docstring: what a list says of it."""
    from ..datasets.plugins import one_line

    doc = thing.__doc__
    return one_line(doc.strip().split("\n")[0]) if isinstance(doc, str) else ""


def chosen_methods(names: Iterable[str]) -> dict:
    """The methods of these names, "all" among them: all but a diagnosis."""
    from ..methods.registry import methods

    found = methods()
    every = [name for name, method in found.items() if getattr(method, "room", "") == "methods"]  # a diagnosis takes as long as all others
    names = [name for entry in names for name in entry.split(",")]
    return chosen("method", [one for name in names for one in (every if name == "all" else [name])], found)


def chosen_metrics(names: Iterable[str] = ()) -> dict:
    """The metrics of these names; all where there are none."""
    from ..metrics.base import metrics

    found = metrics()
    return chosen("metric", names, found) if names else found


def chosen(kind: str, names: Iterable[str], found: dict) -> dict:
    """Those of ``found`` that are named, with commas between names or not."""
    given = list(names)
    names = [name for entry in given for name in entry.split(",") if name]
    if not names:
        raise ValueError(f"at least one {kind} must be named, got {' '.join(map(repr, given)) or 'none'}")
    known(kind, names, found)
    return {name: found[name] for name in dict.fromkeys(names)}
