"""The published case layout: what is written is read back exactly, and what is damaged is refused by name."""

import builtins
import errno
import json
import pickle
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from reaching import reachable
from twinbench.datasets.catalogue import CASES, CITED, PAIRS, PUBLISHED, self_collides
from twinbench.datasets.collection import layouts, open_collection
from twinbench.datasets.findings import collected
from twinbench.datasets.phystwin import read_case, write_case
from twinbench.datasets.phystwin_reading import reading
from twinbench.datasets.scenario import Camera, Images, Plane, Scenario, Split, TransferPair

NUMBERS = st.floats(-1e3, 1e3)
HEIGHT, WIDTH = 6, 8


def arrays(*shape, elements=NUMBERS):
    return npst.arrays(np.float64, shape, elements=elements)


def flags(*shape):
    return npst.arrays(bool, shape)


@st.composite
def cameras(draw):
    angle, centre = draw(st.floats(-3, 3)), draw(arrays(3))
    pose = np.eye(4)
    pose[:2, :2], pose[:3, 3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]], centre
    focal = draw(st.floats(1, 1000))
    return Camera(np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]]), pose, WIDTH, HEIGHT)


def each_once(grips):
    """A point is driven by the first controller that names it."""
    first = np.unique(grips, return_index=True)[1]
    return np.where(np.isin(np.arange(len(grips)), first), grips, -1)


@st.composite
def scenarios(draw):
    """Any scenario without images. Rows of invisible points are zero, which is all that the layout can hold of them."""
    length, count, hands = draw(st.integers(2, 5)), draw(st.integers(1, 4)), draw(st.integers(0, 3))
    visible = draw(flags(length, count))
    points = draw(arrays(length, count, 3))
    points[1:][~visible[1:]] = 0
    unit = st.sampled_from([np.array([0.0, 0, -1]), np.array([0.0, 1, 0]), np.array([0.6, 0.8, 0])])
    tracks = arrays(length, draw(st.integers(0, 3)), 3, elements=st.one_of(NUMBERS, st.just(np.nan)))
    return Scenario(
        name="case",
        points=points,
        visible=visible,
        motion_valid=draw(flags(length, count)),
        controllers=draw(arrays(length, hands, 3)),
        surface=draw(arrays(draw(st.integers(0, 3)), 3)),
        interior=draw(arrays(draw(st.integers(0, 3)), 3)),
        colors=draw(st.none() | arrays(length, count, 3, elements=st.floats(0, 1)).map(lambda c: np.where(visible[..., None], c, 0))),
        fps=draw(st.sampled_from([30.0, 100.0, 29.97, 0.1])),
        gravity=draw(arrays(3, elements=st.floats(-50, 50))),  # m/s^2
        ground=draw(st.none() | st.builds(Plane, unit, NUMBERS)),
        grips=draw(st.none() | npst.arrays(np.int64, hands, elements=st.integers(-1, count - 1)).map(each_once)),
        self_collision=draw(st.booleans()),
        object=draw(st.text(max_size=5)),
        session=draw(st.text(max_size=5)),
        cameras=tuple(draw(st.lists(cameras(), max_size=3))),
        split=Split(draw(st.integers(2, length)), length),
        tracks=draw(st.none() | tracks),
    )


def assert_same(a, b, ignore=("images",)):
    """Every field equal to the last bit, with the type it has."""
    for field in fields(a):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if field.name in ignore:
            continue
        if isinstance(x, np.ndarray):
            assert x.dtype == y.dtype and x.shape == y.shape and np.array_equal(x, y, equal_nan=x.dtype.kind == "f"), field.name
        elif field.name == "cameras":
            assert len(x) == len(y)
            for p, q in zip(x, y, strict=True):
                assert_same(p, q)
        elif isinstance(x, Plane):
            assert_same(x, y)
        else:
            assert type(x) is type(y) and x == y, field.name


def small(name="case", frames=4, **changes):
    """A plain scenario: 12 points of which some are hidden now and then."""
    rng = np.random.default_rng(3)
    visible = rng.random((frames, 12)) > 0.2
    visible[0] = True
    points = np.where(visible[..., None], rng.normal(size=(frames, 12, 3)), 0)
    values = {
        "points": points,
        "visible": visible,
        "motion_valid": np.zeros_like(visible),
        "controllers": rng.normal(size=(frames, 2, 3)),
        "split": Split(frames - 1, frames),
    }
    return Scenario(name=name, **(values | changes))


