"""The checker: a clean case has no findings, each fault is found in its file, and nothing makes it raise."""

import io
import json
import math
import os
import pickle
import re
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from clean_case import POSE, clean
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from twinbench.datasets.check import Finding, check, check_case
from twinbench.datasets.collection import open_collection
from twinbench.datasets.phystwin import read_case, write_case

AWAY = np.array([[1.0, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, -0.8], [0, 0, 0, 1]])  # neither this nor its inverse sees the body
INSIDE = np.array([[1.0, 0, 0, 0.01], [0, 1, 0, 0.01], [0, 0, 1, -0.095], [0, 0, 0, 1]])


def test_a_clean_case_has_no_findings(tmp_path):
    assert check(clean(tmp_path / "case")) == []


def test_a_case_of_geometry_only_has_warnings_but_no_error(tmp_path):
    """Five files suffice for the physics; the checker says what the case cannot be used for."""
    whole = read_case(clean(tmp_path / "case"))
    bare = write_case(tmp_path / "bare", replace(whole, cameras=(), images=None, tracks=None))
    found = check(bare)
    assert {f.severity for f in found} == {"warning"}
    assert {f.file.name for f in found} == {"metadata.json", "calibrate.pkl", "gt_track_3d.pkl", "color", "depth", "mask"}


def edit(key, change):
    """A fault that changes one array of final_data.pkl; None drops it."""

    def apply(folder):
        data = pickle.loads((folder / "final_data.pkl").read_bytes())
        value = change(data[key].copy())
        data = {k: v for k, v in data.items() if k != key} | ({} if value is None else {key: value})
        (folder / "final_data.pkl").write_bytes(pickle.dumps(data))

    return apply


def put(at, value):
    def change(array):
        array[at] = value
        return array

    return change


def merge(name, **changes):
    return lambda folder: (folder / name).write_text(json.dumps(json.loads((folder / name).read_text()) | changes))


def write(name, content):
    data = content if isinstance(content, bytes) else pickle.dumps(content)
    return lambda folder: (folder / name).write_bytes(data)


def cut(name, length):
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:length])


def remove(*names):
    return lambda folder: [(folder / name).unlink() for name in names]


def save(name, array):
    return lambda folder: np.save(folder / name, array)


def millimetres(folder):
    for key, shift in ((POINTS, 0), (HANDS, [0, 0, 0.02])):
        edit(key, lambda a, shift=shift: (a + shift) * 1000)(folder)
    (folder / "gt_track_3d.pkl").write_bytes(pickle.dumps(1000 * pickle.loads((folder / "gt_track_3d.pkl").read_bytes())))


def kilometres(folder):
    for key in (POINTS, HANDS, "surface_points", "interior_points"):
        edit(key, lambda a: a / 1000)(folder)
    (folder / "gt_track_3d.pkl").unlink()


def upside_down(folder):
    for key in (POINTS, HANDS):
        edit(key, lambda a: a * [1, 1, -1])(folder)
    (folder / "gt_track_3d.pkl").unlink()


def extra(**content):
    return write("scenario.json", json.dumps(content).encode())


def cleaned(masks):
    """Cleaned masks instead of segmentations."""

    def apply(folder):
        remove("mask/mask_info_0.json", "mask/mask_info_1.json")(folder)
        write("mask/processed_masks.pkl", masks)(folder)

    return apply


def flip(name, at):
    """One bit of a file is another."""

    def apply(folder):
        data = bytearray((folder / name).read_bytes())
        data[at] ^= 1
        (folder / name).write_bytes(data)

    return apply


