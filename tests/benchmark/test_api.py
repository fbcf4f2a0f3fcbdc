"""From Python: twinbench.run, score and compare do what the command line does, and keep apart what is not the same."""

import json
import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas
import pytest
import twinbench
from twinbench.benchmark.cli import main
from twinbench.benchmark.folders import LATEST, name_for, publish, run_folder
from twinbench.benchmark.progress import REMEMBERED, SCORED, Bar
from twinbench.benchmark.results import read_results
from twinbench.datasets.phystwin import write_case
from twinbench.datasets.scenario import Scenario, Split
from twinbench.methods.static import StaticTwin

FRAMES, TRAIN, SPEED = 10, 7, 0.01


def scenario(seed, speed=SPEED):
    """A body that falls ``speed`` metres a frame."""
    random = np.random.default_rng(seed)
    points = random.uniform(-0.1, 0.1, size=(12, 3)) + [0, 0, -0.3] - speed * np.arange(FRAMES)[:, None, None] * [0, 0, 1]
    seen = np.ones((FRAMES, 12), bool)
    known = {"visible": seen, "motion_valid": seen, "controllers": points[:, :4] + 0.01, "tracks": points[:, :3]}
    return Scenario(name="", points=points, split=Split(TRAIN, FRAMES), object="thing", **known)


def folder(path, names=("a", "b", "c"), **options):
    for seed, name in enumerate(names):
        write_case(path / name, scenario(seed, **options))
    return path


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))


def run(*data, **options):
    return twinbench.run(list(data), **{"methods": ["static", "rigid"], "metrics": "track_error", "quiet": True} | options)


class Stays(twinbench.Method):
    """Frame 0, held."""

    name = "stays"
    twin_class = StaticTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        return StaticTwin.of(observed[0])


# --- run


def test_rows_and_means_are_data_frames(tmp_path):
    results = run(folder(tmp_path / "thing"), seeds=[0, 1], out="o")
    assert len(results.frame) == len(results.rows) == 2 * 2 * (3 * 2 + 6) and set(results.frame.status) == {"ok"}
    table = results.table("prediction")
    # frames 7 to 9 at 10 mm a frame, where what stays is 70, 80 and 90 mm off
    assert table.loc["static", "track_error"] == pytest.approx(0.08, abs=1e-6)
    assert list(table.index) == ["static", "rigid"] and table.loc["static", "rows"] == table.loc["static", "scored"] == 6
    assert isinstance(table, pandas.DataFrame) and "thing, prediction" in str(results) and len(repr(results)) < 100
    for wrong, said in ((("predict",), "there is no table of thing, predict"), (("prediction", "thong"), "no table of thong")):
        with pytest.raises(ValueError, match=said):
            results.table(*wrong)
    pandas.testing.assert_frame_equal(read_results("o").frame, results.frame)


def test_it_says_how_it_came_about(tmp_path, monkeypatch):
    monkeypatch.setattr("twinbench.benchmark.provenance.commit", lambda: "abc+")
    assert main(["run", "--methods", "static", "--data", str(folder(tmp_path / "thing")), "--quiet", "--jobs", "1", "--out", "o"]) == 0
    about = json.loads(Path("o/latest/about.json").read_text())["run"]
    assert about["command"] == f"twinbench run --methods static --data {tmp_path}/thing --quiet --jobs 1 --out o"
    assert (about["commit"], about["dirty"], about["plugins"]) == ("abc", True, {})
    assert about["options"]["methods"] == ["static"] and about["options"]["seeds"] == [0] and about["options"]["jobs"] == 1
    assert datetime.fromisoformat(about["started"]) <= datetime.fromisoformat(about["finished"])
    assert about["packages"]["twinbench"] == twinbench.__version__