def images(frames=4, cameras=2, seed=0):
    rng = np.random.default_rng(seed)
    shape = (cameras, frames, HEIGHT, WIDTH)
    return {
        "color": rng.integers(0, 256, (*shape, 3), dtype=np.uint8),
        "depth": rng.integers(0, 2000, shape).astype(np.float32) / np.float32(1000),
        "masks": rng.random(shape) > 0.5,
        "hand_masks": rng.random(shape) > 0.8,
    }


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
@given(scenario=scenarios())
def test_what_is_written_is_read_back_exactly(tmp_path, scenario):
    _, values = collected(
        reading(write_case(tmp_path / "case", scenario, overwrite=True))
    )  # implausible as they are: read_case refuses them
    assert_same(Scenario(**values), scenario)


def test_the_files_are_as_published(tmp_path):
    camera = Camera(np.array([[50.0, 0, 4], [0, 50, 3], [0, 0, 1]]), np.eye(4), WIDTH, HEIGHT)
    scenario = small(
        cameras=(camera, camera), tracks=np.zeros((4, 9, 3)), ground=Plane(np.array([0.0, 0, -1])), session="case", object="case"
    )
    scenario = replace(scenario, colors=np.full((4, 12, 3), 0.5))
    folder = write_case(tmp_path / "case", scenario, **images())
    data = pickle.loads((folder / "final_data.pkl").read_bytes())
    assert {key: (value.dtype.name, value.shape) for key, value in data.items()} == {
        "object_points": ("float64", (4, 12, 3)),
        "object_colors": ("float64", (4, 12, 3)),
        "object_visibilities": ("bool", (4, 12)),
        "object_motions_valid": ("bool", (4, 12)),
        "controller_points": ("float64", (4, 2, 3)),
        "surface_points": ("float64", (0, 3)),
        "interior_points": ("float64", (0, 3)),
    }
    hidden = ~data["object_visibilities"]
    assert hidden.any() and not data["object_points"][hidden].any() and not data["object_colors"][hidden].any()
    assert json.loads((folder / "split.json").read_text()) == {"frame_len": 4, "train": [0, 3], "test": [3, 4]}
    poses = pickle.loads((folder / "calibrate.pkl").read_bytes())
    assert isinstance(poses, list) and [p.shape for p in poses] == [(4, 4)] * 2
    metadata = json.loads((folder / "metadata.json").read_text())
    assert metadata["fps"] == 30 and metadata["WH"] == [WIDTH, HEIGHT] and np.shape(metadata["intrinsics"]) == (2, 3, 3)
    assert metadata["frame_num"] == 4 and len(metadata["serial_numbers"]) == 2
    assert pickle.loads((folder / "gt_track_3d.pkl").read_bytes()).shape == (4, 9, 3)
    assert np.load(folder / "depth" / "1" / "3.npy").dtype.kind in "iu"
    assert json.loads((folder / "mask" / "mask_info_0.json").read_text()) == {"0": "hand", "1": "object"}
    assert not (folder / "scenario.json").exists(), "all is as published, so there is nothing to add"


def test_where_there_is_no_scenario_json_the_published_world_holds(tmp_path):
    folder = write_case(tmp_path / "single_lift_cloth_1", small())
    (folder / "scenario.json").unlink()
    (folder / "metadata.json").unlink()
    read = read_case(folder)
    assert read.gravity.tolist() == [0, 0, 9.8] and read.ground.normal.tolist() == [0, 0, -1] and read.ground.offset == 0
    assert read.ground.height([0, 0, -0.3]) == pytest.approx(0.3), "up is -z"
    assert (read.fps, read.object, read.self_collision, read.cameras, read.images) == (30.0, "cloth_1", True, (), None)
    assert (read.grips == -1).all()


@pytest.mark.parametrize("name", ["a_cloth", "packages", "rope"])
def test_self_collision_goes_by_the_name(tmp_path, name):
    folder = write_case(tmp_path / name, small())
    (folder / "scenario.json").unlink()
    assert read_case(folder).self_collision is ("cloth" in name or "package" in name)


