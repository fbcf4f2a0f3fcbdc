"""The checker: a clean case has no findings, each fault is found in its file, and nothing makes it raise."""

import json
import os
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from twinbench.datasets.check import Finding, check, check_case
from twinbench.datasets.phystwin import read_case, write_case
from twinbench.datasets.scenario import Camera, Plane, Scenario, Split

FRAMES, HEIGHT, WIDTH = 5, 6, 8


def clean(folder):
    """A case with every file and nothing wrong: a 3 x 3 x 2 block of points 1 cm apart, held 2 cm above by two hand points."""
    body = np.stack(np.meshgrid(*[np.arange(n) * 0.01 for n in (3, 3, 2)], indexing="ij"), -1).reshape(-1, 3) - [0, 0, 0.1]
    visible = np.ones((FRAMES, len(body)), bool)
    visible[2, 3] = False
    motion_valid = np.zeros_like(visible)
    motion_valid[:-1] = visible[:-1] & visible[1:]
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    pose = np.block([[turn, np.array([[0.1], [0.2], [-0.8]])], [np.zeros((1, 3)), np.ones((1, 1))]])
    camera = Camera(np.array([[50.0, 0, WIDTH / 2], [0, 50, HEIGHT / 2], [0, 0, 1]]), pose, WIDTH, HEIGHT)
    points = np.where(visible[..., None], body, 0.0)
    tracks = np.repeat(body[None, :9], FRAMES, 0)
    tracks[2, 4] = np.nan
    scenario = Scenario(
        name="case",
        points=points,
        visible=visible,
        motion_valid=motion_valid,
        controllers=np.repeat(body[None, :2] - [0, 0, 0.02], FRAMES, 0),
        colors=np.where(visible[..., None], 0.5, 0.0) * np.ones(3),
        split=Split(3, FRAMES),
        cameras=(camera, camera),
        tracks=tracks,
        ground=Plane(np.array([0.0, 0, -1])),
        object="case",
        session="case",
    )
    shape = (2, FRAMES, HEIGHT, WIDTH)
    color = np.zeros((*shape, 3), np.uint8)
    return write_case(folder, scenario, color=color, depth=np.ones(shape), masks=np.ones(shape, bool), hand_masks=np.zeros(shape, bool))


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
    "malicious masks": (write("mask/processed_masks.pkl", Malicious()), "error", "mask/processed_masks.pkl", "refused"),
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
    "text": (edit(POINTS, lambda a: a.astype(str)), "error", "final_data.pkl", "must be an array of numbers, got <U"),
    "objects": (edit(POINTS, lambda a: a.astype(object)), "error", "final_data.pkl", "must be an array of numbers, got object"),
    "float32": (edit(POINTS, lambda a: a.astype("f4")), "warning", "final_data.pkl", "float32; the published type is float64"),
    "flags as numbers": (edit(SEEN, lambda a: a.astype("u1")), "warning", "final_data.pkl", "published type is bool"),
    "confidences": (edit(SEEN, lambda a: a * 0.7), "error", "final_data.pkl", "values other than 0 and 1"),
    "NaN seen": (edit(POINTS, put((3, 1), np.nan)), "error", "final_data.pkl", "NaN or infinity in 1 visible row, first in frame 3"),
    "NaN start": (edit(POINTS, put((0, 1), np.inf)), "error", "final_data.pkl", "in 1 row of frame 0"),
    "NaN hidden": (edit(POINTS, put((2, 3), np.nan)), "warning", "final_data.pkl", "not zero in 1 invisible row"),
    "hidden not 0": (edit(POINTS, put((2, 3), 0.1)), "warning", "final_data.pkl", "not zero in 1 invisible row"),
    "NaN hands": (edit(HANDS, put((4, 1), np.nan)), "error", "final_data.pkl", "controller_points holds NaN or infinity in 1 row"),
    "NaN inside": (edit("interior_points", lambda a: np.full((2, 3), np.nan)), "error", "final_data.pkl", "interior_points holds NaN"),
    "colors in 255": (edit("object_colors", lambda a: a * 255), "warning", "final_data.pkl", r"leaves \[0, 1\]"),
    "hidden start": (edit(SEEN, put((0, 2), False)), "warning", "final_data.pkl", "1 point not visible in frame 0"),
    "blind frame": (edit(SEEN, put(3, False)), "warning", "final_data.pkl", "no point is visible in 1 frame, first in frame 3"),
    "last motion": (edit(VALID, put(LAST, True)), "warning", "final_data.pkl", "last row must be False"),
    "ghost motion": (edit(VALID, put((2, 3), True)), "warning", "final_data.pkl", "1 motion from or to an invisible point"),
    "millimetres": (millimetres, "warning", "final_data.pkl", "are the units metres"),
    "twins": (edit(POINTS, lambda a: put(np.s_[:, 0], a[:, 1])(a)), "warning", "final_data.pkl", "1 particle of frame 0 lie"),
    "under the table": (edit(POINTS, put((1, 0, 2), 0.01)), "warning", "final_data.pkl", "1 mm below the table"),
    "far hands": (edit(HANDS, lambda a: a - [0, 0, 0.1]), "error", "final_data.pkl", "controllers out of range of the body: .* 0.11 m"),
    "one far hand": (edit(HANDS, put((0, 1, 2), -1)), "warning", "final_data.pkl", "1 controller more than 0.08 m away"),
    "no hands": (edit(HANDS, lambda a: a[:, :0]), "warning", "final_data.pkl", "nothing drives the body"),
    "empty train": (merge("split.json", train=[0, 0], test=[0, 5]), "error", "split.json", "at least 2 frames"),
    "other length": (merge("split.json", frame_len=6), "error", "split.json", "frame_len is 6, but the recording has 5 frames"),
    "no test": (merge("split.json", train=[0, 5], test=[5, 5]), "warning", "split.json", "test range is empty"),
    "split is text": (write("split.json", b"70%"), "error", "split.json", "not a JSON file"),
    "fps": (merge("metadata.json", fps="30"), "error", "metadata.json", "fps must be > 0"),
    "frame_num": (merge("metadata.json", frame_num=9), "warning", "metadata.json", "frame_num is 9"),
    "no intrinsics": (merge("metadata.json", intrinsics=[]), "warning", "metadata.json", "no intrinsics"),
    "flat intrinsics": (merge("metadata.json", intrinsics=[[1, 2, 3]]), "error", "metadata.json", r"must have shape \(cameras, 3, 3\)"),
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
    "one pose": (write("calibrate.pkl", [np.eye(4)]), "error", "calibrate.pkl", "1 camera matrices, but metadata.json has intrinsics of 2"),
    "scaled": (write("calibrate.pkl", [np.eye(4), SCALED]), "error", "calibrate.pkl", "camera 1 is not a rotation and a translation"),
    "mirrored": (write("calibrate.pkl", [MIRRORED, np.eye(4)]), "error", "calibrate.pkl", "camera 0 is not a rotation"),
    "3 x 4": (write("calibrate.pkl", [np.eye(4)[:3]] * 2), "error", "calibrate.pkl", "must be 4 x 4 and finite"),
    "poses dict": (write("calibrate.pkl", {"a": 1}), "error", "calibrate.pkl", "must hold a list"),
    "tracks short": (write("gt_track_3d.pkl", np.zeros((4, 9, 3))), "error", "gt_track_3d.pkl", "must have shape"),
    "tracks inf": (write("gt_track_3d.pkl", np.full((5, 9, 3), np.inf)), "error", "gt_track_3d.pkl", "infinity"),
    "tracks late": (write("gt_track_3d.pkl", put(0, np.nan)(np.zeros((5, 9, 3)))), "warning", "gt_track_3d.pkl", "in frame 0"),
    "scenario": (write("scenario.json", b'{"fbs": 3}'), "error", "scenario.json", "unknown key 'fbs'"),
    "color gone": (remove("color/1/2.png", "color/1/4.png"), "error", "color/1", "2 of 5 frames are missing: 2, 4"),
    "depth gone": (remove("depth/0/0.npy", "depth/0/1.npy"), "error", "depth/0", "2 of 5 frames are missing: 0-1"),
    "mask gone": (remove("mask/0/1/3.png"), "error", "mask/0/1", "1 of 5 frames are missing: 3"),
    "depth size": (save("depth/1/3.npy", np.zeros((5, 8), "u2")), "error", "depth/1", "must be 8 x 6 pixels, got 8 x 5 in frames 3"),
    "depth metres": (save("depth/1/3.npy", np.zeros((6, 8))), "error", "depth/1", "integer millimetres"),
    "depth cut": (cut("depth/1/3.npy", 140), "error", "depth/1", "unreadable frames 3; frame 3"),
    "depth pickled": (save("depth/1/3.npy", np.array([None])), "error", "depth/1", "unreadable frames 3"),
    "color cut": (cut("color/0/1.png", 50), "error", "color/0", "unreadable frames 1; frame 1: cut short"),
    "color is text": (write("color/0/1.png", b"no image"), "error", "color/0", "not a PNG image"),
    "one too many": (write("color/0/9.png", b"x"), "warning", "color/0", "frames after the last one, 4: 9"),
    "no labels": (remove("mask/mask_info_1.json"), "error", "mask/mask_info_1.json", "missing"),
    "two objects": (write("mask/mask_info_1.json", b'{"0": "a", "1": "b"}'), "error", "mask/mask_info_1.json", "exactly one label"),
    "no hand label": (write("mask/mask_info_1.json", b'{"1": "b"}'), "warning", "mask/mask_info_1.json", "cannot leave out the hands"),
    "few masks": (write("mask/processed_masks.pkl", {}), "error", "mask/processed_masks.pkl", "holds 0 frames, but final_data.pkl has 5"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_found_in_its_file(tmp_path, name):
    change, severity, file, message = FAULTS[name]
    folder = clean(tmp_path / "case")
    change(folder)
    found = check(folder)
    hits = [f for f in found if f.file == folder / file and f.severity == severity]
    assert any(re.search(message, f.message) for f in hits), "\n".join(map(str, found))
    if severity == "warning":
        assert not [f for f in found if f.severity == "error"] and read_case(folder)
    elif not file.startswith(("color", "depth", "mask")) and name not in TOLERATED:
        with pytest.raises(ValueError):
            read_case(folder)


# readers have no need to refuse these, but a score or a fit made with them would be wrong
TOLERATED = {"far hands", "confidences", "transposed", "scaled", "mirrored", "one too many", "tracks inf"}


def test_all_faults_are_reported_at_once(tmp_path):
    folder = clean(tmp_path / "case")
    names = ["NaN seen", "far hands", "empty train", "scaled", "tracks short", "color gone", "depth size", "two objects", "fps"]
    for name in names:
        FAULTS[name][0](folder)
    assert {f.file for f in check(folder) if f.severity == "error"} >= {folder / FAULTS[name][2] for name in names}


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
    for path, message in ((tmp_path, "no case"), (tmp_path / "file", "no case"), (tmp_path / "nowhere", "no such file or folder")):
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