def test_distributions_that_methods_come_from_are_named(monkeypatch):
    from twinbench.benchmark import provenance

    monkeypatch.setattr(provenance, "packages_distributions", lambda: {"elsewhere": ["else-where"]})
    monkeypatch.setattr(provenance, "version", lambda name: {"else-where": "3.1"}[name])
    outside = type("Outside", (Stays,), {"__module__": "elsewhere.methods"})
    assert provenance._plugins([outside, twinbench.get_metric("chamfer")]) == {"else-where": "3.1"}
    monkeypatch.setattr(provenance, "packages_distributions", dict)
    assert provenance._plugins([outside]) == {}  # a file that no distribution brought


def test_methods_and_metrics_of_ones_own(tmp_path):
    class Worst(twinbench.Metric):
        """The last coordinate of the prediction."""

        name, unit, direction, version = "worst", "m", "lower", 1

        def per_frame(self, prediction, scenario, frames):
            return [7.0] * len(frames)

    data = folder(tmp_path / "thing")
    results = run(data, methods=["static", Stays], metrics=["track_error", Worst()])
    table = results.table("prediction")
    assert table.loc["stays", "track_error"] == table.loc["static", "track_error"] and set(table["worst"]) == {7.0}
    with pytest.raises(ValueError, match=r"methods must be names or subclasses of Method, got 3"):
        run(data, methods=[3])
    with pytest.raises(ValueError, match="unknown method 'statik'; did you mean 'static'"):
        run(data, methods=["statik"])


NOTEBOOK = """
import sys
from dataclasses import replace
import twinbench
from twinbench.methods.static import StaticTwin

def made(shift):
    class Stays(twinbench.Method):
        name, twin_class = "stays", StaticTwin
        def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
            fits.append(shift)
            twin = StaticTwin.of(observed[0])
            return replace(twin, structure=twin.structure + shift)
    return Stays

fits = []
options = dict(metrics="track_error", scenarios="a", tasks="prediction", quiet=True)
first, second = made(0.0), made(0.001)
print([round(1e3 * twinbench.run(sys.argv[1], methods=one, **options).table("prediction").loc["stays", "track_error"])
       for one in (first, second, first)], fits)
try:
    twinbench.run(sys.argv[1], methods=first, jobs=2, **options)
except ValueError as error:
    print(error)
"""


@pytest.mark.long
def test_a_method_in_a_notebook_is_fitted_anew_when_it_is_defined_anew(tmp_path):
    # read from standard input, a program is in no file: what a notebook's cell is
    data = folder(tmp_path / "thing")
    done = subprocess.run([sys.executable, "-", str(data)], input=NOTEBOOK, capture_output=True, text=True, check=True)
    said = done.stdout.splitlines()
    # the body has fallen 80 mm in the mean; the second stays 1 mm above where it was, and beside it
    assert said[0] == "[80, 81, 80] [0.0, 0.001]"
    assert said[1].startswith("--jobs must be 1: 'stays' is not in a file of its own")


# --- what goes wrong with recordings


def spoil(case, how):
    if how == "no pickle":
        (case / "final_data.pkl").write_bytes(b"not a pickle")
    elif how == "cut short":
        (case / "final_data.pkl").write_bytes((case / "final_data.pkl").read_bytes()[:200])
    elif how == "no split":
        (case / "split.json").unlink()
    elif how == "another split":
        (case / "split.json").write_text('{"frame_len": 10, "train": [0, 99], "test": [99, 3]}')
    else:
        (case / "scenario.json").write_text("{" if how == "no json" else '{"colour": 3}')


BAD = {
    "no pickle": "final_data.pkl",
    "cut short": "final_data.pkl",
    "no split": "split.json",
    "another split": "split.json",
    "no json": "scenario.json",
    "unknown key": "scenario.json",
}


@pytest.mark.parametrize("how", BAD)
def test_one_bad_recording_is_rows_and_everything_else_is_scored(tmp_path, capsys, how):
    data = folder(tmp_path / "thing")
    spoil(data / "b", how)
    assert main(["run", "--quiet", "--methods", "static", "rigid", "--metrics", "track_error", "--data", str(data), "--out", "o"]) == 1
    out, err = capsys.readouterr()
    assert err == "" and re.search(rf"thing: \d+ rows not scored \(not in the means\): b cannot be read: .*{BAD[how]}", out)
    rows = read_results("o").frame
    lost = (rows.scenario == "b") | (rows.sources == "b")
    assert set(rows[lost].status) == {"unreadable"} and all(BAD[how] in reason for reason in rows[lost].reason)
    assert set(rows[~lost].status) == {"ok"} and np.isfinite(rows[~lost].track_error).all()
    good = rows[~lost & (rows.task == "prediction")]
    assert sorted(zip(good.scenario, good.method, strict=True)) == [(name, m) for name in "ac" for m in ("rigid", "static")]