def test_points_that_are_hidden_in_frame_0_keep_their_place(tmp_path):
    scenario = small()
    visible = scenario.visible.copy()
    visible[0, :3] = False
    read = read_case(write_case(tmp_path / "case", replace(scenario, visible=visible)))
    assert np.array_equal(read.points[0], scenario.points[0])


# --- images ---------------------------------------------------------------------------------------------------------------


def test_images_are_read_back(tmp_path):
    given_images = images()
    read = read_case(write_case(tmp_path / "case", small(), **given_images)).images
    assert isinstance(read, Images) and read.frame_count == 4
    for camera in range(2):
        for t in range(4):
            assert np.array_equal(read.color(camera, t), given_images["color"][camera, t]) and read.color(camera, t).dtype == np.uint8
            assert np.array_equal(read.mask(camera, t), given_images["masks"][camera, t]) and read.mask(camera, t).dtype == bool
            assert np.array_equal(read.human_mask(camera, t), given_images["hand_masks"][camera, t])
            depth = read.depth(camera, t)  # whole millimetres were given, so nothing is rounded
            assert depth.dtype == np.float32 and np.array_equal(depth, given_images["depth"][camera, t])


def test_depth_is_rounded_to_the_millimetre_and_invalid_is_zero(tmp_path):
    depth = np.array([[[[0.0, 0.1234, np.nan, np.inf]]] * 4])
    read = read_case(write_case(tmp_path / "case", small(), depth=depth)).images.depth(0, 0)
    assert read.tolist() == [[0, np.float32(0.123), 0, 0]]


def test_only_the_frames_within_reach_are_given(tmp_path):
    seen = read_case(write_case(tmp_path / "case", small(), **images())).observed().images
    assert seen.frame_count == 3 and seen.color(0, 2).shape == (HEIGHT, WIDTH, 3)
    for reached in (seen, seen.until(4), pickle.loads(pickle.dumps(seen)), seen.until(1)):
        for read in (reached.color, reached.depth, reached.mask, reached.human_mask):
            with pytest.raises(IndexError, match="not within reach"):
                read(0, 3)
            with pytest.raises(IndexError, match="not within reach"):
                read(0, -1)
    assert seen.until(1).frame_count == 1 and seen.until(4).frame_count == 3


def test_cleaned_masks_serve_where_only_they_are_there_and_give_no_more_frames(tmp_path):
    folder = write_case(tmp_path / "case", small(), depth=images()["depth"])
    masks = np.random.default_rng(0).random((4, 2, HEIGHT, WIDTH)) > 0.5
    (folder / "mask").mkdir()
    processed = {t: {c: {"object": masks[t, c], "controller": ~masks[t, c]} for c in range(2)} for t in range(4)}
    (folder / "mask" / "processed_masks.pkl").write_bytes(pickle.dumps(processed))
    whole = read_case(folder).images
    assert np.array_equal(whole.mask(1, 3), masks[3, 1])
    with pytest.raises(ValueError, match=r"processed_masks.pkl: must hold a mask 'object' of frame 0, camera 7"):
        whole.mask(7, 0)
    seen = whole.until(3)
    assert np.array_equal(seen.mask(1, 2), masks[2, 1])
    held = [o for o in reachable(seen) if isinstance(o, np.ndarray) and o.shape == (HEIGHT, WIDTH)]
    assert held and not any(np.array_equal(m, masks[3, c]) for m in held for c in range(2)), "a hidden frame is kept in memory"


def test_human_masks_beside_the_cases_come_first(tmp_path):
    write_case(tmp_path / "different_types" / "case", small(), **images(seed=1))
    write_case(tmp_path / "different_types_human_mask" / "case", small(), masks=(people := images(seed=2)["masks"]))
    read = read_case(tmp_path / "different_types" / "case").images
    assert np.array_equal(read.human_mask(1, 2), people[1, 2])
    assert not np.array_equal(read.mask(1, 2), people[1, 2])


