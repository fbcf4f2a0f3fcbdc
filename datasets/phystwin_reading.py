"""The files of a case in the published PhysTwin layout as rules: what stands in them, and everything that is wrong with it.

``read_case`` raises the first error among these findings, ``check_case`` lists them all; there is no other reader.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..spelling import nearest
from .catalogue import CASES, self_collides
from .files import load_pickle, present, read_json
from .findings import UNREADABLE, Finding, Findings, attempt, changed, collected, count, error, refuse, shown, warning
from .phystwin_cameras import FPS, read_cameras, read_metadata
from .phystwin_images import CaseImages, object_label
from .plausible import plausible
from .rules import plane_rules, scenario_rules, split_rules
from .scenario import Plane, Split

__all__ = ["ARRAYS", "defaults", "name_of", "read_extra", "reading"]

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
_EXTRA = ("gravity", "ground", "object", "session", "self_collision", "grips", "colors", "timed", "correspond")
_DATA, _POSES, _TRACKS = "final_data.pkl", "calibrate.pkl", "gt_track_3d.pkl"
_SPLIT, _METADATA, _SCENARIO = "split.json", "metadata.json", "scenario.json"
_PLACES = {field: (_DATA, key) for key, field in ARRAYS.items()}  # field of Scenario -> file and what it is called there
_PLACES |= {"fps": (_METADATA, "fps"), "tracks": (_TRACKS, "the tracks"), "split": (_SPLIT, "frame_len")}


def reading(folder: Path) -> Findings:
    """All that is wrong with the case in ``folder``, images apart. Returns the arguments of its ``Scenario``, where there is no error."""
    arrays = yield from _arrays(folder / _DATA)
    values = {field: arrays[key] for key, field in ARRAYS.items() if key in arrays}
    told, extra = collected(_extra(folder))
    yield from told
    values |= {key: value for key, value in extra.items() if key != "colors"}
    if "colors" in extra:
        values.pop("colors", None)
    values["split"] = yield from _split(folder / _SPLIT, _frames(values))
    values["tracks"] = yield from _track_array(folder / _TRACKS)
    about = yield from read_metadata(folder / _METADATA, values["split"])
    values["fps"] = about.get("fps", FPS)

    good = yield from changed(scenario_rules(values), lambda finding: _in_file(folder, finding))
    values["cameras"] = yield from read_cameras(folder / _POSES, about)
    yield from changed(_conventions(good), lambda finding: _in_file(folder, finding))
    good |= {name: values[name] for name in ("ground", "cameras", "correspond")}
    if any(finding.severity == "error" for finding in told):
        for name in ("gravity", "ground"):  # the published ones need not be what scenario.json means
            good.pop(name, None)
    yield from changed(plausible(good), lambda finding: _in_file(folder, finding))
    yield from _labels(folder, len(values["cameras"]))
    if any((folder / kind).is_dir() for kind in ("color", "depth", "mask")):
        values["images"] = CaseImages(folder, len(good.get("points", ())))
    return {"name": name_of(folder), **values}


def name_of(folder: Path) -> str:
    """What a case is called: like its folder, be it a link or "."."""
    return os.path.basename(os.path.abspath(folder))


def _frames(values):
    points = values.get("points")
    return len(points) if points is not None and points.ndim == 3 else None


def _in_file(folder: Path, finding: Finding) -> Finding:
    """A finding about a field of the scenario as one about the file that it stands in."""
    if finding.field.startswith("camera_to_world"):
        return replace(finding, file=folder / _POSES, field=finding.field.replace("camera_to_world", "matrix"))
    file, key = _PLACES.get(finding.field, (_SCENARIO, finding.field))
    return replace(finding, file=folder / file, field=key)


def _arrays(file):
    """The arrays of final_data.pkl by key."""
    data = yield from attempt(file, load_pickle, file)
    if data is UNREADABLE:
        return {}
    if not isinstance(data, dict):
        yield error("", f"must hold a dict of arrays, got {_type(data)}", file)
        return {}
    found = {}
    for key, field in ARRAYS.items():
        if key not in data:
            kind = error if key in _REQUIRED else warning
            yield kind(key, f"is missing, among {shown(sorted(map(str, data)))}" if key in _REQUIRED else "is missing", file)
        elif not isinstance(value := data[key], np.ndarray) or value.dtype.kind not in "biuf":
            yield error(key, f"must be an array of numbers, got {_type(value)}", file)
        else:
            found[key] = value
            wanted = np.dtype(bool if field in ("visible", "motion_valid") else np.float64)
            if value.dtype != wanted:
                yield warning(key, f"is {value.dtype}; the published type is {wanted}", file)
    return found


def _type(value):
    return f"dtype {value.dtype}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}" if value is not None else "None"


def _track_array(file):
    if not present(file):
        yield warning("", "missing: the track error cannot be scored", file)
        return None
    tracks = yield from attempt(file, load_pickle, file)
    if tracks is UNREADABLE:
        return None
    if not isinstance(tracks, np.ndarray) or tracks.dtype.kind not in "biuf":
        return (yield error("the tracks", f"must be an array of numbers, got {_type(tracks)}", file))
    return tracks


def _split(file, frames):
    """The train and test ranges in ``file``, which must divide the frames in two, train first."""
    split = yield from attempt(file, read_json, file)
    if split is UNREADABLE:
        return None
    length, train, test = (split.get(key) for key in ("frame_len", "train", "test"))
    ranges = [r if isinstance(r, list) and len(r) == 2 else [None, None] for r in (train, test)]
    numbers = [length, *ranges[0], *ranges[1]]
    if not all(type(n) is int for n in numbers):
        rule = "must hold the integers frame_len, train [0, end) and test [end, frame_len)"
        return (yield error("", f"{rule}, got frame_len {shown(length)}, train {shown(train)}, test {shown(test)}", file))
    if frames not in (None, length):
        return (yield error("frame_len", f"must be the recording's {frames} frames, got {length}", file))
    _, start, end, test_start, test_end = numbers
    if start != 0 or test_start != end or test_end != length:
        return (yield error("train", f"must be [0, end) and test [end, {length}), got train {train} and test {test}", file))
    wrong, _ = collected(split_rules(end, length))
    yield from (replace(finding, file=file) for finding in wrong)
    if wrong:
        return None
    if end == length:
        yield warning("test", "is empty: future prediction cannot be scored", file)
    return Split(end, length)


def defaults(name: str) -> dict:
    """What a case is taken to be where no ``scenario.json`` says otherwise."""
    return {
        "gravity": [0.0, 0.0, 9.8],
        "ground": {"normal": [0.0, 0.0, -1.0], "offset": 0.0},
        "object": CASES[name].object if name in CASES else name,
        "session": name,
        "self_collision": self_collides(name),
        "timed": True,
        "correspond": True,
    }


def read_extra(folder: Path) -> dict:
    """What ``scenario.json`` says, over the published defaults. Raises ValueError naming the file."""
    return refuse(_extra(folder))


def _extra(folder):
    file = folder / _SCENARIO
    given = (yield from attempt(file, read_json, file)) if present(file) else {}
    given, extra = dict(given) if given is not UNREADABLE else {}, defaults(name_of(folder))
    for key in [key for key in given if key not in _EXTRA]:
        yield error(f"unknown key {shown(key)};", nearest(key, _EXTRA), file)
        del given[key]
    extra |= given
    if extra.get("colors") is not None:
        yield error("colors", f"may only be null (none were recorded), got {shown(extra['colors'])}", file)
    for key in ("object", "session"):
        if not isinstance(extra[key], str):
            yield error(key, f"must be a str, got {shown(extra[key])}", file)
            extra[key] = ""
    if not extra["object"]:
        yield warning("object", "is empty: which other recordings show it is not known, and no transfer is scored", file)
    for key in ("timed", "correspond"):
        if not isinstance(extra[key], bool):
            yield error(key, f"must be true or false, got {shown(extra[key])}", file)
            extra[key] = True
    extra["ground"] = yield from _ground(file, extra["ground"])
    return extra


def _ground(file, ground):
    if ground is None:
        return None
    if not isinstance(ground, dict) or set(ground) != {"normal", "offset"}:
        return (yield error("ground", f"must be null or a unit normal and an offset [m], got {shown(ground)}", file))
    wrong, _ = collected(plane_rules(**ground))
    yield from (replace(finding, file=file) for finding in wrong)
    return None if wrong else Plane(**ground)


def _conventions(good):
    """What the published files do, and nothing that is computed needs."""
    points, visible, valid = (good.get(name) for name in ("points", "visible", "motion_valid"))
    if visible is None:
        return
    if not visible[:1].all():
        hidden = count(~visible[0], "point")
        yield warning("visible", f"{hidden} not visible in frame 0, whose positions are taken for the body's structure")
    if points is not None and (bad := ~visible[1:] & (points[1:] != 0).any(-1)).any():
        yield warning("points", f"is not zero in {count(bad, 'invisible row')}")
    if valid is not None and len(valid):
        if valid[-1].any():
            yield warning("motion_valid", "speaks of the motion after the last frame; its last row must be False")
        if (bad := valid[:-1] & ~(visible[:-1] & visible[1:])).any():
            yield warning("motion_valid", f"is True for {count(bad, 'motion')} from or to an invisible point")


def _labels(folder, cameras):
    """Which mask is the object's: without that no mask of a camera is of use. A case may have no masks, or cleaned ones only."""
    if not (folder / "mask").is_dir():
        return
    for camera in range(cameras):
        file = folder / "mask" / f"mask_info_{camera}.json"
        if present(file) or not present(folder / "mask" / "processed_masks.pkl"):
            yield from attempt(file, object_label, folder, camera)
