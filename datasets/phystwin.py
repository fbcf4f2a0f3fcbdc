"""The published PhysTwin case layout: one folder per recording, read into a Scenario and written from one.

World axes are the calibration board's: the table is z = 0 and +z points into it, so gravity is +9.8 m/s^2 along z.
What the published files cannot say (another gravity, no table, grips, object, session) stands in an optional ``scenario.json``.
"""

from __future__ import annotations

import json
import pickle
import shutil
import tempfile
from pathlib import Path

import numpy as np

from . import safe_pickle
from .catalogue import CASES, self_collides
from .collection import nearest
from .phystwin_images import CaseImages, read_json, write_images
from .scenario import Camera, Plane, Scenario, Split

__all__ = ["ARRAYS", "read_arrays", "read_case", "read_extra", "read_split", "write_case"]

# key of final_data.pkl -> field of Scenario; the first four must be there
ARRAYS = {
    "object_points": "points",
    "object_visibilities": "visible",
    "object_motions_valid": "motion_valid",
    "controller_points": "controllers",
    "surface_points": "surface",
    "interior_points": "interior",
    "object_colors": "colors",
}
_REQUIRED = tuple(ARRAYS)[:4]
_EXTRA = ("gravity", "ground", "object", "session", "self_collision", "grips", "colors")


def read_case(folder: str | Path) -> Scenario:
    """The recording in ``folder``, named like it. Images are opened when asked for; cameras, images and tracks may be absent.

    Raises ValueError naming the file and what is wrong with it.
    """
    folder = Path(folder).resolve()
    data = read_arrays(folder / "final_data.pkl")
    extra = read_extra(folder)
    length = len(data["object_points"])
    split = read_split(folder / "split.json", length)
    metadata = read_json(folder / "metadata.json") if (folder / "metadata.json").exists() else {}
    tracks = folder / "gt_track_3d.pkl"
    values = {field: data[key] for key, field in ARRAYS.items() if key in data}
    values |= {k: v for k, v in extra.items() if k != "colors"}
    if "colors" in extra:
        values["colors"] = None
    try:
        return Scenario(
            name=folder.name,
            **values,
            split=split,
            fps=_fps(metadata),
            cameras=_read_cameras(folder, metadata),
            images=CaseImages(folder, length) if any((folder / kind).is_dir() for kind in ("color", "depth", "mask")) else None,
            tracks=safe_pickle.array_of(safe_pickle.load(tracks), tracks, "the content") if tracks.exists() else None,
        )
    except (ValueError, TypeError) as error:
        raise ValueError(f"{folder}: {error}") from None


def read_arrays(file: Path) -> dict:
    """The arrays of a ``final_data.pkl`` by their published keys. Raises ValueError where one that is needed is missing."""
    data = safe_pickle.load(file)
    if not isinstance(data, dict):
        raise ValueError(f"{file}: must hold a dict of arrays, got a {type(data).__name__}")
    missing = [key for key in _REQUIRED if key not in data]
    if missing:
        raise ValueError(f"{file}: {', '.join(missing)} missing; it holds {', '.join(map(str, data)) or 'nothing'}")
    for key in set(ARRAYS) & set(data):
        safe_pickle.array_of(data[key], file, key)
    if data["object_points"].ndim != 3:
        raise ValueError(f"{file}: object_points must have shape (frames, points, 3), got {data['object_points'].shape}")
    return data


def read_split(file: Path, frame_count: int) -> Split:
    """The train and test ranges in ``file``, which must divide ``frame_count`` frames in two, train first."""
    split = read_json(file)
    try:
        length, (start, end), (test_start, test_end) = split["frame_len"], split["train"], split["test"]
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{file}: must hold frame_len, train [0, end) and test [end, frame_len), got {split}") from None
    if not all(type(n) is int for n in (length, start, end, test_start, test_end)):
        raise ValueError(f"{file}: frame numbers must be integers, got {split}")
    if length != frame_count:
        raise ValueError(f"{file}: frame_len is {length}, but the recording has {frame_count} frames")
    if start != 0 or test_start != end or test_end != length:
        raise ValueError(f"{file}: train must be [0, end) and test [end, {length}), got train {split['train']} and test {split['test']}")
    try:
        return Split(end, length)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


def _defaults(name):
    """What a case is taken to be where no ``scenario.json`` says otherwise."""
    return {
        "gravity": [0.0, 0.0, 9.8],
        "ground": {"normal": [0.0, 0.0, -1.0], "offset": 0.0},
        "object": CASES[name].object if name in CASES else name,
        "session": name,
        "self_collision": self_collides(name),
    }


