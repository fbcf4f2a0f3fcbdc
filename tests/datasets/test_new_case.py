"""Recordings from arrays: written is what was given, in metres; wrong units, axes and arrays are refused in all readers' words."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example as tried
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.benchmark.cli import main
from twinbench.datasets.check import check
from twinbench.datasets.collection import open_collection
from twinbench.datasets.new_case import NAMES, UNITS, example, read_arrays, recording
from twinbench.datasets.phystwin import read_case, write_case
from twinbench.datasets.scenario import Plane

DOWN = (0.0, 0.0, -9.81)


def saved(folder, **arrays):
    folder.mkdir(exist_ok=True)
    np.savez(folder / "take.npz", **arrays)
    return folder / "take.npz"


@pytest.fixture
def arrays():
    """A block of 4 points that is lifted by two hand points; one point is lost in frame 3."""
    start = np.array([[0, 0, 0.1], [0.1, 0, 0.1], [0, 0.1, 0.1], [0, 0, 0.2]])
    hands = np.array([[0, 0, 0.22], [0.01, 0, 0.22]])
    lift = np.linspace(0, 0.2, 10)[:, None, None] * [0, 0, 1.0]
    points = start + lift
    points[3, 1] = np.nan
    return {"points": points, "controllers": hands + lift}


def test_the_example_has_no_error_and_is_scored(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    assert main(["new-case", "cases/bar"]) == 0
    assert "bar: 45 frames (31 to fit, 14 to score) of 108 points and 6 controllers" in capsys.readouterr().out
    assert {finding.severity for finding in check("cases/bar")} == {"warning"}
    assert main(["run", "--data", "cases", "--methods", "static", "rigid", "--quiet"]) == 0
    printed = capsys.readouterr().out
    assert "cases, prediction" in printed and "track_" in printed


def test_the_example_is_its_formula():
    one = example("bar")
    assert one.tracks.shape == (45, 9, 3) and not np.ptp(one.points[..., 1:], axis=0).any()
    top, low = one.points[:, 0, 0] - one.points[0, 0, 0], one.points[:, 11, 0] - one.points[0, 11, 0]
    t = np.arange(45) / 30
    np.testing.assert_allclose(top, 0.08 * np.sin(2 * np.pi * 0.8 * t), atol=1e-12)
    np.testing.assert_allclose(low[5:], 0.08 * np.sin(2 * np.pi * 0.8 * (t[5:] - 0.15)), atol=1e-12)


@pytest.mark.parametrize("unit", UNITS)
def test_arrays_are_read_back_in_metres(tmp_path, arrays, unit):
    file = saved(tmp_path, **{name: array / UNITS[unit] for name, array in arrays.items()})
    said = ["--gravity", "0", "0", "-9.81", "--table", "0", "--unit", unit, "--fps", "25", "--train", "0.5"]
    assert main(["new-case", str(tmp_path / "case"), "--arrays", str(file), *said]) == 0
    one = read_case(tmp_path / "case")
    seen = np.isfinite(arrays["points"]).all(-1)
    np.testing.assert_array_equal(one.visible, seen)
    np.testing.assert_allclose(one.points[seen], arrays["points"][seen], atol=1e-12)
    np.testing.assert_allclose(one.controllers, arrays["controllers"], atol=1e-12)
    np.testing.assert_array_equal(one.motion_valid[:-1], seen[:-1] & seen[1:])
    assert (one.fps, one.split.train_end, one.ground.normal.tolist(), one.ground.offset) == (25, 5, [0, 0, 1], 0)
    assert one.gravity.tolist() == list(DOWN) and not one.motion_valid[-1].any()


def test_a_file_for_each_array(tmp_path, arrays):
    for name, array in arrays.items():
        np.save(tmp_path / f"{name}.npy", array)
    found = read_arrays(tmp_path / f"{name}.npy" for name in arrays)
    assert set(found) == set(arrays)
    with pytest.raises(ValueError, match="points must be given once"):
        read_arrays([tmp_path / "points.npy", saved(tmp_path / "more", **arrays)])


def test_points_that_start_later_are_left_out_and_that_is_said(arrays):
    points = arrays["points"].copy()
    points[0, 2] = np.nan
    one, notes = recording("case", arrays | {"points": points, "colors": np.zeros((10, 4, 3))}, gravity=DOWN)
    assert one.points.shape == (10, 3, 3) and one.colors.shape == (10, 3, 3)
    assert notes == ["1 of 4 points have no position in frame 0 and are left out"]


@settings(max_examples=60, deadline=None)
@tried("points", (9, 4, 3), 0.0)
@given(
    st.sampled_from(NAMES),
    st.sampled_from([(), (3,), (10,), (10, 4), (10, 4, 3), (9, 4, 3), (10, 4, 2), (0, 4, 3), (10, 0, 3), (2, 3)]),
    st.sampled_from([0.0, 1.0, 2.5, np.nan, np.inf, 1e9]),
)
def test_whatever_an_array_is_it_is_a_recording_or_a_value_error(name, shape, value):
    start = np.zeros((10, 4, 3)) + np.arange(4)[:, None] * 0.05
    try:
        one, _ = recording("case", {"points": start, name: np.full(shape, value)}, gravity=DOWN)
    except ValueError as error:
        assert str(error)
    else:
        assert one.frame_count == (shape[0] if name == "points" else 10) and np.isfinite(one.points).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a: a | {"hands": a["controllers"]}, "unknown array 'hands'"),
        (lambda a: {"controllers": a["controllers"]}, "points (frames, points, 3) must be among the arrays, got controllers (from "),
        (lambda a: a | {"points": a["points"][0]}, "points must have shape (frames, points, 3), got (4, 3)"),
        (lambda a: a | {"controllers": a["controllers"] * np.nan}, "controllers must be finite"),
        (lambda a: a | {"controllers": a["controllers"] + 1}, "controllers must be within reach of the body"),
        (lambda a: a | {"points": a["points"].astype(str)}, "points must hold numbers"),
        (lambda a: a | {"visible": np.ones((3, 3))}, "visible must have shape (10, 4)"),
        (lambda a: a | {"visible": np.full((10, 4), np.nan)}, "visible must be bool, got float64 with values other than 0 and 1"),
    ],
)
def test_wrong_arrays_are_refused(tmp_path, arrays, capsys, change, said):
    file = saved(tmp_path, **change(arrays))
    assert main(["new-case", str(tmp_path / "case"), "--arrays", str(file), "--gravity", "0", "0", "-9.81"]) == 2
    err = capsys.readouterr().err
    assert said in err and "take.npz" in err and not (tmp_path / "case").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "--gravity must say which way is down"),
        (["--gravity", "0", "0", "-9.81", "--unit", "inch"], "unknown unit 'inch'"),
        (["--gravity", "0", "0", "0", "--table", "0"], "gravity must have a direction"),
        (["--gravity", "0", "0", "-9.81", "--fps", "0"], "fps must be a number from 0.1"),
        (["--gravity", "0", "0", "-9.81", "--train", "0"], "--train must be a share"),
        (["--gravity", "0", "0", "-9810"], "gravity must be at most 100 m/s^2"),
    ],
)
def test_wrong_options_are_refused(tmp_path, arrays, capsys, options, said):
    assert main(["new-case", str(tmp_path / "case"), "--arrays", str(saved(tmp_path, **arrays)), *options]) == 2
    err = capsys.readouterr().err
    assert said in err and "take.npz" not in err  # which is not to blame


@pytest.mark.parametrize(
    "option", [["--gravity", "0", "0", "1"], ["--table", "0"], ["--unit", "mm"], ["--fps", "5"], ["--train", "1"], ["--object", "x"]]
)
def test_what_arrays_are_is_not_said_without_them(tmp_path, capsys, option):
    assert main(["new-case", str(tmp_path / "case"), *option]) == 2
    assert f"{option[0]} says what --arrays are, and none are given" in capsys.readouterr().err and not (tmp_path / "case").exists()


def test_a_place_that_cannot_be_written_is_named(tmp_path, capsys, monkeypatch):
    (tmp_path / "file").touch()
    assert main(["new-case", str(tmp_path / "file" / "case")]) == 2
    assert f"writing the case {tmp_path}/file/case failed, nothing of it was kept" in capsys.readouterr().err

    def full(**_):
        raise OSError(28, "No space left on device", str(tmp_path / ".case.partial"))

    monkeypatch.setattr("tempfile.mkdtemp", full)
    assert main(["new-case", str(tmp_path / "case")]) == 2
    assert "/case failed, nothing of it was kept: No space left on device\n" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"", b"not an archive", b"PK\x03\x04cut", b"\x93NUMPY\x01\x00\x04\x00\xff\xff\xff\n"])
def test_files_that_are_no_arrays_are_named(tmp_path, content):
    (tmp_path / "points.npy").write_bytes(content)
    with pytest.raises(ValueError, match=r"points.npy: (points is not an array that numpy wrote|not a complete .npz file)"):
        read_arrays([tmp_path / "points.npy"])


def test_pickled_arrays_are_refused(tmp_path):
    np.save(tmp_path / "points.npy", np.array([{}], object), allow_pickle=True)
    with pytest.raises(ValueError, match=r"points.npy: points must hold numbers, got Python objects"):
        read_arrays([tmp_path / "points.npy"])


def test_nothing_is_written_over(tmp_path, capsys):
    assert main(["new-case", str(tmp_path / "case")]) == 0
    assert main(["new-case", str(tmp_path / "case")]) == 2
    assert "already exists" in capsys.readouterr().err
    assert main(["new-case", str(tmp_path / "case"), "--overwrite"]) == 0


def lifted():
    """The example with its body clear of the table, as it is sound."""
    return replace(example("case"), name="case", object="case")


FAULTS = {  # what is wrong with a recording, and what check, run, diagnose and new-case say of it
    "millimetres": (
        lambda one: replace(one, **{name: 1000 * getattr(one, name) for name in ("points", "controllers", "tracks")}, ground=None),
        "must be in metres, got a body that is 300 m long in frame 0: are these millimetres? Then it is 0.3 m",
    ),
    "both upwards": (
        lambda one: replace(one, gravity=[0, 0, 9.8], ground=Plane([0, 0, -1.0])),
        "gravity points upwards for these data, got [0.0, 0.0, 9.8]: points and hands lie up to 0.52 m below the table. "
        "Unless the table lies lower than at its offset 0, turned round: gravity [0.0, 0.0, -9.8] and a ground with the normal "
        "[0.0, 0.0, 1.0] and the offset 0",
    ),
    "gravity upwards": (
        lambda one: replace(one, gravity=[0, 0, 9.81]),
        "gravity must point to the table, got [0.0, 0.0, 9.81], away from it along its normal [0.0, 0.0, 1.0]",
    ),
    "no table": (
        lambda one: replace(one, gravity=[0, 0, 9.81], ground=None),
        "gravity may point upwards for these data: [0.0, 0.0, 1.0] is down, and the body lies above what holds it",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_units_and_gravity_are_recognised_in_the_same_words(tmp_path, monkeypatch, capsys, caplog, fault):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    change, words = FAULTS[fault]
    wrong = write_case("cases/case", change(lifted()))
    refused = fault != "no table"
    assert main(["check", str(wrong)]) == refused
    assert words in capsys.readouterr().out
    assert main(["run", "--data", "cases", "--methods", "static", "--metrics", "track_error", "--quiet"]) == 2 * refused
    assert words in capsys.readouterr().err + caplog.text
    if refused:
        assert main(["diagnose", str(wrong), "--quiet"]) == 2
        assert words in capsys.readouterr().err
    else:
        open_collection(wrong)  # a diagnosis loads recordings as run does
    arrays = {"points": change(lifted()).points, "controllers": change(lifted()).controllers}
    table = ["--table", "0"] if fault == "both upwards" else []
    options = ["--gravity", "0", "0", "-9.81" if fault == "millimetres" else "9.8", *table]
    code = main(["new-case", "again", "--arrays", str(saved(tmp_path / "arrays", **arrays)), *options])
    printed = capsys.readouterr()
    if fault != "gravity upwards":  # there new-case is given no table
        assert code == (2 if refused else 0) and words in printed.out + printed.err


@pytest.mark.parametrize("name", ["plush_lift", "plush_drag"])
def test_the_sample_turned_upside_down_is_recognised(tmp_path, name):
    # its axes are published ones, z into the table; z upwards in the same file is what most people write first
    one = open_collection("sample").load(name)
    turned = np.array([1.0, -1, -1])
    flipped = {field: getattr(one, field) * turned for field in ("points", "controllers", "surface", "interior", "tracks")}
    flipped["points"] = np.where(one.visible[..., None], flipped["points"], 0)
    wrong = write_case(tmp_path / "case", replace(one, **flipped, cameras=(), images=None))
    said = [finding for finding in check(wrong) if finding.severity == "error"]
    assert len(said) == 1 and said[0].file.name == "scenario.json" and said[0].said.startswith("gravity points upwards for these data")
    right = write_case(
        tmp_path / "right", replace(one, **flipped, cameras=(), images=None, gravity=[0, 0, -9.8], ground=Plane([0, 0, 1.0]))
    )
    assert not [finding for finding in check(right) if finding.severity == "error"]


def test_a_table_that_is_told_wrong_is_no_upside_down():
    # a body that lies on a table 6 cm below the one that is told, and hands above it: the diagnosis asks about that
    one = example("case")
    low = replace(one, ground=Plane([0, 0, 1.0], 0.26))
    from twinbench.datasets.findings import collected
    from twinbench.datasets.plausible import plausible

    assert not [finding for finding in collected(plausible(vars(low)))[0] if finding.field == "gravity"]