def test_several_hands_are_joined(tmp_path):
    given_images = images()
    folder = write_case(tmp_path / "case", small(), **given_images)
    (folder / "mask" / "mask_info_0.json").write_text(json.dumps({"0": "hand", "1": "twine", "2": "hand"}))
    (folder / "mask" / "0" / "1").rename(folder / "mask" / "0" / "x")
    (folder / "mask" / "1" / "0").rename(folder / "mask" / "0" / "2")
    (folder / "mask" / "0" / "x").rename(folder / "mask" / "0" / "1")
    both = given_images["hand_masks"][0, 1] | given_images["hand_masks"][1, 1]
    assert np.array_equal(read_case(folder).images.human_mask(0, 1), both)


def test_missing_images_are_named_when_asked_for(tmp_path):
    folder = write_case(tmp_path / "case", small(), color=images()["color"], masks=images()["masks"])
    read = read_case(folder).images
    with pytest.raises(ValueError, match=r"depth/0/0.npy: missing"):
        read.depth(0, 0)
    with pytest.raises(ValueError, match=r"color/5/0.png: missing"):
        read.color(5, 0)
    with pytest.raises(ValueError, match="no human mask of camera 0"):
        read.human_mask(0, 0)
    with pytest.raises(ValueError, match=r"mask_info_5.json"):
        read.mask(5, 0)
    (folder / "color" / "0" / "0.png").write_bytes(b"\x89PNG cut")
    with pytest.raises(ValueError, match=r"color/0/0.png: not a PNG image"):
        read.color(0, 0)
    (folder / "mask" / "mask_info_0.json").write_text(json.dumps({"0": "twine", "1": "box"}))
    with pytest.raises(ValueError, match=r"mask_info_0.json: exactly one label must be the object"):
        read.mask(0, 0)


