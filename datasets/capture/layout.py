"""The neutral layout of raw recordings: ``recording.json`` and folders of pictures. Any camera's pictures can be described by it.

    {"gravity": [0, 0, 9.8], "ground": {"normal": [0, 0, -1], "offset": 0},       or left out: z points into a table at 0
     "cameras": {"left": {
        "size": [848, 480], "intrinsics": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
        "camera_to_world": [[...], ...],              4 x 4, or left out: not calibrated
        "depth_unit": 0.001,                          metres for a count
        "color": "left/color/{}.png", "depth": "left/depth/{}.png",   {} is the number of the frame, with zeros before it or without
        "stamps": [0.0, 0.0333, ...],                 seconds, one for each frame; or, where nobody wrote them down, "fps": 30
        "arrivals": [...],                            seconds in the computer's clock, or left out
        "background": ["left/empty.png", "left/empty_depth.png"],     of the empty scene, or left out
        "depth_size": [256, 192],                     of depth that shows what colour shows in fewer pixels, as phones', or left out
        "distortion": [k1, k2, p1, p2, k3]            OpenCV's 4, 5 or 8 of colour and depth, which are undistorted, or left out
    }}}

Colour is PNG or JPEG, or one video file (then without {}); depth is 16-bit PNG, or .npy of integers. Frames are counted from the lowest
number that is there. A folder of PNGs of another program needs no copy: its ``recording.json``, or ``recording.yaml``, says where they are.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..findings import shown
from ..rules import MAX_PIXELS
from ..scenario import Plane
from ..temporary import scratch
from .manifest import MANIFEST, manifest, read_manifest, write_manifest
from .pictures import PictureFiles, write_color, write_depth
from .recording import RawCamera, RawRecording
from .undistorting import Undistorted

__all__ = ["MANIFEST", "put_poses", "read_layout", "write_layout"]

_NEEDED = {"size", "intrinsics", "depth_unit", "color", "depth"}
_KEYS = _NEEDED | {"camera_to_world", "stamps", "fps", "arrivals", "background", "depth_size", "distortion"}


def read_layout(folder: str | Path) -> RawRecording:
    """The recording that ``recording.json`` or ``recording.yaml`` in ``folder`` describes.

    Pictures are opened when asked for; that they are there is checked now.
    Raises ValueError naming the file, the camera, the field, the rule and the value.
    """
    folder = Path(folder)
    file = manifest(folder) or folder / MANIFEST
    about = read_manifest(file)
    cameras = about.get("cameras")
    if not {"cameras"} <= set(about) <= {"cameras", "gravity", "ground"} or not isinstance(cameras, dict) or not cameras:
        raise ValueError(f"{file}: must hold cameras, one or more by name, and may hold gravity and ground, got {shown(about)}")
    try:
        found = tuple(_camera(folder, name, entry) for name, entry in cameras.items())
        return RawRecording(folder.resolve().name, found, **_world(about))
    except ValueError as failure:
        raise ValueError(f"{file}: {failure}") from None


def _world(about):
    """Gravity and table, where the recording says them."""
    found = {}
    if "gravity" in about:
        gravity = about["gravity"]
        if not isinstance(gravity, list) or len(gravity) != 3 or not all(type(x) in (int, float) for x in gravity):
            raise ValueError(f"gravity must be three numbers [m/s^2], got {shown(gravity)}")
        found["gravity"] = np.array(gravity, float)
    if "ground" in about:
        ground = about["ground"]
        if ground is not None and (not isinstance(ground, dict) or set(ground) != {"normal", "offset"}):
            raise ValueError(f"ground must be null or a unit normal and an offset [m], got {shown(ground)}")
        found["ground"] = None if ground is None else Plane(**ground)
    return found


def _camera(folder, name, entry):
    if not isinstance(entry, dict) or not _NEEDED <= set(entry) <= _KEYS:
        got = sorted(entry) if isinstance(entry, dict) else shown(entry)
        raise ValueError(
            f"camera {name} must have {', '.join(sorted(_NEEDED))}, and may have {', '.join(sorted(_KEYS - _NEEDED))}, got {got}"
        )
    stamps, fps = entry.get("stamps"), entry.get("fps")
    if (stamps is None) == (fps is None):
        raise ValueError(f"camera {name} must have either stamps or fps, got {'neither' if fps is None else 'both'}")
    size, depth_size = entry["size"], entry.get("depth_size")
    for key, value in (("size", size), ("depth_size", size if depth_size is None else depth_size)):
        if not (isinstance(value, list) and len(value) == 2 and all(type(n) is int and 0 < n <= MAX_PIXELS for n in value)):
            raise ValueError(f"{key} of camera {name} must be [width, height], got {shown(value)}")
    for key in ("color", "depth"):
        _check_inside(name, key, entry[key])
    background = entry.get("background")
    if background is not None:
        if not isinstance(background, list) or len(background) != 2:
            raise ValueError(f"background of camera {name} must be a colour and a depth file, got {shown(background)}")
        for one in background:
            _check_inside(name, "background", one)
    frames = PictureFiles(folder, name, entry["color"], entry["depth"], tuple(size), background, depth_size and tuple(depth_size))
    if stamps is None:
        if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps <= 1000:
            raise ValueError(f"fps of camera {name} must be a number in (0, 1000], got {shown(fps)}")
        stamps = np.arange(len(frames)) / fps
    camera = RawCamera(
        name,
        entry["intrinsics"],
        entry.get("camera_to_world"),
        *size,
        stamps=stamps,
        depth_unit=float(entry["depth_unit"]) if type(entry["depth_unit"]) in (int, float) else entry["depth_unit"],
        frames=frames,
        arrivals=entry.get("arrivals"),
    )
    if len(frames) != camera.frame_count:
        raise ValueError(f"stamps of camera {name} must be one for each of {len(frames)} pictures, got {camera.frame_count}")
    bent = entry.get("distortion")
    return camera if bent is None else replace(camera, frames=Undistorted.of(camera, bent))


def _check_inside(camera, key, pattern):
    """A path within the folder, so that a recording from elsewhere opens nothing but its own files."""
    parts = re.split(r"[/\\]", pattern) if isinstance(pattern, str) else [".."]
    if ".." in parts or pattern.startswith(("/", "\\")) or ":" in pattern or "\0" in pattern or pattern.count("{}") > 1:
        raise ValueError(
            f"{key} of camera {camera} must be a path within the folder, with {{}} for the frame at most once, got {shown(pattern)}"
        )


def write_layout(folder: str | Path, recording: RawRecording) -> Path:
    """Write a recording of cameras; it appears whole or not at all. Colour and depth come back to the bit.

    Raises ValueError where ``folder`` exists already or the recording has clouds, OSError where the disk refuses.
    """
    folder = Path(folder).resolve()
    if folder.exists():
        raise ValueError(f"{folder}: already exists; recordings are not replaced")
    if not recording.cameras:
        raise ValueError(f"recording {recording.name}: has clouds and no cameras, so there are no pictures to write")
    with scratch(folder.parent, folder) as temporary:
        target = temporary / "recording"
        about = {camera.name: _write_camera(target, camera) for camera in recording.cameras}
        (target / MANIFEST).write_text(json.dumps(_said(recording) | {"cameras": about}), encoding="utf-8")
        target.rename(folder)
    return folder


def _said(recording):
    """Gravity and table as JSON."""
    ground = recording.ground
    plane = None if ground is None else {"normal": ground.normal.tolist(), "offset": float(ground.offset)}
    return {"gravity": np.asarray(recording.gravity, float).tolist(), "ground": plane}


def put_poses(folder: str | Path, poses: dict[str, np.ndarray], world: RawRecording) -> None:
    """Write poses (4, 4) by camera, and the gravity and table of ``world``, into the ``recording.json`` in ``folder``.

    Raises ValueError naming the file where it is no recording, or the cameras are not the same.
    """
    read_layout(folder)
    file = manifest(Path(folder))
    assert file is not None  # read_layout has read it
    about = read_manifest(file)
    if set(about["cameras"]) != set(poses):
        raise ValueError(f"{file}: must have the cameras that were calibrated, {sorted(poses)}, got {sorted(about['cameras'])}")
    for name, pose in poses.items():
        about["cameras"][name]["camera_to_world"] = np.asarray(pose).tolist()
    write_manifest(file, about | _said(world))


def _write_camera(folder, camera):
    if not re.fullmatch(r"[\w-]+(\.[\w-]+)*", camera.name):
        raise ValueError(f"the name of a camera must be letters, digits, '.', '_' and '-', got {shown(camera.name)}")
    for t in range(camera.frame_count):
        write_color(folder / camera.name / "color" / f"{t:06d}.png", camera.frames.color(t))
        write_depth(folder / camera.name / "depth" / f"{t:06d}.png", camera.frames.depth(t))
    entry = {
        "size": [camera.width, camera.height],
        "intrinsics": camera.intrinsics.tolist(),
        "depth_unit": camera.depth_unit,
        "color": f"{camera.name}/color/{{}}.png",
        "depth": f"{camera.name}/depth/{{}}.png",
        "stamps": camera.stamps.tolist(),
    }
    if camera.camera_to_world is not None:
        entry["camera_to_world"] = camera.camera_to_world.tolist()
    if camera.arrivals is not None:
        entry["arrivals"] = camera.arrivals.tolist()
    if (background := camera.frames.background()) is not None:
        entry["background"] = [f"{camera.name}/background_color.png", f"{camera.name}/background_depth.png"]
        write_color(folder / entry["background"][0], background[0])
        write_depth(folder / entry["background"][1], background[1])
    return entry