def png(width, height, bits=8):
    """A grey image of zeros, or no more than a header where it would be large: PNG specification, sections 5 and 11."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"" if width > 100 else bytes((1 + width * bits // 8) * height)
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def depth_header(shape):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<u2", "fortran_order": False, "shape": shape})
    return stream.getvalue()


def pipe(name):
    def apply(folder):
        (folder / name).unlink()
        os.mkfifo(folder / name)  # whoever opens it waits for somebody who writes

    return apply


def folder_of(name):
    return lambda folder: ((folder / name).unlink(), (folder / name).mkdir())


def link(name, to):
    return lambda folder: ((folder / name).unlink(missing_ok=True), (folder / name).symlink_to(to))


class Malicious:
    def __reduce__(self):
        return os.system, ("exit 1",)


SCALED = np.diag([2.0, 1, 1, 1])
MIRRORED = np.diag([-1.0, 1, 1, 1])
LAST = np.s_[-1]
POINTS, SEEN, VALID, HANDS = "object_points", "object_visibilities", "object_motions_valid", "controller_points"
FAULTS = {
    "no final_data": (remove("final_data.pkl"), "error", "final_data.pkl", "missing"),
    "no split": (remove("split.json"), "error", "split.json", "missing"),
    "no metadata": (remove("metadata.json"), "warning", "metadata.json", "missing"),
    "no poses": (remove("calibrate.pkl"), "warning", "calibrate.pkl", "missing"),
    "no tracks": (remove("gt_track_3d.pkl"), "warning", "gt_track_3d.pkl", "track error cannot be scored"),
    "truncated": (cut("final_data.pkl", 500), "error", "final_data.pkl", "not a complete pickle"),
    "malicious": (write("final_data.pkl", {POINTS: Malicious()}), "error", "final_data.pkl", r"refused, it calls for (posix|nt)\.system"),
    "malicious poses": (write("calibrate.pkl", [Malicious()]), "error", "calibrate.pkl", "refused"),
    "malicious tracks": (write("gt_track_3d.pkl", Malicious()), "error", "gt_track_3d.pkl", "refused"),
    "malicious masks": (cleaned(Malicious()), "warning", "mask/processed_masks.pkl", "refused"),
    "a list": (write("final_data.pkl", [1]), "error", "final_data.pkl", "must hold a dict"),
    "no points": (edit(POINTS, lambda a: None), "error", "final_data.pkl", "object_points is missing"),
    "no surface": (edit("surface_points", lambda a: None), "warning", "final_data.pkl", "surface_points is missing"),
    "flat": (
        edit(POINTS, lambda a: a[0]),
        "error",
        "final_data.pkl",
        r"object_points must have shape \(frames, points, 3\), got \(18, 3\)",
    ),
    "no frames": (edit(POINTS, lambda a: a[:0]), "error", "final_data.pkl", "at least one frame"),
    "more flags": (
        edit(SEEN, lambda a: a[:, 1:]),
        "error",
        "final_data.pkl",
        r"object_visibilities must have shape \(5, 18\), got \(5, 17\)",
    ),
    "short hands": (edit(HANDS, lambda a: a[1:]), "error", "final_data.pkl", r"must have shape \(5, controllers, 3\), got \(4, 2, 3\)"),
    "text": (edit(POINTS, lambda a: a.astype(str)), "error", "final_data.pkl", "must be an array of numbers, got dtype <U"),
    "objects": (edit(POINTS, lambda a: a.astype(object)), "error", "final_data.pkl", "must be an array of numbers, got dtype object"),
    "float32": (edit(POINTS, lambda a: a.astype("f4")), "warning", "final_data.pkl", "float32; the published type is float64"),
    "flags as numbers": (edit(SEEN, lambda a: a.astype("u1")), "warning", "final_data.pkl", "published type is bool"),
    "confidences": (edit(SEEN, lambda a: a * 0.7), "error", "final_data.pkl", "values other than 0 and 1"),
    "NaN seen": (
        edit(POINTS, put((3, 1), np.nan)),
        "error",
        "final_data.pkl",
        "must be finite wherever visible, got NaN or infinity in 1 row, first in frame 3",
    ),
    "NaN start": (edit(POINTS, put((0, 1), np.inf)), "error", "final_data.pkl", "NaN or infinity in 1 row, first in frame 0"),
    "NaN hidden": (edit(POINTS, put((2, 3), np.nan)), "warning", "final_data.pkl", "not zero in 1 invisible row"),
    "hidden not 0": (edit(POINTS, put((2, 3), 0.1)), "warning", "final_data.pkl", "not zero in 1 invisible row"),
    "NaN hands": (
        edit(HANDS, put((4, 1), np.nan)),
        "error",
        "final_data.pkl",
        "controller_points must be finite, got NaN or infinity in 1 row",
    ),
    "NaN inside": (edit("interior_points", lambda a: np.full((2, 3), np.nan)), "error", "final_data.pkl", "interior_points must be finite"),
    "colors in 255": (edit("object_colors", lambda a: a * 255), "warning", "final_data.pkl", r"must lie in \[0, 1\]"),
    "hidden start": (edit(SEEN, put((0, 2), False)), "warning", "final_data.pkl", "1 point not visible in frame 0"),
    "blind frame": (edit(SEEN, put(3, False)), "warning", "final_data.pkl", "False for every point in 1 frame, first in frame 3"),
    "last motion": (edit(VALID, put(LAST, True)), "warning", "final_data.pkl", "last row must be False"),
    "ghost motion": (edit(VALID, put((2, 3), True)), "warning", "final_data.pkl", "1 motion from or to an invisible point"),
    "millimetres": (
        millimetres,
        "error",
        "final_data.pkl",
        r"in metres, got a body that is 20 m long in frame 0: are these mill.* it is 0.02",
    ),
    "in kilometres": (kilometres, "warning", "final_data.pkl", "are the units metres"),
    "upside down": (
        upside_down,
        "error",
        "scenario.json",
        r"gravity points upwards for these data, got \[0.0, 0.0, 9.8\]: .* 0.12 m below",
    ),
    "gravity upwards": (extra(gravity=[0, 0, -9.8]), "error", "scenario.json", "gravity must point to the table"),
    "no table, gravity upwards": (
        extra(gravity=[0, 0, -9.8], ground=None),
        "warning",
        "scenario.json",
        "gravity may point upwards for these data",
    ),
    "twins": (edit(POINTS, lambda a: put(np.s_[:, 0], a[:, 1])(a)), "warning", "final_data.pkl", "1 particle of frame 0 lie"),
    "under the table": (edit(POINTS, put((1, 0, 2), 0.01)), "warning", "final_data.pkl", "1 mm below the table"),
    "far hands": (
        edit(HANDS, lambda a: a - [0, 0, 0.1]),
        "error",
        "final_data.pkl",
        "controller_points must be within reach of the body, 0.08 m, got 0.11 m",
    ),
    "one far hand": (edit(HANDS, put((0, 1, 2), -1)), "warning", "final_data.pkl", "1 controller more than 0.08 m away"),
    "no hands": (edit(HANDS, lambda a: a[:, :0]), "warning", "final_data.pkl", "nothing drives the body"),
    "empty train": (merge("split.json", train=[0, 0], test=[0, 5]), "error", "split.json", "a train range of at least 2 frames"),
    "other length": (merge("split.json", frame_len=6), "error", "split.json", "frame_len must be the recording's 5 frames, got 6"),
    "no test": (merge("split.json", train=[0, 5], test=[5, 5]), "warning", "split.json", "test is empty"),
    "split is text": (write("split.json", b"70%"), "error", "split.json", "not a JSON file"),
    "fps": (merge("metadata.json", fps="30"), "error", "metadata.json", "fps must be a number from 0.1"),
    "frame_num": (merge("metadata.json", frame_num=9), "warning", "metadata.json", "frame_num is 9"),
    "no intrinsics": (merge("metadata.json", intrinsics=[]), "warning", "metadata.json", "no intrinsics"),
    "flat intrinsics": (
        merge("metadata.json", intrinsics=[[1, 2, 3]]),
        "error",
        "metadata.json",
        r"intrinsics of camera 0 must have shape \(3, 3\), got \(3,\)",
    ),
    "transposed": (
        merge("metadata.json", intrinsics=[[[50, 0, 0], [0, 50, 0], [4, 3, 1]]] * 2),
        "error",
        "metadata.json",
        "of camera 0 must be",
    ),
    "off centre": (
        merge("metadata.json", intrinsics=[[[50, 0, -4], [0, 50, 3], [0, 0, 1]]] * 2),
        "warning",
        "metadata.json",
        "lies outside",
    ),
    "WH": (merge("metadata.json", WH=[8]), "error", "metadata.json", "WH must be"),
    "one pose": (
        write("calibrate.pkl", [np.eye(4)]),
        "error",
        "calibrate.pkl",
        "one matrix for each of the 2 cameras of metadata.json, got 1",
    ),
    "scaled": (write("calibrate.pkl", [np.eye(4), SCALED]), "error", "calibrate.pkl", "camera 1 must be a rotation and a translation"),
    "mirrored": (write("calibrate.pkl", [MIRRORED, np.eye(4)]), "error", "calibrate.pkl", "camera 0 must be a rotation"),
    "3 x 4": (write("calibrate.pkl", [np.eye(4)[:3]] * 2), "error", "calibrate.pkl", r"must have shape \(4, 4\), got \(3, 4\)"),
    "poses dict": (write("calibrate.pkl", {"a": 1}), "error", "calibrate.pkl", "must hold a list"),
    "tracks short": (write("gt_track_3d.pkl", np.zeros((4, 9, 3))), "error", "gt_track_3d.pkl", "must have shape"),
    "tracks inf": (
        write("gt_track_3d.pkl", np.full((5, 9, 3), np.inf)),
        "error",
        "gt_track_3d.pkl",
        "must lie within 1000 m of the origin, got inf",
    ),
    "tracks late": (write("gt_track_3d.pkl", put(0, np.nan)(np.zeros((5, 9, 3)))), "warning", "gt_track_3d.pkl", "in frame 0"),
    "scenario": (write("scenario.json", b'{"fbs": 3}'), "error", "scenario.json", "unknown key 'fbs'"),
    "color gone": (remove("color/1/2.png", "color/1/4.png"), "warning", "color/1", "2 of 5 frames are missing: 2, 4"),
    "depth gone": (remove("depth/0/0.npy", "depth/0/1.npy"), "warning", "depth/0", "2 of 5 frames are missing: 0-1"),
    "mask gone": (remove("mask/0/1/3.png"), "warning", "mask/0/1", "1 of 5 frames are missing: 3"),
    "depth size": (save("depth/1/3.npy", np.zeros((5, 8), "u2")), "warning", "depth/1", "must be 8 x 6 pixels, got 8 x 5 in frames 3"),
    "depth metres": (save("depth/1/3.npy", np.zeros((6, 8))), "warning", "depth/1", "integer millimetres"),
    "depth cut": (cut("depth/1/3.npy", 140), "warning", "depth/1", "unreadable frames 3, .*; frame 3: must be 224 bytes long"),
    "depth pickled": (save("depth/1/3.npy", np.array([None])), "warning", "depth/1", "unreadable frames 3"),
    "color cut": (cut("color/0/1.png", 50), "warning", "color/0", "unreadable frames 1, .*; frame 1: the image must be complete"),
    "color is text": (write("color/0/1.png", b"no image"), "warning", "color/0", "not a PNG image"),
    "one too many": (write("color/0/9.png", b"x"), "warning", "color/0", "frames after the last one, 4: 9"),
    "no labels": (remove("mask/mask_info_1.json"), "error", "mask/mask_info_1.json", "missing"),
    "two objects": (write("mask/mask_info_1.json", b'{"0": "a", "1": "b"}'), "error", "mask/mask_info_1.json", "exactly one label"),
    "no hand label": (write("mask/mask_info_1.json", b'{"1": "b"}'), "warning", "mask/mask_info_1.json", "cannot leave out the hands"),
    "few masks": (cleaned({}), "warning", "mask/processed_masks.pkl", "holds 0 frames, but final_data.pkl has 5"),
    "half masks": (
        cleaned([[{"object": np.ones((6, 8), bool)}] * 2] * 5),
        "warning",
        "mask/processed_masks.pkl",
        "'controller' of frame 0",
    ),
    "flat masks": (
        cleaned([[{"object": np.ones(6)}] * 2] * 5),
        "warning",
        "mask/processed_masks.pkl",
        r"must be a \(height, width\) array",
    ),
    "color flipped": (flip("color/0/1.png", 45), "warning", "color/0", r"unreadable frames 1, .* chunk b'IDAT' at byte 33 must have"),
    "color of all": (
        write("color/0/1.png", png(100_000, 100_000)),
        "warning",
        "color/0",
        "1 to 16384 pixels wide and high, got 100000 x 100000",
    ),
    "color of 16 bits": (write("color/0/1.png", png(8, 6, bits=16)), "warning", "color/0", "at most 8 bits a channel"),
    "depth of all": (write("depth/0/1.npy", depth_header((10**9, 10**9))), "warning", "depth/0", r"got \(1000000000, 1000000000\) uint16"),
    "labels of a list": (write("mask/mask_info_1.json", b'{"1": ["a"]}'), "error", "mask/mask_info_1.json", r"got '1': \['a'\]"),
    "NaN ground": (
        extra(ground={"normal": [0, 0, -1], "offset": math.nan}),
        "error",
        "scenario.json",
        "ground.offset must be a finite number",
    ),
    "long normal": (extra(ground={"normal": [0, 0, -2], "offset": 0}), "error", "scenario.json", "ground normal must be a unit vector"),
    "half a ground": (extra(ground={"normal": [0, 0, -1]}), "error", "scenario.json", "ground must be null or a unit normal and an offset"),
    "half a grip": (extra(grips=[0.5, -1]), "error", "scenario.json", r"grips must be integers, got \[0.5, -1.0\]"),
    "grip of nobody": (extra(grips=[18, -1]), "error", "scenario.json", "grips must be -1 or the index of one of the 18 points"),
    "gravity in mm": (extra(gravity=[0, 0, 9810]), "error", "scenario.json", r"gravity must be at most 100 m/s\^2, got 9810"),
    "no gravity": (extra(gravity=None), "error", "scenario.json", r"gravity must have shape \(3,\), got \(\)"),
    "nothing": (write("final_data.pkl", None), "error", "final_data.pkl", "must hold a dict of arrays, got None"),
    "flat gravity": (extra(gravity=9.8), "error", "scenario.json", r"gravity must have shape \(3,\), got \(\)"),
    "object": (extra(object=["a"]), "error", "scenario.json", r"object must be a str, got \['a'\]"),
    "twice": (write("scenario.json", b'{"object": "a", "object": "b"}'), "error", "scenario.json", "'object' must be given once"),
    "deep": (write("metadata.json", b'{"fps": ' + b"[" * 100_000), "error", "metadata.json", "nested at most 32 deep"),
    "less deep": (
        write("metadata.json", b'{"fps": ' + b"[" * 40 + b"]" * 40 + b"}"),
        "error",
        "metadata.json",
        r"fps\[0\]\[0\] must be nested at most 32",
    ),
    "fps beyond all": (merge("metadata.json", fps=10**400), "error", "metadata.json", "fps must be a finite number of at most 18 digits"),
    "fps in ns": (
        merge("metadata.json", fps=10**9),
        "error",
        "metadata.json",
        "fps must be a number from 0.1 to 10000 .* got 1000000000",
    ),
    "NaN in intrinsics": (
        merge("metadata.json", intrinsics=[[[math.nan]]]),
        "error",
        "metadata.json",
        r"intrinsics\[0\]\[0\]\[0\] must be a finite number",
    ),
    "intrinsics of 5": (merge("metadata.json", intrinsics=5), "error", "metadata.json", "intrinsics must have shape .* got 5"),
    "half a character": (
        write("scenario.json", b'{"object": "\\ud800"}'),
        "error",
        "scenario.json",
        "object must be text, got half a character",
    ),
    "tracks in mm": (
        write("gt_track_3d.pkl", np.full((5, 9, 3), 50.0)),
        "error",
        "gt_track_3d.pkl",
        "tracks must lie on the body, in its units",
    ),
    "surface elsewhere": (
        edit("surface_points", lambda a: np.zeros((4, 3)) + [0, 0, 5]),
        "error",
        "final_data.pkl",
        "surface_points must lie on the body, in its units and axes, at most 0.1 m from its points, got 5.09 m",
    ),
    "interior in mm": (
        edit("interior_points", lambda a: np.array([[10.0, 10, -95], [20, 10, -95]])),
        "error",
        "final_data.pkl",
        "interior_points must lie on the body",
    ),
    "a long surface": (
        edit("surface_points", lambda a: np.array([[0.01, 0, -0.1], [20, 0, -0.1]])),
        "error",
        "final_data.pkl",
        "surface_points must be in metres, got a body that is 20 m long",
    ),
    "leaps": (
        edit(POINTS, lambda a: a + np.where((np.arange(5) >= 3)[:, None, None] & (a != 0).any(-1, keepdims=True), [0.1, 0, 0], 0)),
        "warning",
        "final_data.pkl",
        "object_points all leap at once by more than the body's length, 0.02 m, 1 time, first by 0.1 m after frame 2",
    ),
    "no object": (extra(object=""), "warning", "scenario.json", "object is empty: .* no transfer is scored"),
    "one track off": (
        write("gt_track_3d.pkl", put((0, 1), 5)(np.zeros((5, 9, 3)))),
        "warning",
        "gt_track_3d.pkl",
        "1 track more than 0.1 m",
    ),
    "NaN flags": (
        edit(SEEN, lambda a: a * np.nan),
        "error",
        "final_data.pkl",
        "object_visibilities must be bool, got float64 with values other",
    ),
    "kilometres": (
        edit(POINTS, lambda a: a + 74e3),
        "error",
        "final_data.pkl",
        "object_points must lie within 1000 m of the origin, got 74000",
    ),
    "inverted": (
        write("calibrate.pkl", [np.linalg.inv(POSE)] * 2),
        "error",
        "calibrate.pkl",
        "matrix of camera 0 must lead from camera to world",
    ),
    "looks away": (write("calibrate.pkl", [AWAY, POSE]), "warning", "calibrate.pkl", "matrix of camera 0 does not see the body"),
    "inside": (
        write("calibrate.pkl", [INSIDE, POSE]),
        "warning",
        "calibrate.pkl",
        "matrix of camera 0 places the camera inside of the body",
    ),
    "a pipe": (pipe("final_data.pkl"), "error", "final_data.pkl", "must be a regular file, got a named pipe"),
    "a pipe of JSON": (pipe("split.json"), "error", "split.json", "must be a regular file, got a named pipe"),
    "a pipe of tracks": (pipe("gt_track_3d.pkl"), "error", "gt_track_3d.pkl", "must be a regular file, got a named pipe"),
    "a pipe of colour": (pipe("color/0/1.png"), "warning", "color/0", "frame 1: must be a regular file, got a named pipe"),
    "a pipe of depth": (pipe("depth/0/1.npy"), "warning", "depth/0", "frame 1: must be a regular file, got a named pipe"),
    "a folder": (folder_of("metadata.json"), "error", "metadata.json", "must be a regular file, got a folder"),
    "a link to itself": (link("calibrate.pkl", "calibrate.pkl"), "error", "calibrate.pkl", "cannot be read .*symbolic links"),
    "a link to nothing": (link("scenario.json", "nowhere"), "error", "scenario.json", "cannot be read .*No such file"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_found_in_its_file(tmp_path, name):
    change, severity, file, message = FAULTS[name]
    folder = clean(tmp_path / "case")
    change(folder)
    found = check(folder)
    hits = [f for f in found if f.file == folder / file and f.severity == severity]
    assert any(re.search(message, f.said) for f in hits), "\n".join(map(str, found))
    errors = [f"{f.file}: {f.said}" for f in found if f.severity == "error"]
    if severity == "warning":
        assert not errors and read_case(folder)
    else:  # the reader refuses it by the first of them, in the same words
        with pytest.raises(ValueError) as refused:
            read_case(folder)
        assert str(refused.value) == errors[0]


def test_all_faults_are_reported_at_once(tmp_path):
    folder = clean(tmp_path / "case")
    names = ["NaN inside", "far hands", "empty train", "scaled", "tracks short", "fps", "half a grip"]
    for name in names:
        FAULTS[name][0](folder)
    assert {f.file for f in check(folder) if f.severity == "error"} >= {folder / FAULTS[name][2] for name in names}


@pytest.mark.parametrize(
    "content", [b"{", b'{"gravty": [0, 0, 9.8]}', b'{"ground": {"normal": [0, 0, 2], "offset": 0}}', b'{"gravity": "down"}']
)
def test_a_wrong_scenario_json_is_one_error_whichever_way_its_data_are(tmp_path, content):
    folder = clean(tmp_path / "case")
    upside_down(folder)  # which would be wrong under the published gravity and ground
    (folder / "scenario.json").write_bytes(content)
    (wrong,) = [finding for finding in check(folder) if finding.severity == "error"]
    assert wrong.file == folder / "scenario.json" and "upwards" not in wrong.said


def test_recordings_of_no_named_object_are_no_transfer_pairs(tmp_path):
    for name in "ab":
        extra(object="")(clean(tmp_path / name))
    assert open_collection(tmp_path).pairs == ()


def test_a_body_that_moves_as_a_whole_over_hidden_frames_does_not_leap(tmp_path):
    folder = clean(tmp_path / "case")
    edit(POINTS, lambda a: put(2, 0)(a + np.array([0, 0, 0, 1, 1])[:, None, None]))(folder)
    edit(SEEN, put(2, False))(folder)
    assert not [finding for finding in check(folder) if "leap" in finding.said]


def test_a_finding_reads_as_one_line(tmp_path):
    folder = clean(tmp_path / "case")
    (folder / "split.json").unlink()
    (finding,) = check(folder)
    assert finding == Finding(folder / "split.json", "error", "missing")
    assert str(finding) == f"error   {folder / 'split.json'}: missing"


def test_folders_of_cases_are_checked_one_by_one(tmp_path):
    for name in ("a", "b", "c"):
        clean(tmp_path / "data" / "different_types" / name)
    root = tmp_path / "data" / "different_types"
    (root / "b" / "final_data.pkl").unlink()  # by this file a case is known, and still it is not passed over
    (root / "c" / "split.json").unlink()
    (root / "notes").mkdir()
    assert {(f.file.parent.name, f.file.name) for f in check(tmp_path)} == {("b", "final_data.pkl"), ("c", "split.json")}


def test_what_is_no_case_is_said_to_be_none(tmp_path):
    (tmp_path / "file").write_text("x")
    for path, message in (
        (tmp_path, "none of the layouts"),
        (tmp_path / "file", "none of the layouts"),
        (tmp_path / "nowhere", "no such file or folder"),
    ):
        (finding,) = check(path)
        assert finding.severity == "error" and message in finding.message and finding.file == path


FILES = ["final_data.pkl", "calibrate.pkl", "gt_track_3d.pkl", "split.json", "metadata.json", "mask/mask_info_0.json", "depth/0/1.npy"]
JUNK = st.one_of(
    st.binary(max_size=40),
    st.recursive(
        st.none() | st.integers() | st.floats() | st.text(max_size=4) | st.just(np.zeros((5, 18, 3))) | st.just(np.array(["x"])),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from([POINTS, SEEN, VALID, HANDS, "train", "test", "frame_len", "fps", "WH", "intrinsics"]), inner)
        ),
        max_leaves=6,
    ),
)


@pytest.fixture(scope="module")
def shared_case(tmp_path_factory):
    return clean(tmp_path_factory.mktemp("cases") / "case")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
@given(file=st.sampled_from(FILES), junk=JUNK)
def test_no_data_makes_it_raise_and_without_an_error_the_case_reads(shared_case, file, junk):
    before = (shared_case / file).read_bytes()
    if isinstance(junk, bytes):
        content = junk
    elif file.endswith(".json"):
        content = json.dumps(junk, default=lambda a: a.tolist()).encode()
    else:
        content = pickle.dumps(junk)
    try:
        (shared_case / file).write_bytes(content)
        found = check_case(shared_case)
        assert all("\n" not in str(f) for f in found)
        if not any(f.severity == "error" for f in found):
            read_case(shared_case)
    finally:
        (shared_case / file).write_bytes(before)
