"""How a twin is kept in a folder: its arrays in ``twin.npz``, everything else in ``twin.json``; no pickle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.npz_file import read_arrays

__all__ = ["read", "write"]


def write(folder: Path | str, arrays: dict[str, Any], state: dict) -> None:
    """Write ``arrays`` and ``state``, which JSON can say, into ``folder``, which is made where it is not there."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / "twin.npz", **arrays)
    (folder / "twin.json").write_text(json.dumps(state, indent=1), encoding="utf-8")


def read(folder: Path | str) -> tuple[dict[str, np.ndarray], dict]:
    """(arrays, state) that ``write`` wrote; tuples of the state are lists."""
    arrays = {name: np.array(array) for name, array in read_arrays(Path(folder) / "twin.npz").items()}  # which may be written to
    return arrays, json.loads((Path(folder) / "twin.json").read_text(encoding="utf-8"))
