"""DEFT: motion capture of branched cables held by robots, in the published layout ``BDLO{n}[_mid_clamp]/{train,eval}/*.pkl``.

Each pickle is a list with one tuple of 3 lists (x, y, z), each T x V marker coordinates [m], frame after frame at 100 Hz; y points up.
Markers are numbered along the main cable, then along each branch without its joint. Nothing is touched.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np

from .markers import MarkerCollection, collect, infer_paths, read_splits
from .safe_pickle import load, numbers_of

__all__ = ["LAYOUT", "Deft", "read_deft"]

CITATION = (
    "Y. Chen, X. Wu, Y. Zong, Y. Chen, A. Li, B. Zhang, R. Vasudevan. DEFT: Differentiable Branched Discrete Elastic Rods for Modeling "
    "Furcated DLOs in Real-Time. 2025, arXiv:2502.15037. Data: github.com/roahmlab/DEFT"
)
FRAMES = 500  # of every published block; file names say "..._frames280to779"
MID_CLAMP = "_mid_clamp"
MIDDLES = {"BDLO1": 2, "BDLO3": 3}  # the interior marker held in the *_mid_clamp recordings


def _tree(main, *branches):
    """Paths of a main cable of ``main`` markers and branches (joint, further markers)."""
    paths, first = [tuple(range(main))], main
    for joint, count in branches:
        paths.append((joint, *range(first, first + count)))
        first += count
    return tuple(paths)


# main cable, then (joint, markers) of each branch, as the authors' DEFT_train.py sets them; BDLO5's second branch grows out of its first
TREES = {
    "BDLO1": _tree(13, (4, 4), (8, 3)),
    "BDLO2": _tree(12, (4, 4), (7, 4)),
    "BDLO3": _tree(12, (4, 2), (7, 3)),
    "BDLO4": _tree(12, (4, 2), (8, 2)),
    "BDLO5": _tree(12, (5, 3), (12, 3)),
    "BDLO6": _tree(12, (2, 4), (7, 2), (7, 3)),
}


def read_deft(file: Path, markers: int | None = None) -> np.ndarray:
    """Markers (T, V, 3) in metres. Where ``markers`` is unknown the block's length is its name's, or 500 frames.

    Raises ValueError, naming the file, where it is no 3 lists of T x V numbers or T disagrees with the name.
    """
    axes = numbers_of(load(file), file, "the 3 axes")
    if axes.dtype.kind not in "iuf" or axes.shape[:-1] not in ((3,), (1, 3)) or axes.shape[-1] == 0:
        raise ValueError(f"{file}: must hold 3 lists of frames x markers numbers, got shape {axes.shape} of type {axes.dtype}")
    values = axes.shape[-1]
    named = re.search(r"_frames(\d+)to(\d+)$", file.stem)
    frames = int(named[2]) - int(named[1]) + 1 if named else None
    count = values // (frames or FRAMES) if markers is None else markers
    if count < 5 or values % count or (frames or values // count) != values // count:
        stated = f" in {frames} frames" if frames else ""
        raise ValueError(f"{file}: must hold whole frames of {max(count, 5)} markers{stated}, got {values} values for each axis")
    return axes.reshape(3, -1, count).transpose(1, 2, 0).astype(float)


class Deft:
    """The branched-cable folders of DEFT."""

    name = "deft"

    def matches(self, path: Path) -> bool:
        """A folder BDLO* with pickles under train/ and eval/."""
        try:
            named = path.is_dir() and re.match(r"BDLO\d", path.resolve().name) is not None
            return named and all(any(path.glob(f"{s}/*.pkl")) for s in ("train", "eval"))
        except (OSError, RuntimeError, ValueError):  # a loop of links, a name that no file can have
            return False

    def open(self, path: Path, *, split: str = "published") -> MarkerCollection:
        """One twin on the training recordings, scored on every eval recording. A cable that is not in the table has its tree inferred.

        The robots hold markers 0, 1 and the last two of the main cable, or with ``_mid_clamp`` one inside it and the last two. The
        markers of a cable were re-attached between its two folders, so each folder is an object of its own.
        """
        path = path.resolve()
        cable = path.name.removesuffix(MID_CLAMP)
        paths = TREES.get(cable)
        recordings = read_splits(path, partial(read_deft, markers=1 + max(map(max, paths)) if paths else None))
        paths = paths or infer_paths([r for r in recordings if r.side == "train"])
        end = paths[0][-1]
        held = (0, 1)
        if path.name.endswith(MID_CLAMP):
            if cable not in MIDDLES:
                raise ValueError(f"{path}: which marker is clamped in the middle is known for {', '.join(MIDDLES)}, not for {cable}")
            held = (MIDDLES[cable],)
        return collect(path, recordings, paths, driven=(*held, end - 1, end), down=(0.0, -1.0, 0.0), split=split, citation=CITATION)


LAYOUT = Deft()
