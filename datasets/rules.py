"""What a recording must be so that anything can be computed with it, field by field.

These rules are ``Scenario``'s own, so every layout has them; a layout may ask them beforehand, to hear of all that is wrong.
How the fields fit together, and whether they are plausible, is in ``plausible.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import Any, TypeGuard

import numpy as np

from .findings import Findings, count, error, shown

__all__ = [
    "FAR",
    "MAX_PIXELS",
    "camera_rules",
    "intrinsics_rules",
    "observed_rules",
    "plane_rules",
    "pose_rules",
    "scenario_rules",
    "split_rules",
]

FAR = 1000.0  # m from the origin, in each coordinate: beyond, single precision is coarser than 0.06 mm, and no camera rig reaches
MIN_FPS = 0.1  # Hz: nothing that moves is told by a frame every ten seconds
MAX_FPS = 1e4  # Hz: the fastest cameras and motion capture; a frame time in microseconds is more
MAX_GRAVITY = 100.0  # m/s^2: four times Jupiter's; gravity in mm/s^2 is more
UNIT = 1e-6  # how far the length of the ground's normal may be from 1
RIGID = 1e-4  # how far R^T R may be from the identity: board poses are written in double precision, hand-typed ones are rounded
MAX_PIXELS = 2**14  # of an image's width and height
_SHAPES = {  # the axes of each array; a letter is the same number everywhere
    "points": "TN3",
    "visible": "TN",
    "motion_valid": "TN",
    "controllers": "LC3",
    "actuation": "LA",
    "surface": "S3",
    "interior": "I3",
    "colors": "TN3",
    "gravity": "3",
    "grips": "C",
    "tracks": "LK3",
}
_AXES = {"T": "frames", "L": "frames", "N": "points", "C": "controllers", "A": "inputs", "S": "points", "I": "points", "K": "tracks"}
_FLAGS = ("visible", "motion_valid")
_MAY_BE_NONE = ("colors", "actuation", "grips", "tracks")


def observed_rules(values: Mapping[str, Any]) -> Findings:
    """The rules of ``Observed``'s fields. Returns the arrays among ``values`` that are sound, in the types that it holds them in."""
    return (yield from _rules(values, _SHAPES))


def scenario_rules(values: Mapping[str, Any]) -> Findings:
    """The rules of ``Scenario``'s fields: those of ``Observed``, over all frames, its split and its tracks."""
    good = yield from _rules(values, {name: axes.replace("L", "T") for name, axes in _SHAPES.items()})
    split = values.get("split")
    frames = len(good["points"]) if "points" in good else None
    if split is not None and frames not in (None, split.frame_count):
        yield error("split", f"must speak of the recording's {frames} frames, got {split.frame_count}")
    start = values.get("start_frames", 1)
    if isinstance(start, bool) or start not in (1, 2) or (split is not None and start > split.train_end):
        yield error("start_frames", f"must be 1 or 2, and no more than are fitted, got {shown(start)}")
    return good


def _rules(values, shapes):
    sizes, good = {"3": 3}, {}
    for name, axes in shapes.items():
        if name in values and not (name in _MAY_BE_NONE and values[name] is None):
            array = yield from _array(name, values[name], axes, sizes)
            if array is not None:
                good[name] = array
    yield from _lengths(good)
    for name in ("controllers", "actuation", "surface", "interior", "gravity"):
        if name in good and (yield from _finite(name, good[name])):
            del good[name]
    if {"points", "visible"} <= set(good) and (yield from _points(good["points"], good["visible"])):
        del good["points"]
    if "tracks" in good and (yield from _near("tracks", good["tracks"], np.isnan(good["tracks"]))):
        del good["tracks"]
    if "gravity" in good and (size := float(np.linalg.norm(good["gravity"]))) > MAX_GRAVITY:
        yield error("gravity", f"must be at most {MAX_GRAVITY:g} m/s^2, got {size:.6g}")
    if "grips" in good and "points" in good and len(good["grips"]):
        yield from _grips(good["grips"], good["points"].shape[1])
    fps = values.get("fps", 1.0)
    if not _is_number(fps) or not MIN_FPS <= fps <= MAX_FPS:
        yield error("fps", f"must be a number from {MIN_FPS:g} to {MAX_FPS:g} frames per second, got {shown(fps)}")
    if values.get("correspond", True) is False and "motion_valid" in good and good["motion_valid"].any():
        yield error("motion_valid", f"must be False where points do not correspond, got {count(good['motion_valid'], 'motion')}")
    flags = {name: (bool, np.bool_) for name in ("self_collision", "timed", "correspond")}
    for name, kind in {"object": str, "session": str, **flags}.items():
        if name in values and not isinstance(values[name], kind):
            yield error(name, f"must be a {'str' if kind is str else 'bool'}, got {shown(values[name])}")
    return good


