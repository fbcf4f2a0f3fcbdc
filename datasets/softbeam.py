"""Softbeam: motion capture of a silicone cantilever that is held, let go, and swings under its weight (and a load on its tip).

Files ``*.c3d`` (Qualisys) with markers Tip-1..3 on the free end and Base-1..3 on the clamp, at 100 Hz, metres; gravity is -x. What is
swinging is the 30 x 30 x 100 mm beam between them, so it gets a lattice of particles, placed by the six markers.

Beam frame (the authors'): along x from the clamp at -0.1 to the tip at 0, y across and z up, both from 0 to 0.03 m.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np

from .c3d import read_points
from .collection import Collection
from .findings import named, shown
from .scenario import Scenario, Split, TransferPair

__all__ = ["LAYOUT", "Softbeam", "read_c3d", "release_frame", "softbeam_scenario"]

CITATION = (
    "M. Dubied, M. Y. Michelis, A. Spielberg, R. K. Katzschmann. Sim-to-Real for Soft Robots Using Differentiable FEM: Recipes for "
    "Meshing, Damping, and Actuation. IEEE RA-L 2022. Data (MIT licence): github.com/srl-ethz/diffPD_sim2real"
)
TIP, BASE = ("Tip1", "Tip2", "Tip3"), ("Base1", "Base2", "Base3")
NOMINAL = np.array(  # m, beam frame: where the authors say the markers sit; those of the tip stand 6 mm off its faces
    [[0, 0.015, 0.036], [0, -0.006, 0.024], [0, 0.036, 0.006], [-0.094, -0.01, -0.001], [-0.094, 0.04, 0.0275], [-0.094, 0.04, 0.0]]
)
SIZE = (0.1, 0.03, 0.03)  # m
CELLS = (13, 4, 4)  # of the lattice: 7.5 to 7.7 mm apart, fine enough that the markers, 6 mm off, are within one spacing of it
FIT = 0.003  # m, RMS of the markers about their nominal places; the published files have 0.8 mm
STILL = 0.0002  # m: the held tip stays within 0.06 mm of its place, the released one moves 0.9 mm in a frame
HELD_FRAMES = 10
TRAIN_SHARE = 0.7


def read_c3d(file: Path) -> tuple[np.ndarray, float]:
    """Tip and base markers (T, 6, 3) in metres, NaN where not seen, and the frame rate [Hz]. Raises ValueError naming the file."""
    points, about = read_points(file)
    for name, kind in (("LABELS", str), ("UNITS", str), ("RATE", float)):
        if not about.get(name) or not isinstance(about[name][0], kind):
            raise ValueError(f"{file}: not a readable c3d file (its parameter POINT:{name} is missing)")
    labels = [re.sub(r"[^A-Za-z0-9]", "", label) for label in about["LABELS"]][: points.shape[1]]
    units, rate = about["UNITS"], about["RATE"][0]
    missing = [name for name in TIP + BASE if name not in labels]
    if missing:
        raise ValueError(f"{file}: must have the markers {', '.join(TIP + BASE)}; {', '.join(missing)} is missing, found {shown(labels)}")
    scale = {"m": 1.0, "mm": 0.001}.get(units[0])
    if scale is None:
        raise ValueError(f"{file}: positions must be in m or mm, got units {shown(units)}")
    return scale * points[:, [labels.index(name) for name in TIP + BASE]], rate


def release_frame(tip: np.ndarray) -> int:
    """The last frame of the held, still phase: the one before the tip (T, K, 3) has left its place by more than 0.2 mm; else frame 0.

    Its place is the mean over the first 10 frames.
    """
    centre = tip.mean(1)
    away = np.linalg.norm(centre - centre[:HELD_FRAMES].mean(0), axis=-1) > STILL
    return max(int(np.argmax(away)) - 1, 0) if away.any() else 0


def softbeam_scenario(file: Path) -> Scenario:
    """The recording from the last held frame on: frame 0 is the shape at rest in the hand, released in the next frame.

    Points are the three tip markers and, never visible, the lattice's first layer, which is the clamp: static controllers grip it.
    The base markers stand on the clamp beside the beam; they place the beam and are no part of it.
    """
    markers, rate = read_c3d(file)
    if len(markers) < 2 * HELD_FRAMES or not np.isfinite(markers).all():
        raise ValueError(f"{file}: every marker must be seen in every one of at least {2 * HELD_FRAMES} frames")
    markers = markers[release_frame(markers[:, :3]) :]
    if len(markers) < HELD_FRAMES:
        raise ValueError(f"{file}: only {len(markers)} frames are left after the release, at least {HELD_FRAMES} are needed")
    clamp, beam = _lattice(file, markers[0])
    frames, tips = len(markers), markers[:, :3]
    held = np.broadcast_to(clamp, (frames, *clamp.shape))
    visible = np.broadcast_to(np.arange(3 + len(clamp)) < 3, (frames, 3 + len(clamp)))
    with named(file):
        return Scenario(
            name=file.stem,
            points=np.concatenate([tips, held], axis=1),
            visible=visible,
            motion_valid=visible & (np.arange(frames) < frames - 1)[:, None],
            controllers=held,
            interior=beam,
            fps=rate,
            gravity=np.array([-9.81, 0.0, 0.0]),
            grips=3 + np.arange(len(clamp)),
            object=_object(file),
            session=file.stem,
            split=Split(int(TRAIN_SHARE * frames), frames),
            tracks=tips,
        )


def _lattice(file, markers):
    """The clamped layer and the rest of the beam's lattice, (25, 3) and (325, 3) metres, from the six markers of one frame."""
    from scipy.spatial.transform import Rotation

    centre, nominal = markers.mean(0), NOMINAL.mean(0)
    rotation, miss = Rotation.align_vectors(markers - centre, NOMINAL - nominal)
    miss /= np.sqrt(len(markers))
    if miss > FIT:
        raise ValueError(f"{file}: the markers must fit the 30 x 30 x 100 mm beam within {1e3 * FIT:g} mm RMS, got {1e3 * miss:.2f} mm")
    axes = [np.linspace(0, size, cells + 1) for size, cells in zip(SIZE, CELLS, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3) - [SIZE[0], 0, 0]
    placed = rotation.apply(nodes - nominal) + centre
    first = (CELLS[1] + 1) * (CELLS[2] + 1)
    return placed[:first], placed[first:]


def _object(file):
    """The beam and its load: the file's name without the letter of the take."""
    return re.sub(r"_[a-z]$", "", file.stem)


class Softbeam:
    """A folder of cantilever recordings, or one of them."""

    name = "softbeam"

    def matches(self, path: Path) -> bool:
        """A .c3d file or a folder that holds some."""
        try:
            return path.suffix == ".c3d" or any(path.glob("*.c3d"))
        except (OSError, RuntimeError, ValueError):  # a loop of links, a name that no file can have
            return False

    def open(self, path: Path, *, split: str = "published") -> Collection:
        """Every file is a scenario fitted on 70 % of its frames; takes with the same load are transfer pairs of each other.

        Each file is a session of its own, so both splits are the same.
        """
        files = [path] if path.suffix == ".c3d" else sorted(path.glob("*.c3d"))
        pairs = [(a, b) for a in files for b in files if a != b and _object(a) == _object(b)]
        return Collection(
            name=path.resolve().stem,
            scenarios={f.stem: partial(softbeam_scenario, f) for f in files},
            in_domain=tuple(f.stem for f in files),
            pairs=tuple(TransferPair((a.stem,), b.stem) for a, b in pairs),
            citation=CITATION,
        )


LAYOUT = Softbeam()