def test_where_nothing_can_be_read_it_ends(tmp_path, capsys):
    data = folder(tmp_path / "thing", names=("a", "b"))
    for name in ("a", "b"):
        spoil(data / name, "no split")
    assert main(["run", "--quiet", "--methods", "static", "--data", str(data)]) == 2
    err = capsys.readouterr().err
    assert "a cannot be read" in err and "b cannot be read" in err and err.count("\n") == 1 and not Path("results/thing/latest").exists()


def test_folders_of_one_name_are_told_apart_and_the_same_folder_is_one(tmp_path):
    first, second = folder(tmp_path / "one" / "thing", names="a"), folder(tmp_path / "two" / "thing", names="a", speed=2 * SPEED)
    results = run(first, second, tmp_path / "one" / ".." / "one" / "thing")
    assert set(results.frame.collection) == {"thing (one)", "thing (two)"} and len(results.rows) == 2 * 2 * 2
    assert [results.table("prediction", f"thing ({name})").loc["static", "track_error"] for name in ("one", "two")] == pytest.approx(
        [0.08, 0.16], abs=1e-6
    )
    with pytest.raises(ValueError, match=r"several collections; name one of thing \(one\), thing \(two\)"):
        results.table("prediction")
    assert name_for(results.frame.collection.unique()) == "thing-one+thing-two"


@pytest.mark.parametrize("name", ["lift_\udcff", "lift\x1b[31m", "lift\u202e"])
def test_a_name_that_cannot_be_shown_is_refused_at_the_start(tmp_path, capsys, name):
    data = folder(tmp_path / "thing", names=("a", name))
    assert main(["run", "--methods", "static", "--data", str(data)]) == 2
    err = capsys.readouterr().err
    assert "the name 'lift" in err and str(data) in err and err.count("\n") == 1 and not set(err) & set("\x1b\u202e\udcff")
    assert main(["run", "--methods", "static", "--data", str(data / name)]) == 2


# --- several processes


def test_several_processes_compute_the_same(tmp_path):
    data = folder(tmp_path / "thing")
    alone = run(data, methods=["static", "rigid"], cache="one").frame
    spread = run(data, methods=["static", "rigid"], cache="two", jobs=2).frame
    same = [name for name in alone if not re.search("seconds|memory|date", name)]
    pandas.testing.assert_frame_equal(alone[same], spread[same], check_exact=True)
    with pytest.raises(ValueError, match="--jobs must be at least 1, got 0"):
        run(data, jobs=0)
    with pytest.raises(ValueError, match="--jobs must be 1: the recordings of made are in no folder"):
        run(twinbench.Collection("made", {"a": lambda: scenario(0)}, in_domain=("a",)), jobs=2)


# --- where results go


def test_nothing_is_written_over(tmp_path):
    data = folder(tmp_path / "thing", names="a")
    folders = [run(data, out="o", seeds=[seed]).folder for seed in range(3)]
    assert len({*folders}) == 3 and run_folder("o") == folders[-1] and Path("o/latest").resolve() == folders[-1].resolve()
    assert [read_results(found).rows[0]["seed"] for found in folders] == [0, 1, 2]
    assert folders == sorted(folders)
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d(_\d+)?", found.name) for found in folders)


def test_without_links_latest_is_a_file(tmp_path, monkeypatch):
    def refused(*_, **__):
        raise OSError(95, "not supported")

    monkeypatch.setattr(os, "symlink", refused)
    began = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
    found = [publish(tmp_path, began, lambda place, k=k: (place / "k").write_text(str(k))) for k in range(2)]
    assert [one.name for one in found] == ["2026-01-02_03-04-05", "2026-01-02_03-04-05_2"]
    assert (tmp_path / LATEST).read_text() == f"{found[1].name}\n" and run_folder(tmp_path) == found[1]