def test_a_case_is_read_without_opencv(tmp_path):
    folder = write_case(tmp_path / "case", small(), **images())
    code = f"import sys; sys.modules['cv2'] = None; from twinbench.datasets.phystwin import read_case; s = read_case({str(folder)!r}); "
    code += "\ntry: s.images.color(0, 0)\nexcept ImportError as e: print(e)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install opencv-python-headless" in done.stdout


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"color": np.zeros((1, 3, 6, 8, 3), np.uint8)}, "color of camera 0 must have 4 frames, got 3"),
        ({"color": np.zeros((1, 4, 6, 8, 3))}, "must be .* uint8"),
        (
            {"color": [[np.zeros((6, 8, 3), np.uint8)] * 3 + [np.zeros((5, 8, 3), np.uint8)]]},
            r"frame 3 must be \(8, 6\) \(width, height\), got \(8, 5\)",
        ),
        ({"depth": np.full((1, 4, 6, 8), 500)}, "float metres"),
        ({"depth": np.full((1, 4, 6, 8), 70.0)}, r"must lie in \[0, 65.535\] m"),
        ({"depth": np.full((1, 4, 6, 8), -1.0)}, r"must lie in \[0, 65.535\] m"),
        ({"masks": np.zeros((1, 4, 6, 8))}, "object mask of camera 0, frame 0 must be .* bool"),
    ],
)
def test_wrong_images_are_refused_and_nothing_is_left(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        write_case(tmp_path / "case", small(), **changes)
    assert not list(tmp_path.iterdir())


# --- writing all or nothing -----------------------------------------------------------------------------------------------


def test_nothing_is_overwritten_unasked(tmp_path):
    folder = write_case(tmp_path / "case", small(), **images())
    with pytest.raises(ValueError, match="already exists"):
        write_case(folder, small(frames=5))
    assert read_case(folder).frame_count == 4
    write_case(folder, small(frames=5), overwrite=True)
    assert read_case(folder).frame_count == 5 and read_case(folder).images is None, "files of the old case are gone"
    assert [f.name for f in tmp_path.iterdir()] == ["case"]


def test_a_folder_that_is_no_case_is_never_overwritten(tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match="not a case"):
        write_case(tmp_path / "home", small(), overwrite=True)
    (tmp_path / "file").write_text("x")
    with pytest.raises(ValueError, match="a file of that name"):
        write_case(tmp_path / "file", small(), overwrite=True)
    assert (tmp_path / "home" / "thesis.tex").read_text() == "years of work"


@pytest.mark.parametrize("written", [0, 1, 2, 3])
def test_a_full_disk_leaves_the_old_case_and_nothing_half_written(tmp_path, monkeypatch, written):
    folder = write_case(tmp_path / "case", small(), **images())
    before = {f: f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}
    opened, real = [], Path.open

    def full(self, mode="r", *arguments, **options):
        if "w" in mode:
            opened.append(self)
            if len(opened) > written:
                raise OSError(errno.ENOSPC, "No space left on device", str(self))
        return real(self, mode, *arguments, **options)

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(OSError, match=r"writing the case .*case failed, nothing of it was kept: No space left") as caught:
        write_case(folder, small(frames=5, tracks=np.zeros((5, 9, 3))), overwrite=True)
    monkeypatch.undo()
    assert caught.value.errno == errno.ENOSPC
    assert {f: f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()} == before
    assert [f.name for f in tmp_path.iterdir()] == ["case"]


def test_a_failed_exchange_puts_the_old_case_back(tmp_path, monkeypatch):
    folder = write_case(tmp_path / "case", small())
    real = Path.rename

    def fails(self, target):
        if self.suffix == ".partial":
            raise OSError(errno.EIO, "Input/output error")
        return real(self, target)

    monkeypatch.setattr(Path, "rename", fails)
    with pytest.raises(OSError, match="nothing of it was kept"):
        write_case(folder, small(frames=5), overwrite=True)
    monkeypatch.undo()
    assert read_case(folder).frame_count == 4 and [f.name for f in tmp_path.iterdir()] == ["case"]


def test_a_kill_in_the_middle_leaves_no_case(tmp_path):
    """The process ends without cleaning up while it writes images: no folder of the case's name appears, and none is listed."""
    code = (
        "import os; import numpy as np; from twinbench.datasets.phystwin import write_case, read_case\n"
        f"s = read_case({str(write_case(tmp_path / 'from' / 'case', small()))!r})\n"
        "def frames():\n"
        "    yield np.zeros((6, 8, 3), np.uint8)\n"
        "    os.kill(os.getpid(), 9)\n"
        f"write_case({str(tmp_path / 'to' / 'case')!r}, s, color=[frames()])\n"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == -9
    assert [f.name.startswith(".case.") for f in (tmp_path / "to").iterdir()] == [True], "only the hidden folder that it wrote into"
    with pytest.raises(ValueError, match="none of the layouts"):
        open_collection(tmp_path / "to")
    write_case(tmp_path / "to" / "case", small())
    assert open_collection(tmp_path / "to").in_domain == ("case",)


# --- bad files ------------------------------------------------------------------------------------------------------------


def _edit(folder, **changes):
    data = pickle.loads((folder / "final_data.pkl").read_bytes())
    (folder / "final_data.pkl").write_bytes(pickle.dumps({k: v for k, v in (data | changes).items() if v is not None}))


def _json(name, **changes):
    def change(folder):
        content = json.loads((folder / name).read_text())
        (folder / name).write_text(json.dumps(content | changes))

    return change


class Malicious:
    def __reduce__(self):
        return builtins.exec, ("raise SystemExit('the pickle ran')",)


nan_row = small().points.copy()
nan_row[0, 0] = np.nan
BAD = {
    "no points": (lambda f: _edit(f, object_points=None), "final_data.pkl: object_points is missing"),
    "flat points": (
        lambda f: _edit(f, object_points=np.zeros((4, 12))),
        r"final_data.pkl: object_points must have shape \(frames, points, 3\), got \(4, 12\)",
    ),
    "NaN points": (lambda f: _edit(f, object_points=nan_row), r"final_data.pkl: object_points must be finite"),
    "text points": (lambda f: _edit(f, object_points="x"), "final_data.pkl: object_points must be an array of numbers, got a str"),
    "NaN controllers": (
        lambda f: _edit(f, controller_points=np.full((4, 2, 3), np.nan)),
        "final_data.pkl: controller_points must be finite",
    ),
    "short controllers": (
        lambda f: _edit(f, controller_points=np.zeros((3, 2, 3))),
        r"final_data.pkl: controller_points must have shape \(4, controllers, 3\), got \(3, 2, 3\)",
    ),
    "wrong flags": (
        lambda f: _edit(f, object_visibilities=np.ones((4, 11), bool)),
        r"final_data.pkl: object_visibilities must have shape \(4, 12\)",
    ),
    "a list": (lambda f: (f / "final_data.pkl").write_bytes(pickle.dumps([1])), "final_data.pkl: must hold a dict"),
    "truncated": (lambda f: (f / "final_data.pkl").write_bytes((f / "final_data.pkl").read_bytes()[:-9]), "final_data.pkl: not a complete"),
    "malicious": (lambda f: (f / "final_data.pkl").write_bytes(pickle.dumps(Malicious())), "final_data.pkl: refused, .*builtins.exec"),
    "malicious poses": (lambda f: (f / "calibrate.pkl").write_bytes(pickle.dumps(Malicious())), "calibrate.pkl: refused"),
    "malicious tracks": (lambda f: (f / "gt_track_3d.pkl").write_bytes(pickle.dumps(Malicious())), "gt_track_3d.pkl: refused"),
    "no final_data": (lambda f: (f / "final_data.pkl").unlink(), "final_data.pkl: missing"),
    "no split": (lambda f: (f / "split.json").unlink(), "split.json: missing"),
    "cut split": (lambda f: (f / "split.json").write_text('{"frame_len"'), "split.json: not a JSON file"),
    "empty train": (_json("split.json", train=[0, 0], test=[0, 4]), "split.json: split must have a train range of at least 2 frames"),
    "gap": (_json("split.json", test=[2, 4]), r"split.json: train must be \[0, end\)"),
    "wrong length": (_json("split.json", frame_len=5), "split.json: frame_len must be the recording's 4 frames, got 5"),
    "fractional": (_json("split.json", train=[0, 2.8], test=[2.8, 4]), "split.json: must hold the integers frame_len"),
    "one camera too many": (_json("metadata.json", intrinsics=[np.eye(3).tolist()] * 2), "calibrate.pkl: must hold one"),
    "no size": (_json("metadata.json", WH=8), "metadata.json: WH must be"),
    "bad fps": (_json("metadata.json", fps=0), r"metadata.json: fps must be a number from 0.1 .*, got 0"),
    "unknown key": (_json("scenario.json", gravitation=[0, 0, 1]), r"scenario.json: unknown key 'gravitation'; did you mean 'gravity'\?"),
    "bad ground": (_json("scenario.json", ground={"normal": [0, 0, 2], "offset": 0}), "scenario.json: ground normal must be a unit vector"),
    "bad grips": (_json("scenario.json", grips=[0, 12]), "grips must be -1 or the index of one of the 12 points"),
    "bad object": (_json("scenario.json", object=3), "scenario.json: object must be a str"),
    "bad colors": (_json("scenario.json", colors=[1]), "scenario.json: colors may only be null"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_give_one_error_that_names_them(tmp_path, name):
    camera = Camera(np.eye(3), np.eye(4), WIDTH, HEIGHT)
    folder = write_case(tmp_path / "case", small(cameras=(camera,), tracks=np.zeros((4, 9, 3))))
    read_case(folder)
    change, message = BAD[name]
    change(folder)
    with pytest.raises(ValueError, match=message) as caught:
        read_case(folder)
    assert str(tmp_path) in str(caught.value)


def test_images_fit_the_cameras(tmp_path):
    camera = Camera(np.eye(3), np.eye(4), WIDTH, HEIGHT)
    with pytest.raises(ValueError, match="color must be given for all 3 cameras, got 2"):
        write_case(tmp_path / "case", small(cameras=(camera,) * 3), color=images()["color"])
    with pytest.raises(ValueError, match=r"frame 0 must be \(4, 6\)"):
        write_case(tmp_path / "case", small(cameras=(replace(camera, width=4),) * 2), color=images()["color"])
    assert not list(tmp_path.iterdir())


def test_the_cameras_of_a_case_have_one_size(tmp_path):
    one, other = Camera(np.eye(3), np.eye(4), 8, 6), Camera(np.eye(3), np.eye(4), 16, 12)
    with pytest.raises(ValueError, match="one image size"):
        write_case(tmp_path / "case", small(cameras=(one, other)))


# --- folders of cases -----------------------------------------------------------------------------------------------------


def test_the_catalogue_is_the_published_one():
    assert len(CASES) == 22 and sum(c.shape_prior for c in CASES.values()) == 13
    assert len(PAIRS) == 22 and len(set(PAIRS)) == 22
    both_ways = {(p.target, p.sources[0]) for p in PAIRS}
    assert both_ways == {(p.sources[0], p.target) for p in PAIRS}
    assert all(CASES[p.sources[0]].object == CASES[p.target].object for p in PAIRS)
    kinds = [CASES[p.target].category for p in PAIRS]
    assert {k: kinds.count(k) // 2 for k in kinds} == {"twine": 3, "sloth": 1, "toy": 1, "cloth": 6}
    assert all(self_collides(c.name) is (c.config == "cloth") for c in CASES.values())
    assert PUBLISHED["prediction", "phystwin", "chamfer"] == 0.012 and PUBLISHED["transfer", "phystwin", "iou"] == 0.7218
    assert len(PUBLISHED) == 12 * 6 and all(0 < v < 1 for (_, _, m), v in PUBLISHED.items() if m != "psnr")


@pytest.mark.parametrize("below", ["", "different_types", "data/different_types"])
def test_the_published_folder_is_found_from_above(tmp_path, below):
    for name in CASES:
        write_case(tmp_path / below / name, small())
    (tmp_path / below / "rope_double_hand" / "scenario.json").unlink()
    found = open_collection(tmp_path)
    assert found.name == "phystwin" and set(found.in_domain) == set(CASES) and set(found.pairs) == set(PAIRS)
    assert found.published == PUBLISHED | CITED and "ICCV 2025" in found.citation and "arXiv:2511.08310" in found.citation
    assert found.load("rope_double_hand").object == "rope"
    assert set(open_collection(tmp_path, split="clean").pairs) == set(PAIRS), "every case is a take of its own"
    with pytest.raises(ValueError, match="did you mean 'single_lift_rope'"):
        found.load("single_lift_ropes")


def test_of_a_part_of_the_published_cases_only_what_is_there_is_offered(tmp_path):
    for name in ("double_lift_zebra", "double_stretch_zebra", "single_lift_rope"):
        write_case(tmp_path / name, small())
    found = open_collection(tmp_path)
    assert set(found.pairs) == {
        TransferPair(("double_lift_zebra",), "double_stretch_zebra"),
        TransferPair(("double_stretch_zebra",), "double_lift_zebra"),
    }
    assert found.published == {}, "means over 22 cases are no means over 3"
    assert "arXiv:2511.08310" not in found.citation, "nobody else's figures stand beside them"


def test_own_cases_pair_by_object(tmp_path):
    for name, thing, session in (("a", "toy", "monday"), ("b", "toy", "tuesday"), ("c", "toy", "monday"), ("d", "d", "")):
        write_case(tmp_path / "mine" / name, small(object=thing, session=session))
        (tmp_path / "mine" / name / "final_data.pkl").write_bytes(b"opening a collection reads no recording")
    found = open_collection(tmp_path / "mine")
    assert found.name == "mine" and found.in_domain == ("a", "b", "c", "d") and found.citation == ""
    assert {(*p.sources, p.target) for p in found.pairs} == {(x, y) for x in "abc" for y in "abc" if x != y}
    clean = open_collection(tmp_path / "mine", split="clean")
    assert {(*p.sources, p.target) for p in clean.pairs} == {("a", "b"), ("b", "a"), ("b", "c"), ("c", "b")}


def test_one_case_is_a_collection(tmp_path):
    write_case(tmp_path / "case", small())
    found = open_collection(tmp_path / "case")
    assert found.in_domain == ("case",) and found.pairs == () and found.load("case").frame_count == 4


def test_the_layout_never_raises_on_other_things(tmp_path):
    layout = layouts()["phystwin"]
    (tmp_path / "file").write_text("x")
    for path in (tmp_path, tmp_path / "file", tmp_path / "nowhere"):
        assert layout.matches(path) is False
    with pytest.raises(ValueError, match="no case there"):
        layout.open(tmp_path)