def _array(name, value, axes, sizes):
    """``value`` as an array of the stated axes in the type of its field, or None. ``sizes`` learns how long the axes are."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, OverflowError, RecursionError):
        return (yield error(name, f"must be an array of numbers, got {shown(value)}"))
    expected = tuple(sizes.get(axis, _AXES.get(axis)) for axis in axes)
    fits = array.ndim == len(axes) and all(n in (m, None) or isinstance(n, str) for n, m in zip(expected, array.shape, strict=True))
    if not fits:
        return (yield error(name, f"must have shape ({', '.join(map(str, expected))}{',' * (len(axes) == 1)}), got {array.shape}"))
    if array.dtype.kind not in "biuf":
        return (yield error(name, f"must hold numbers, got dtype {array.dtype}"))
    if name in _FLAGS and not np.isin(array, (0, 1)).all():
        return (yield error(name, f"must be bool, got {array.dtype} with values other than 0 and 1"))
    if name == "grips" and array.size and array.dtype.kind not in "iu":
        return (yield error(name, f"must be integers, got {shown(array.tolist())}"))
    sizes |= dict(zip(axes, array.shape, strict=True)) | {"3": 3}
    return array.astype(bool if name in _FLAGS else np.int64 if name == "grips" else np.float64)


def _lengths(good):
    if "points" in good and not all(good["points"].shape):
        yield error("points", f"must hold at least one frame and one tracked point, got {good.pop('points').shape}")
    if {"points", "controllers"} <= set(good) and len(good["controllers"]) < len(good["points"]):
        yield error("controllers", f"must cover every frame, got {len(good['controllers'])} of {len(good['points'])} frames")


def _finite(name, array):
    """Whether something in ``array`` is not finite, or too far."""
    if (bad := ~np.isfinite(array)).any():
        yield error(name, f"must be finite, got NaN or infinity in {count(bad.any(-1), 'row')}")
        return True
    return name not in ("actuation", "gravity") and (yield from _near(name, array, bad))


def _near(name, array, empty):
    """Whether a coordinate, other than where ``empty``, is infinite or too far from the origin."""
    size = float(np.abs(np.where(empty, 0.0, array)).max(initial=0.0))
    if size <= FAR:
        return False
    unit = ": are these millimetres?" if size <= 1000 * FAR else ""
    yield error(name, f"must lie within {FAR:g} m of the origin, got {size:.6g} m{unit}")
    return True


def _points(points, visible):
    finite = np.isfinite(points).all(-1)
    if (bad := visible & ~finite).any():
        first = np.nonzero(bad)[0][0]
        yield error("points", f"must be finite wherever visible, got NaN or infinity in {count(bad, 'row')}, first in frame {first}")
    elif not finite[0].all():
        bad = count(~finite[0], "row")
        yield error("points", f"must be finite in frame 0, where the body's structure is read, got NaN or infinity in {bad}")
    else:
        seen = visible.copy()
        seen[0] = True
        return (yield from _near("points", points, ~seen[..., None]))
    return True


def _grips(grips, points):
    if grips.min() < -1 or grips.max() >= points:
        yield error("grips", f"must be -1 or the index of one of the {points} points, got {shown(grips.tolist())}")
    elif len(driven := grips[grips >= 0]) > len(np.unique(driven)):
        yield error("grips", f"must hold a point once, got {shown(grips.tolist())}")


def plane_rules(normal, offset) -> Findings:
    """The rules of a ``Plane``. Returns the normal as an array."""
    normal = yield from _array("ground normal", normal, "3", {"3": 3})
    if normal is not None and not abs((length := float(np.linalg.norm(normal))) - 1) <= UNIT:
        yield error("ground normal", f"must be a unit vector, got length {length:.6g}")
    if not _is_number(offset) or not abs(offset) <= FAR:
        yield error("ground offset", f"must be a number within {FAR:g} m, got {shown(offset)}")
    return normal


def split_rules(train_end, frame_count) -> Findings:
    """The rules of a ``Split``."""
    if not all(isinstance(n, (int, np.integer)) and not isinstance(n, bool) for n in (train_end, frame_count)):
        yield error("split", f"must be of integers, got {shown(train_end)} of {shown(frame_count)} frames")
    elif not 2 <= train_end <= frame_count:
        train = f"train [0, {train_end}) of {frame_count} frames"
        yield error("split", f"must have a train range of at least 2 frames that ends within the recording, got {train}")


def camera_rules(intrinsics, camera_to_world, width, height) -> Findings:
    """The rules of a ``Camera``. Returns both matrices as arrays."""
    intrinsics = yield from intrinsics_rules("intrinsics", intrinsics)
    camera_to_world = yield from pose_rules("camera_to_world", camera_to_world)
    if not all(isinstance(n, (int, np.integer)) and 1 <= n <= MAX_PIXELS for n in (width, height)):
        yield error("camera width and height", f"must be 1 to {MAX_PIXELS} pixels, got {shown(width)} x {shown(height)}")
    return intrinsics, camera_to_world


def intrinsics_rules(name, value) -> Findings:
    """[[fx, s, cx], [0, fy, cy], [0, 0, 1]] in pixels. Returns it as an array, or None."""
    k = yield from _square(name, value, 3)
    if k is None or (min(k[0, 0], k[1, 1]) > 0 and k[2].tolist() == [0, 0, 1] and k[1, 0] == 0):
        return k
    yield error(name, f"must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0 pixels, got {shown(k.tolist())}")
    return None


def pose_rules(name, value) -> Findings:
    """A rotation and a translation, camera to world. Returns it as an array (4, 4), or None."""
    pose = yield from _square(name, value, 4)
    if pose is None:
        return None
    turn = pose[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        turns = np.abs(turn.T @ turn - np.eye(3)).max() <= RIGID and np.linalg.det(turn) > 0
    if not (turns and np.abs(pose[3] - (0, 0, 0, 1)).max() <= RIGID):
        shape = "a rotation and a translation (camera to world)"
        return (yield error(name, f"must be {shape}, got the rows {shown([[round(float(x), 4) for x in row] for row in pose[:3]])}"))
    return None if (yield from _near(name, pose[:3, 3], np.zeros(3, bool))) else pose


def _square(name, value, size):
    found = yield from _array(name, value, str(size) * 2, {str(size): size})
    if found is not None and not np.isfinite(found).all():
        return (yield error(name, "must be finite, got NaN or infinity"))
    return found


def _is_number(value: Any) -> TypeGuard[Any]:
    """Whether it is a real number that can be compared with others, and no truth value."""
    return isinstance(value, Real) and not isinstance(value, (bool, np.bool_))
