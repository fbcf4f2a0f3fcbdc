"""DEFORM: motion capture of ropes held at both ends by robots, in the published layout ``DLO{n}/{train,eval}/<id>.pkl``.

Each pickle is a list of frames at 100 Hz, each 3 lists (x, y, z) of V marker coordinates [m]; z points up. Nothing is touched.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .markers import MarkerCollection, collect, read_splits
from .safe_pickle import load, numbers_of

__all__ = ["LAYOUT", "Deform", "read_deform"]

CITATION = (
    "Y. Chen, Y. Zhang, Z. Brei, T. Zhang, Y. Chen, J. Wu, R. Vasudevan. Differentiable Discrete Elastic Rods for Real-Time Modeling "
    "of Deformable Linear Objects. CoRL 2024, arXiv:2406.05931. Data: github.com/roahmlab/DEFORM"
)
PUBLISHED = {"DLO1": 0.01010, "DLO2": 0.0097}  # m, mean absolute coordinate error of 5 s roll-outs on the eval recordings


def read_deform(file: Path) -> np.ndarray:
    """Markers (T, V, 3) in metres. Raises ValueError, naming the file, where it is no list of 3 x V frames of numbers."""
    frames = numbers_of(load(file), file, "the frames")
    if frames.dtype.kind not in "iuf" or frames.ndim != 3 or frames.shape[1] != 3 or frames.shape[2] < 5:
        raise ValueError(f"{file}: must hold (frames, 3, markers >= 5) numbers, got shape {frames.shape} of type {frames.dtype}")
    return frames.astype(float).transpose(0, 2, 1)


class Deform:
    """The rope folders of DEFORM."""

    name = "deform"

    def matches(self, path: Path) -> bool:
        """A folder DLO* with pickles under train/ and eval/."""
        try:
            named = path.is_dir() and re.match(r"DLO\d", path.resolve().name) is not None
            return named and all(any(path.glob(f"{s}/*.pkl")) for s in ("train", "eval"))
        except (OSError, RuntimeError, ValueError):  # a loop of links, a name that no file can have
            return False

    def open(self, path: Path, *, split: str = "published") -> MarkerCollection:
        """One twin on the training recordings, scored on every eval recording. Markers 0, 1, -2 and -1 are held by the robots."""
        path = path.resolve()
        recordings = read_splits(path, read_deform)
        count = recordings[0].markers.shape[1]
        published = PUBLISHED.get(path.name)
        return collect(
            path,
            recordings,
            (tuple(range(count)),),
            driven=(0, 1, count - 2, count - 1),
            down=(0.0, 0.0, -1.0),
            split=split,
            published={("transfer", "DEFORM (published)", "coordinate_error"): published} if published else {},
            citation=CITATION,
        )


LAYOUT = Deform()