def test_what_cannot_be_written_leaves_nothing_behind(tmp_path):
    with pytest.raises(ZeroDivisionError):
        publish(tmp_path, datetime.now(UTC), lambda place: 1 / 0)
    assert not list(tmp_path.iterdir())


def test_folders_have_short_names_that_systems_take():
    assert name_for(["cable (a/b)", "x:y"], "stages") == "cable-a-b+x-y-stages"
    assert name_for([f"cable_{k}" for k in range(40)]) == "cable_0+39-more" and len(name_for(["x" * 300])) <= 100


# --- score


def test_positions_are_scored_by_name():
    made = replace(scenario(0), surface=np.zeros((2, 3)))
    stays = np.repeat(made.points[:1], FRAMES, axis=0)
    found = twinbench.score("track_error", stays, made)  # the test frames: 70, 80 and 90 mm
    assert found.frames == 3 and found.mean == pytest.approx(0.08)
    both = twinbench.score(["track_error", twinbench.get_metric("chamfer")], np.concatenate([stays, stays[:, :2]], axis=1), made, [1])
    assert list(both) == ["track_error", "chamfer"] and both["track_error"].mean == pytest.approx(SPEED)
    assert twinbench.score("track_error", stays, replace(made, split=Split(FRAMES, FRAMES))).frames == FRAMES - 1
    with pytest.raises(ValueError, match=r"positions must have shape \(frames, particles, 3\) with 12 or 14 particles .*got \(10, 5, 3\)"):
        twinbench.score("track_error", stays[:, :5], made)
    with pytest.raises(ValueError, match="unknown metric 'track_eror'; did you mean 'track_error'"):
        twinbench.score("track_eror", stays, made)
    assert math.isnan(twinbench.score("psnr", stays, made).mean)


# --- compare


def test_differences_are_paired(tmp_path):
    first, second = (run(folder(tmp_path / name / "thing", speed=speed)) for name, speed in (("one", 0.01), ("two", 0.02)))
    found = twinbench.compare(first, second).frame.set_index(["task", "method", "metric"])
    line = found.loc["prediction", "static", "track_error"]
    # every recording falls 80 mm farther: the recordings' differences are one and the same, however the recordings differ
    assert (line.a, line.b, line.difference) == pytest.approx((0.08, 0.16, 0.08), abs=1e-6)
    assert line.interval95 == pytest.approx(0, abs=1e-6) and line.pairs == 3 and line.interval_over == "recordings"


def rows(values, method="a", seed=0, **other):
    """Rows of a metric, by recording."""
    about = {"collection": "made", "task": "prediction", "sources": "", "method": method, "seed": seed, "status": "ok", "reason": ""}
    about |= {"frames": 2, "chamfer_unscorable": 0, "data_checksum": "d", "code_checksum": "c", "commit": "1"}
    return [about | {"scenario": name, "chamfer": value} | other for name, value in values.items()]


def results(*found, **options):
    return twinbench.Results([row for group in found for row in group], {"chamfer": "m"}, {"chamfer": "lower"}, **options)


def test_an_interval_is_over_recordings_with_seeds_averaged_first():
    a = results(rows({"x": 0.010, "y": 0.020, "z": 0.030}), rows({"x": 0.012, "y": 0.022, "z": 0.032}, seed=1))
    b = results(rows({"x": 0.011, "y": 0.022, "z": 0.033}), rows({"x": 0.013, "y": 0.024, "z": 0.035}, seed=1), rows({"w": 9.0}))
    found = twinbench.compare(a, b)
    (only,) = found.differences
    # differences 1, 2 and 3 mm: mean 2 mm, and Student's t at 97.5 % with 2 degrees of freedom, 4.303, times 1 mm / sqrt(3)
    assert only.difference == pytest.approx(0.002) and only.half == pytest.approx(4.303e-3 / math.sqrt(3), rel=1e-3) and not only.clear
    assert "+2.00 ± 2.48 " in found.terminal() and "Only in B: 1 rows of a on made" in found.only
    fewer = twinbench.compare(results(rows({"x": 1.0, "y": 1.0})), results(rows({"x": 2.0, "y": 3.0}))).differences[0]
    assert math.isnan(fewer.half) and not fewer.clear  # of two recordings no interval is told, as in the leaderboard