def read_extra(folder: Path) -> dict:
    """What ``scenario.json`` says, over the published defaults. Raises ValueError naming the file."""
    file = folder / "scenario.json"
    given = read_json(file) if file.exists() else {}
    for key in given:
        if key not in _EXTRA:
            raise ValueError(f"{file}: unknown key {key!r}; {nearest(key, _EXTRA)}")
    extra = _defaults(folder.name) | given
    for key, kind in (("object", str), ("session", str), ("self_collision", bool)):
        if not isinstance(extra[key], kind):
            raise ValueError(f"{file}: {key} must be a {kind.__name__}, got {extra[key]!r}")
    if extra.get("colors") is not None:
        raise ValueError(f"{file}: colors may only be null (none were recorded), got {extra['colors']!r}")
    if extra["ground"] is not None:
        try:
            extra["ground"] = Plane(np.array(extra["ground"]["normal"], float), float(extra["ground"]["offset"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{file}: ground must be null or a unit normal and an offset [m]: {error}") from None
    return extra


def _fps(metadata):
    fps = metadata.get("fps", 30.0)
    if type(fps) not in (int, float) or not 0 < fps < float("inf"):
        raise ValueError(f"metadata.json: fps must be a number > 0, got {fps!r}")
    return float(fps)


def _read_cameras(folder, metadata):
    file = folder / "calibrate.pkl"
    if not file.exists() or not metadata.get("intrinsics"):
        return ()
    poses, intrinsics = safe_pickle.numbers_of(safe_pickle.load(file), file, "the content"), metadata["intrinsics"]
    if poses.ndim != 3 or len(poses) != len(intrinsics):
        raise ValueError(f"calibrate.pkl must hold one 4 x 4 matrix for each of the {len(intrinsics)} cameras of metadata.json")
    try:
        width, height = metadata["WH"]
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"metadata.json: WH must be [width, height] in pixels, got {metadata.get('WH')}") from None
    return tuple(Camera(np.array(k), np.array(pose), width, height) for k, pose in zip(intrinsics, poses, strict=True))


def write_case(
    folder: str | Path, scenario: Scenario, *, color=None, depth=None, masks=None, hand_masks=None, overwrite: bool = False
) -> Path:
    """Write ``scenario`` as a case in the published layout and return its folder, which becomes its name.

    color, depth, masks, hand_masks: sequences camera -> frame -> array, as ``write_images`` takes them; any may be None.
    Points and colours of invisible points are written as zeros, but for the positions of frame 0, which are the body's structure.
    All is written beside ``folder`` and renamed at the end, so that a failure leaves nothing half-written.
    Raises ValueError where ``folder`` exists (unless ``overwrite``, and then only a case is replaced), OSError where the disk is full.
    """
    folder = Path(folder).resolve()
    _may_write(folder, overwrite)
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".partial", dir=folder.parent))
    try:
        _write_scenario(temporary, folder.name, scenario)
        label = CASES[folder.name].category if folder.name in CASES else "object"
        pictures = {"color": color, "depth": depth, "masks": masks, "hand_masks": hand_masks}
        write_images(temporary, scenario.frame_count, **pictures, label=label, cameras=scenario.cameras)
        temporary.chmod(0o755)  # mkdtemp makes it private
        if folder.exists() and any(folder.iterdir()):
            _exchange(temporary, folder)
        else:
            temporary.rename(folder)
    except BaseException as error:
        shutil.rmtree(temporary, ignore_errors=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, f"writing the case {folder} failed, nothing of it was kept: {error.strerror or error}") from error
        raise
    return folder


def _exchange(new, folder):
    """Put ``new`` in the place of ``folder``; where that fails ``folder`` is as it was."""
    old = new.with_suffix(".old")
    folder.rename(old)
    try:
        new.rename(folder)
    except BaseException:
        old.rename(folder)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _may_write(folder, overwrite):
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ValueError(f"{folder}: a case is a folder, but a file of that name is there")
    if any(folder.iterdir()):
        if not overwrite:
            raise ValueError(f"{folder}: already exists; pass overwrite=True to replace it")
        if not (folder / "final_data.pkl").exists():
            raise ValueError(f"{folder}: is not a case (it has no final_data.pkl), so it is not overwritten")


def _write_scenario(folder, name, scenario):
    data = {key: getattr(scenario, field) for key, field in ARRAYS.items()}
    seen = scenario.visible[..., None]
    data["object_points"] = np.where(seen, scenario.points, 0.0)
    data["object_points"][0] = scenario.points[0]
    data["object_colors"] = np.zeros_like(scenario.points) if scenario.colors is None else np.where(seen, scenario.colors, 0.0)
    _dump(folder / "final_data.pkl", data)
    if scenario.tracks is not None:
        _dump(folder / "gt_track_3d.pkl", scenario.tracks)
    end, length = scenario.split.train_end, scenario.frame_count
    _write_json(folder / "split.json", {"frame_len": length, "train": [0, end], "test": [end, length]})
    metadata = {"intrinsics": [c.intrinsics.tolist() for c in scenario.cameras], "fps": scenario.fps, "frame_num": length}
    metadata |= {"serial_numbers": [str(i) for i in range(len(scenario.cameras))], "start_step": 0, "end_step": length - 1}
    if scenario.cameras:
        sizes = {(c.width, c.height) for c in scenario.cameras}
        if len(sizes) > 1:
            raise ValueError(f"all cameras of a case must have one image size, got {sorted(sizes)} (scenario {scenario.name})")
        metadata["WH"] = list(map(int, sizes.pop()))
        _dump(folder / "calibrate.pkl", [c.camera_to_world for c in scenario.cameras])
    _write_json(folder / "metadata.json", metadata)
    extra = _extra_of(scenario)
    extra = {key: value for key, value in extra.items() if key not in (usual := _defaults(name)) or value != usual[key]}
    if extra:
        _write_json(folder / "scenario.json", extra)


def _extra_of(scenario):
    extra = {key: getattr(scenario, key) for key in ("object", "session", "self_collision")}
    extra["gravity"] = scenario.gravity.tolist()
    ground = scenario.ground
    extra["ground"] = None if ground is None else {"normal": ground.normal.tolist(), "offset": float(ground.offset)}
    if (scenario.grips >= 0).any():
        extra["grips"] = scenario.grips.tolist()
    if scenario.colors is None:
        extra["colors"] = None
    return extra


def _dump(file, value):
    with file.open("wb") as stream:
        pickle.dump(value, stream, protocol=4)


def _write_json(file, value):
    file.write_text(json.dumps(value), encoding="utf-8")
