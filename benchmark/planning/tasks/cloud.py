"""A goal of the user's: a cloud of points that the body should look like. Nothing says which point goes where."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....datasets.npz_file import read_arrays
from ....datasets.ply_file import read_vertices
from ....datasets.scenario import Observed
from ..goal import Goal

__all__ = ["KINDS", "cloud_goal", "read_cloud"]

KINDS = (".npy", ".ply", ".csv", ".txt")
FEWEST = 3  # points of a shape


def read_cloud(path: str | Path) -> np.ndarray:
    """(K, 3) m, the points in a .npy, .ply, .csv or .txt file. Raises ValueError naming the file and what is wrong with it."""
    path = Path(path)
    if path.suffix.lower() not in KINDS:
        raise ValueError(f"{path}: a goal's name must end in one of {', '.join(KINDS)}")
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        cloud = np.asarray(_read(path), float)
    except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: not a cloud of points that can be read ({error})") from error
    if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) < FEWEST:
        raise ValueError(f"{path}: a goal must have shape (points, 3) with at least {FEWEST} points, got {cloud.shape}")
    if not np.isfinite(cloud).all():
        raise ValueError(f"{path}: a goal's points must be finite, got {int((~np.isfinite(cloud)).sum())} numbers that are not")
    return cloud


def _read(path):
    kind = path.suffix.lower()
    if kind == ".npy":
        return read_arrays(path)[path.stem]
    if kind == ".ply":
        vertices = read_vertices(path)
        return np.stack([vertices[axis] for axis in "xyz"], 1)
    return np.loadtxt(path, delimiter="," if kind == ".csv" else None, ndmin=2)


def cloud_goal(path: str | Path, start: Observed) -> Goal:
    """The goal to look like the cloud in ``path``, in metres and in the axes of the recording."""
    return Goal("cloud", start.points[0][start.visible[0]], None, read_cloud(path))
