"""A recording from arrays that somebody has: tracks and hands in .npy or .npz files, or a small example without any.

Arrays go by the names of ``Scenario``'s fields; only ``points`` must be there. What they say of units and axes is an argument each.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from ..spelling import nearest
from . import npz_file
from .findings import shown
from .scenario import Plane, Scenario, Split

__all__ = ["NAMES", "UNITS", "example", "read_arrays", "recording"]

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}  # metres
_LENGTHS = ("points", "controllers", "surface", "interior", "tracks")
NAMES = (*_LENGTHS, "visible", "motion_valid", "colors", "grips")
FPS, FRAMES, TRAIN = 30.0, 45, 0.7
SWING, SPEED, DELAY = 0.08, 0.8, 0.15  # m, Hz, s: how far and fast the example's hand goes, and how much later the lower end follows


def read_arrays(files: Iterable[str | Path]) -> dict[str, np.ndarray]:
    """The arrays in ``files`` by name: those of an .npz by their keys, one of an .npy by its file's name.

    Raises ValueError naming the file where it cannot be read, and the nearest name where an array has another.
    """
    found: dict[str, np.ndarray] = {}
    for file in map(Path, files):
        for name, array in npz_file.read_arrays(file).items():
            if name not in NAMES:
                raise ValueError(f"{file}: unknown array {shown(name)}; {nearest(name, NAMES)}")
            if name in found:
                raise ValueError(f"{file}: {name} must be given once, got it twice")
            found[name] = array
    return found


def recording(
    name: str,
    arrays: Mapping[str, np.ndarray],
    *,
    gravity: Iterable[float],
    table: float | None = None,
    fps: float = FPS,
    unit: str = "m",
    train: float = TRAIN,
    object: str = "",
) -> tuple[Scenario, list[str]]:
    """The recording that ``arrays`` hold, and notes on what of them it does not take.

    points (T, N, 3), NaN where not seen; controllers (T, C, 3), none where left out; the others as ``Scenario`` has them. Lengths are
    in ``unit``, ``gravity`` in m/s^2. ``table`` is its height [m] along the axis against gravity, None where there is none. The share
    ``train`` of the frames is fitted. Raises ValueError naming the field, the rule and the value.
    """
    if unit not in UNITS:
        raise ValueError(f"unknown unit {unit!r}; {nearest(unit, UNITS)}")
    if "points" not in arrays:
        raise ValueError(f"points (frames, points, 3) must be among the arrays, got {', '.join(arrays) or 'none'}")
    values = {key: UNITS[unit] * array if key in _LENGTHS else array for key, array in arrays.items()}
    points = values["points"]
    if points.ndim != 3 or points.shape[2] != 3 or not points.shape[0]:
        raise ValueError(f"points must have shape (frames, points, 3), got {points.shape}")
    visible = np.isfinite(points).all(axis=2)
    if "visible" in values:
        if values["visible"].shape != visible.shape:
            raise ValueError(f"visible must have shape {visible.shape}, got {values['visible'].shape}")
        if not np.isin(values["visible"], (0, 1)).all():
            raise ValueError(f"visible must be bool, got {values['visible'].dtype} with values other than 0 and 1")
        visible &= values["visible"].astype(bool)
    started = np.isfinite(points[0]).all(axis=1)
    notes = [f"{(~started).sum()} of {len(started)} points have no position in frame 0 and are left out"] if not started.all() else []
    if notes and "grips" in values:
        raise ValueError("points must be finite in frame 0 where grips names some of them")
    values["points"] = np.where(np.isfinite(points), points, 0.0)[:, started]
    values["visible"] = np.asarray(visible)[:, started]
    for key in ("motion_valid", "colors"):
        if key in values and values[key].shape[:2] == points.shape[:2]:
            values[key] = values[key][:, started]
    if "motion_valid" not in values:
        values["motion_valid"] = np.zeros_like(values["visible"])
        values["motion_valid"][:-1] = values["visible"][:-1] & values["visible"][1:]
    values.setdefault("controllers", np.zeros((len(points), 0, 3)))
    down = np.asarray(list(gravity), float)
    ground = None
    if table is not None:
        if down.shape != (3,) or not np.linalg.norm(down) > 0:
            raise ValueError(f"gravity must have a direction where there is a table, got {down.tolist()}")
        ground = Plane(0.0 - down / np.linalg.norm(down), table)
    split = Split(min(max(round(train * len(points)), 2), len(points)), len(points))
    about = {"gravity": down, "ground": ground, "fps": fps, "split": split, "object": object or name, "session": name}
    return Scenario(name=name, **values, **about), notes


def example(name: str) -> Scenario:
    """A soft bar of 3 x 3 x 12 points that hangs from a hand, z up: each point goes the hand's way, the later the lower it is.

    A formula, not a simulation: x(s, t) = x_0(s) + SWING sin(2 pi SPEED (t - DELAY s)), s from 0 at the hand to 1.
    """
    across, along = [-0.02, 0.0, 0.02], np.linspace(0.5, 0.2, 12)  # m
    bar = np.stack(np.meshgrid(across, across, along, indexing="ij"), -1).reshape(-1, 3)
    hand = np.array([[x, y, 0.52] for x in (-0.02, 0.0, 0.02) for y in (-0.02, 0.02)])
    times = np.arange(FRAMES)[:, None] / FPS

    def moved(start, later):
        went = SWING * np.sin(2 * np.pi * SPEED * np.clip(times - later, 0, None))  # (T, P)
        return start + went[..., None] * [1.0, 0.0, 0.0]

    points = moved(bar, DELAY * (0.5 - bar[:, 2]) / 0.3)
    arrays = {"points": points, "controllers": moved(hand, np.zeros(len(hand))), "tracks": points[:, 11::12]}
    return recording(name, arrays, gravity=(0.0, 0.0, -9.81), table=0.0)[0]