def test_what_changed_is_said():
    values = {"x": 0.01, "y": 0.02, "z": 0.03}
    a = results(rows(values), rows(values, "b"), origin={"plugins": {"p": "1"}, "options": {"seeds": [0]}})
    changed = rows(values, "b", code_checksum="other") + rows({"z": math.nan}, status="failed", reason="KeyError: 'k'")
    b = results(rows({"x": 0.01}, data_checksum="e"), changed, origin={"plugins": {"p": "2"}, "options": {"seeds": [0]}})
    found = twinbench.compare(a, replace(b, rows=[row | {"commit": "2"} for row in b.rows]))
    assert found.changed == (
        "Data changed: x (made)",
        "Code changed of b",
        "commit: 1 in A, 2 in B",
        "plugin p: 1 in A, 2 in B",
    )
    assert found.only == (
        "Only in A: 1 rows of a on made",
        "Scored in A only: a on z (made, prediction, seed 0): failed in the other: KeyError: 'k'",
    )
    assert twinbench.compare(a, a).terminal().endswith("Code, data, versions and options are the same.")


def test_where_nothing_can_be_paired_it_says_so():
    text = twinbench.compare(results(rows({"x": 1.0})), results(rows({"y": 1.0}))).terminal()
    assert "Nothing can be paired: no recording, method, task and metric was scored in both runs." in text
    assert "Only in A: 1 rows of a on made" in text


def test_runs_are_compared_from_the_command_line(tmp_path, capsys):
    data = folder(tmp_path / "thing")
    first, _ = run(data, out="o", methods="static"), run(data, out="o", methods=["static", "rigid"])
    assert main(["compare", str(first.folder), "o"]) == 0
    out = capsys.readouterr().out
    assert "thing, prediction" in out and "Only in B: 12 rows of rigid on thing" in out
    assert "option methods: static in A, static, rigid in B" in out
    assert main(["compare", str(first.folder), "o", "--format", "csv"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("collection,task,method,metric,unit") and len(lines) == 1 + 3
    assert main(["compare", str(first.folder), "o", "--format", "markdown"]) == 0
    assert "| static | track_error" in capsys.readouterr().out
    assert main(["compare", "o", "nowhere"]) == 2
    assert "no results in nowhere" in capsys.readouterr().err


# --- progress


def test_what_is_left_is_told_once_it_is_known(monkeypatch, capsys):
    clock = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    with Bar("made", ["slow", "fast", "slow", "fast", "slow"]) as bar:
        for label, seconds, left in (
            (f"slow on a: {REMEMBERED}", 0.1, ""),
            (f"fast on a: {SCORED}", 1, ""),  # slow ones have only been remembered
            (f"slow on b: {SCORED}", 100, "about 1.7 min left"),  # 1 + 100 s
            ("fast on b: looking", 0.5, "about 1.7 min left"),
            (f"fast on b: {SCORED}", 2.5, "about 1.7 min left"),
        ):
            clock[0] += seconds
            bar(label, 0.0)
            assert bar.remaining(clock[0]) == left, label
    assert capsys.readouterr().err.splitlines() == [
        "made: 2 of 5: fast on a: scored after 1.0 s",
        "made: 3 of 5: slow on b: scored after 1.7 min, about 1.7 min left",
        "made: 4 of 5: fast on b: scored after 3.0 s, about 1.7 min left",
    ]
    with Bar("made", ["slow"], quiet=True) as bar:
        bar(f"slow on a: {SCORED}", 1.0)
    assert capsys.readouterr().err == ""
