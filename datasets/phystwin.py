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

from .catalogue import CASES
from .findings import refuse
from .phystwin_images import write_images
from .phystwin_reading import ARRAYS, defaults, reading
from .scenario import Scenario

__all__ = ["read_case", "write_case"]


def read_case(folder: str | Path) -> Scenario:
    """The recording in ``folder``, named like it. Images are opened when asked for; cameras, images and tracks may be absent.

    Raises ValueError naming the file, the field, the rule and the value: the first error that ``check_case`` finds.
    """
    return Scenario(**refuse(reading(Path(folder))))


def write_case(
    folder: str | Path, scenario: Scenario, *, color=None, depth=None, masks=None, hand_masks=None, overwrite: bool = False
) -> Path:
    """Write ``scenario`` as a case in the published layout and return its folder, which becomes its name.

    color, depth, masks, hand_masks: sequences camera -> frame -> array, as ``write_images`` takes them; any may be None.
    Points and colours of invisible points are written as zeros, but for the positions of frame 0, which are the body's structure.
    All is written beside ``folder`` and renamed at the end, so that a failure leaves nothing half-written.
    Raises ValueError where ``folder`` exists (unless ``overwrite``, and then only a case is replaced), OSError where the disk is full.
    """
    folder, temporary = Path(folder).resolve(), None
    _may_write(folder, overwrite)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".partial", dir=folder.parent))
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
        if temporary:
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
            raise ValueError(f"{folder}: already exists; pass overwrite=True (--overwrite) to replace it")
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
    extra = {key: value for key, value in extra.items() if key not in (usual := defaults(name)) or value != usual[key]}
    if extra:
        _write_json(folder / "scenario.json", extra)


def _extra_of(scenario):
    extra = {key: getattr(scenario, key) for key in ("object", "session", "self_collision", "timed", "correspond")}
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
