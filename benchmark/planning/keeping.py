"""Fitted twins of an experiment, kept on the disk so that an arm that is added later needs no second fit."""

from __future__ import annotations

from pathlib import Path

from ...methods.base import Twin
from ...methods.registry import get_method
from .arms import Arm

__all__ = ["KnownTwins"]

DONE = "fitted"  # a file that is written last: a folder without it was cut off


class KnownTwins(dict):
    """Twins by ``Arm.twin``, each in a folder of that name below ``folder``; those of methods that cannot be saved are kept in memory."""

    def __init__(self, folder: Path):
        super().__init__()
        self.folder = Path(folder)

    def __contains__(self, name) -> bool:
        return super().__contains__(name) or (self.folder / name / DONE).is_file()

    def __missing__(self, name: str) -> Twin:
        if not (self.folder / name / DONE).is_file():
            raise KeyError(name)
        twin = get_method(Arm.of(name).method).twin_class.load(self.folder / name)
        super().__setitem__(name, twin)
        return twin

    def __setitem__(self, name: str, twin: Twin) -> None:
        super().__setitem__(name, twin)
        twin.save(self.folder / name)
        (self.folder / name / DONE).touch()
