"""Stages of long work whose results are kept until all is done, so that a killed call goes on where it stopped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from ..temporary import remove, replacing

__all__ = ["Stages"]


class Stages:
    """Results in ``folder``, each a dataclass of arrays in a file of its own; those of another ``key`` count for nothing."""

    def __init__(self, folder: Path, key: str):
        self.folder, self.key = folder, key

    def run(self, name: str, kind: type, work: Callable):
        """The result ``name``, a ``kind``: as it was kept, or what ``work()`` returns, which is kept."""
        file = self.folder / f"{name}.npz"
        try:
            with np.load(file, allow_pickle=False) as kept:
                if str(kept["key"]) == self.key:
                    return kind(**{f.name: _unpacked(kept, f.name) for f in fields(kind)})
        except (OSError, EOFError, KeyError, ValueError, BadZipFile):
            pass  # not there, or damaged by whatever ended the call that wrote it
        result = work()
        packed = {}
        for f in fields(kind):
            array = getattr(result, f.name)
            packed |= {f"{f.name}_bits": np.packbits(array), f"{f.name}_shape": array.shape} if array.dtype == bool else {f.name: array}
        with replacing(file) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, key=np.array(self.key), **packed)
        return result

    def finish(self) -> None:
        """Nothing of this is needed any more."""
        if self.folder.exists():
            remove(self.folder)


def _unpacked(kept, name):
    if name in kept:
        return kept[name]
    shape = tuple(kept[f"{name}_shape"])
    return np.unpackbits(kept[f"{name}_bits"], count=int(np.prod(shape))).astype(bool).reshape(shape)
