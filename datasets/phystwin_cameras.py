"""The cameras of a case in the published PhysTwin layout: metadata.json and calibrate.pkl, as rules."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from .files import load_pickle, present, read_json
from .findings import UNREADABLE, Findings, attempt, changed, error, shown, warning
from .rules import MAX_PIXELS, intrinsics_rules, pose_rules
from .scenario import Camera, Split

__all__ = ["FPS", "read_cameras", "read_metadata"]

FPS = 30.0  # Hz, of the published cameras


def read_metadata(file: Path, split: Split | None) -> Findings:
    """Returns fps, and intrinsics and WH where both are sound."""
    if not present(file):
        yield warning("", f"missing: {FPS:g} frames a second are taken, and there are no cameras", file)
        return {}
    about = yield from attempt(file, read_json, file)
    if about is UNREADABLE:
        return {}
    if about.get("fps") is None:
        yield warning("fps", f"is missing, {FPS:g} is taken", file)
    found = {"fps": about.get("fps") if about.get("fps") is not None else FPS}
    frames = about.get("frame_num")
    if frames is not None and split is not None and frames != split.frame_count:
        yield warning("frame_num", f"is {shown(frames)}, but the recording has {split.frame_count} frames", file)
    if not (given := about.get("intrinsics")):
        yield warning("intrinsics", "no intrinsics: images cannot be scored", file)
        return found
    if not isinstance(given, list):
        yield error("intrinsics", f"must have shape (cameras, 3, 3), got {shown(given)}", file)
        return found
    intrinsics = []
    for camera, one in enumerate(given):
        rules = intrinsics_rules(f"intrinsics of camera {camera}", one)
        intrinsics.append((yield from changed(rules, lambda finding: replace(finding, file=file))))
    size = about.get("WH")
    if not (isinstance(size, list) and len(size) == 2 and all(type(n) is int and 1 <= n <= MAX_PIXELS for n in size)):
        yield error("WH", f"must be [width, height], 1 to {MAX_PIXELS} pixels, got {shown(size)}", file)
    elif not any(k is None for k in intrinsics):
        if any((k[:2, 2] < 0).any() or (k[:2, 2] > size).any() for k in intrinsics):
            yield warning("intrinsics", "a principal point lies outside of the image", file)
        found |= {"WH": size, "intrinsics": intrinsics}
    return found


def read_cameras(file: Path, about: dict) -> Findings:
    """Returns the cameras, if all that they need is there."""
    if not present(file):
        yield warning("", "missing: there are no cameras, images cannot be scored", file)
        return ()
    given = yield from attempt(file, load_pickle, file)
    if given is UNREADABLE:
        return ()
    if not isinstance(given, (list, tuple)) and getattr(given, "ndim", 0) != 3:
        yield error("", f"must hold a list of 4 x 4 matrices, got {shown(given)}", file)
        return ()
    poses = []
    for camera, one in enumerate(given):
        rules = pose_rules(f"matrix of camera {camera}", one if _is_matrix(one) else ())
        poses.append((yield from changed(rules, lambda finding: replace(finding, file=file))))
    intrinsics = about.get("intrinsics")
    if intrinsics is None or any(pose is None for pose in poses):
        return ()
    if len(poses) != len(intrinsics):
        rule = f"must hold one matrix for each of the {len(intrinsics)} cameras of metadata.json"
        yield error("", f"{rule}, got {len(poses)}", file)
        return ()
    return tuple(Camera(k, pose, *about["WH"]) for k, pose in zip(intrinsics, poses, strict=True))


def _is_matrix(value):
    """An array, or rows of numbers as one would write them: anything else may be larger than the file that holds it."""
    if isinstance(value, np.ndarray):
        return True
    rows = value if isinstance(value, (list, tuple)) and len(value) <= 4 else [None]
    return all(isinstance(row, (list, tuple)) and len(row) <= 4 and all(type(x) in (int, float) for x in row) for row in rows)
