"""A roll-out of a submission: the file that it is in, what it must be, and how it belongs to its recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...datasets.findings import UNREADABLE, Findings, attempt, count, error, warning
from ...datasets.npz_file import read_arrays
from ...datasets.rules import FAR
from ...datasets.scenario import Scenario
from ...methods.base import Trajectory
from .format import Rollout

__all__ = ["read_rollout", "rollout_rules"]

SHAPES = {"positions": ("frames", "particles", 3), "counts": (3,)}
UNITS = {"millimetres": 1e3, "centimetres": 1e2}  # in a metre
LARGER = 3.0  # times the recorded body, in frame 0: no method makes a body so much larger before anything has moved
ELSEWHERE, BESIDE = 1.0, 0.1  # lengths of the body between it and the particles of frame 0: another place, and no good start
SAME = 0.1  # of the spacing of the recording's points: a particle so near to one is that point


def read_rollout(folder: Path, rollout: Rollout) -> Trajectory:
    """The roll-out in its file, particles in the order tracked | surface | interior; NaN from the frame on in which it diverged.

    Raises ValueError naming the file where it is not one.
    """
    file = Path(folder) / rollout.file
    arrays = read_arrays(file, SHAPES)
    positions, counts = arrays["positions"], arrays["counts"]
    if positions.dtype not in (np.float32, np.float64):
        raise ValueError(f"{file}: positions must be of type float32 or float64, got {positions.dtype}")
    if counts.dtype.kind not in "iu" or counts.min() < 0 or counts.max() > positions.shape[1] or counts.sum() != positions.shape[1]:
        rule = f"three whole numbers >= 0 of tracked, surface and interior particles, {positions.shape[1]} in all"
        raise ValueError(f"{file}: counts must be {rule}, got {counts.tolist()}")
    if not counts[:2].sum():
        raise ValueError(f"{file}: counts must have at least one tracked or surface particle, got {counts.tolist()}")
    if rollout.diverged_frame is not None:
        positions = positions.copy()  # as read, it may not be written to
        positions[rollout.diverged_frame :] = np.nan
    tracked, surface, interior = (int(n) for n in counts)
    return Trajectory(positions, (tracked, surface, interior))


def rollout_rules(folder: Path, rollout: Rollout, scenario: Scenario) -> Findings:
    """What is wrong with a roll-out of ``scenario``: errors, and warnings of what cannot be scored with it."""
    file = Path(folder) / rollout.file
    trajectory = yield from attempt(file, read_rollout, folder, rollout)
    if trajectory is UNREADABLE:
        return
    if len(trajectory.positions) != scenario.frame_count:
        yield error("positions", _wrong_length(trajectory.positions.shape, scenario), file)
        return
    if rollout.diverged_frame is not None and rollout.diverged_frame >= scenario.frame_count:
        rule = f"must be one of the recording's frames 0 to {scenario.frame_count - 1}"
        yield error("diverged_frame", f"{rule}, got {rollout.diverged_frame}", file)
        return
    good = trajectory.positions[: rollout.diverged_frame]
    finite = np.isfinite(good).all(axis=(1, 2))
    if not finite.all():
        many = f"NaN or infinity in {count(~finite, 'frame')}, first in frame {int(np.flatnonzero(~finite)[0])}"
        yield error("positions", f"must be finite, got {many}; a roll-out that diverged says so by diverged_frame", file)
    elif len(good):
        yield from _start(file, trajectory, scenario)
        if (size := float(np.abs(good).max())) > FAR:
            yield error("positions", f"must lie within {FAR:g} m of the origin, got {size:.6g} m", file)


def _wrong_length(shape: tuple[int, ...], scenario: Scenario) -> str:
    frames, said = scenario.frame_count, f"must have the recording's {scenario.frame_count} frames, from frame 0 on, got {shape[0]}"
    if shape[1] == frames:
        return f"{said}, and {frames} particles: are frames and particles exchanged?"
    if shape[0] == len(scenario.split.test):
        return f"{said}: as many as are tested, which follow in the same roll-out"
    if shape[0] == frames - 1:
        return f"{said}: is frame 0 missing?"
    return said


def _start(file: Path, trajectory: Trajectory, scenario: Scenario) -> Findings:
    """Whether frame 0 is the recording's: unit, place and order of the particles."""
    from scipy.spatial import cKDTree

    surface, seen = trajectory.surface[0].astype(float), scenario.visible[0]
    points = scenario.points[0][seen]
    if not len(points):
        return
    recorded, ours = (float(np.ptp(cloud, axis=0).max()) for cloud in (np.concatenate([points, scenario.surface]), surface))
    if recorded > 0 and ours > LARGER * recorded:
        units = [name for name, times in UNITS.items() if 1 / LARGER < ours / recorded / times < LARGER]
        unit = f": it looks like {units[0]}" if units else ""
        said = f"must be in metres, got a body {ours:.4g} m long in frame 0, which was recorded {recorded:.4g} m long{unit}"
        yield error("positions", said, file)
        return
    apart = float(np.median(cKDTree(surface).query(points)[0]))
    said = f"{apart:.3g} m from the recorded points to the nearest particles in frame 0, of a body {recorded:.3g} m long"
    if apart > ELSEWHERE * recorded:
        yield error("positions", f"must begin where the recording does, in its axes, got {said}", file)
    elif apart > BESIDE * recorded:
        yield warning("positions", f"begin beside the recorded body: {said}", file)
    elif scenario.correspond:
        yield from _order(file, trajectory.tracked[0].astype(float), scenario)


def _order(file: Path, tracked: np.ndarray, scenario: Scenario) -> Findings:
    """Whether particle i stands for point i, which only ``coordinate_error`` needs."""
    from scipy.spatial import cKDTree

    points, seen = scenario.points[0], scenario.visible[0]
    lost = "coordinate_error has no value"
    if len(tracked) != len(points):
        yield warning("counts", f"has {len(tracked)} tracked particles, and the recording {len(points)} points: {lost}", file)
        return
    near = SAME * (scenario.spacing or 1e-3)  # m
    distance, nearest = cKDTree(tracked).query(points[seen])
    own = np.linalg.norm(tracked[seen] - points[seen], axis=1)
    if (own <= distance + near).mean() > 0.5:
        return
    if (distance <= near).mean() > 0.5:
        first = int(np.flatnonzero(own > distance + near)[0])
        where = f"point {int(np.flatnonzero(seen)[first])} at particle {int(nearest[first])}"
        yield error("positions", f"must have the tracked particles in the order of the recording's points, got {where}", file)
    else:
        yield warning("positions", f"have tracked particles that are not the recording's points: {lost}", file)
