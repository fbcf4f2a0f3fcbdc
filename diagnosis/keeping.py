"""What a diagnosis keeps beside its report, for films and for the playground: tracks of the twins, and the twins."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.temporary import replacing

__all__ = ["NAMES", "TRACKS", "TWINS", "write_tracks", "write_twins"]

TRACKS, TWINS = "tracks.npz", "twins"
NAMES = ("baseline", "extended")  # of twins, as of tracks: as it was questioned, and with the effect that was named


def write_tracks(arrays: Mapping[str, np.ndarray], out: Path) -> None:
    """Write ``arrays`` as ``write_report`` draws them, whole and in float32, into ``out``/tracks.npz in one rename."""
    with replacing(Path(out) / TRACKS) as temporary, temporary.open("wb") as file:
        kept: dict[str, Any] = {name: np.asarray(values, np.float32) for name, values in arrays.items()}
        np.savez_compressed(file, **kept)


def write_twins(twins: Mapping[str, Any], out: Path) -> None:
    """Save each of ``twins``, by one of ``NAMES``, in ``out``/twins/NAME; those of an earlier diagnosis are taken away first."""
    folder = Path(out) / TWINS
    for name in NAMES:
        if (folder / name / "twin.json").is_file():
            shutil.rmtree(folder / name)
    for name, twin in twins.items():
        twin.save(folder / name)
