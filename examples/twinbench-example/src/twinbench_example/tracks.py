"""Folders of ``*.tracks.npz``, a recording each: ``points`` (T, N, 3) and ``controllers`` (T, C, 3) in metres, z up; NaN where not seen."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from twinbench.datasets.collection import Collection
from twinbench.datasets.scenario import Scenario, Split, TransferPair

__all__ = ["Tracks", "read_tracks"]

END = ".tracks.npz"
FPS = 30.0
TRAIN_SHARE = 0.7


def read_tracks(file: Path, name: str) -> Scenario:
    """The recording in ``file``. Raises ValueError naming the file and what is wrong with it."""
    try:
        with np.load(file, allow_pickle=False) as arrays:
            points, controllers = arrays["points"], arrays["controllers"]
        seen = np.isfinite(points).all(axis=2)
        return Scenario(
            name=name,
            points=np.nan_to_num(points),
            visible=seen,
            motion_valid=seen & np.roll(seen, -1, axis=0),
            controllers=controllers,
            fps=FPS,
            gravity=[0.0, 0.0, -9.81],
            object=file.parent.name,
            split=Split(int(TRAIN_SHARE * len(points)), len(points)),
        )
    except (OSError, EOFError, BadZipFile, ValueError, KeyError, IndexError, TypeError) as error:
        raise ValueError(f"{file}: {error}") from error


class Tracks:
    """Folders of tracks in .tracks.npz files."""

    name = "tracks"

    def matches(self, path):
        try:
            return any(Path(path).glob(f"*{END}"))
        except (OSError, RuntimeError, ValueError):  # a loop of links, a name that no file can have
            return False

    def open(self, path, *, split="published"):
        files = {file.name.removesuffix(END): file for file in sorted(Path(path).glob(f"*{END}"))}
        return Collection(
            name=Path(path).resolve().name,
            scenarios={name: partial(read_tracks, file, name) for name, file in files.items()},
            in_domain=tuple(files),
            pairs=tuple(TransferPair((a,), b) for a in files for b in files if a != b),
        )
