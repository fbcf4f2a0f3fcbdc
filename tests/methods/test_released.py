"""Twins as PhysTwin's authors publish them: files of ``helpers/released_files.py``, which imports nothing of ours.

The helper searches springs by brute force in the published order, gives each its own stiffness and integrates the published substep in
float64. So our roll-out of its files is its own to float32 rounding, which 3,335 substeps carry to below 1 um, and only if every stiffness
sits on its spring: two neighbours exchanged move it by 0.6 mm.
"""

import csv
import json
import math
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest
import released_files
import torch
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.cli import main
from twinbench.benchmark.opening import open_recordings
from twinbench.benchmark.picture import Player
from twinbench.benchmark.plan import Evaluation, Fit
from twinbench.benchmark.released import Engine, Looks, Rolled
from twinbench.benchmark.results import read_results
from twinbench.benchmark.runner import Settings
from twinbench.benchmark.score import apart, overall
from twinbench.datasets.phystwin import read_case
from twinbench.methods.appearance.config import AS_PUBLISHED as LOOK
from twinbench.methods.base import Budget, Diverged, Trajectory
from twinbench.methods.phystwin import PhysTwin
from twinbench.methods.phystwin.body import Place
from twinbench.methods.phystwin.config import AS_PUBLISHED, CORRECTED, Config
from twinbench.methods.phystwin.publish import write_twin
from twinbench.methods.phystwin.released import read_checkpoint, read_parameters, read_trajectory, read_twin, released
from twinbench.methods.registry import methods
from twinbench.metrics.base import get_metric
from twinbench.physics.terms import Gravity

NAME = "single_push_rope"
ROUNDING = 1e-6  # m, see above


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return released_files.make(tmp_path_factory.mktemp("released"), NAME)


@pytest.fixture(scope="module")
def observed(made):
    return read_case(made.data / NAME).observed()


@pytest.fixture
def files(made, tmp_path):
    """The twin's files, to be spoilt."""
    shutil.copytree(made.twins, tmp_path / "twins")
    return released(tmp_path / "twins")[NAME]


def test_springs_and_what_belongs_to_each(made, observed):
    twin = read_twin(released(made.twins)[NAME], observed)
    np.testing.assert_array_equal(twin.body.springs, made.own)
    np.testing.assert_array_equal(twin.body.pulls, made.held)
    learned = np.clip(made.stiffness.astype(float), 0, 1e5)  # stored as learned, clamped in the kernels
    assert (made.stiffness > 1e5).any()
    np.testing.assert_array_equal(np.concatenate([twin.body.stiffness, twin.body.pull]), learned)
    values = twin.body.values
    assert (values["drag_damping"], values["dashpot_damping"]) == (5.0, 37.0)  # a loader casts them to int
    assert values["collide_elas"] == pytest.approx(0.25) and values["collide_fric"] == pytest.approx(0.6)  # not the search's
    assert (values["collide_object_elas"], values["collide_object_fric"]) == (1.0, 0.0)  # raw 1.3 and -0.1
    assert twin.config.quirks == AS_PUBLISHED and not twin.transferred


def test_our_engine_follows_the_stored_trajectory(made, observed):
    twin = read_twin(released(made.twins)[NAME], observed)
    stored = read_trajectory(released(made.twins)[NAME].trajectory, observed)
    assert np.linalg.norm(stored[-1] - stored[0], axis=1).max() > 0.03  # it moves by centimetres
    assert np.abs(twin.rollout(observed.controllers).positions - stored).max() < ROUNDING
    for part in ("stiffness", "pull"):
        wrong = getattr(twin.body, part).copy()
        wrong[[3, 4]] = wrong[[4, 3]]
        other = replace(twin, body=replace(twin.body, **{part: wrong})).rollout(observed.controllers)
        assert np.abs(other.positions - stored).max() > 10 * ROUNDING, part


def test_twins_are_found_where_archives_unpack_and_one_a_folder(made, tmp_path):
    assert list(released(made.twins)) == [NAME]
    shutil.copytree(made.twins, tmp_path / "root" / "data")
    assert released(tmp_path / "root")[NAME].optimal.is_file()
    alone = tmp_path / "alone" / NAME
    for archive in ("experiments_optimization", "experiments", "gaussian_output"):
        shutil.copytree(made.twins / archive / NAME, alone, dirs_exist_ok=True)
    for folder in (alone, alone.parent):
        found = released(folder)[NAME]
        assert found.checkpoint == alone / "train" / "best_40.pth" and found.point_cloud.parts[-2] == "iteration_10000"
    for folder, said in ((tmp_path / "none", "no such folder"), (made.data, "it must hold experiments_optimization")):
        with pytest.raises(ValueError, match=said):
            released(folder)


def test_of_several_the_last_checkpoint_and_the_published_gaussians(files):
    shutil.copy(files.checkpoint, files.checkpoint.with_name("best_180.pth"))
    (files.checkpoint.parent / "best_x.pth").touch()
    assert files.checkpoint.name == "best_180.pth"
    published = files.point_cloud
    for other in ("another", "zz"):
        shutil.copytree(files.gaussians / released_files.RUN, files.gaussians / other)
    assert files.point_cloud == published
    shutil.rmtree(files.gaussians / released_files.RUN)
    assert files.point_cloud.parts[-5:-3] == (NAME, "zz")


PARAMETERS = {
    "missing": ("drag_damping", None, "optimal_params.pkl: drag_damping missing"),
    "text": ("drag_damping", "3", "optimal_params.pkl: drag_damping must be a number, got a str"),
    "array": ("drag_damping", np.zeros(2), "drag_damping must be a number, got a ndarray"),
    "nan": ("object_radius", np.float64("nan"), r"object_radius must lie in \[0.0001, 1\], got nan"),
    "zero": ("controller_radius", 0.0, r"controller_radius must lie in \[0.0001, 1\], got 0"),
    "huge": ("object_max_neighbours", 10**30, r"object_max_neighbours must lie in \[1, 500\], got 1e\+30"),
    "negative": ("global_spring_Y", -1.0, r"global_spring_Y must lie in \[0, 1e\+07\], got -1"),
    "slippery": ("collide_fric", 2.5, r"collide_fric must lie in \[0, 2\], got 2.5"),
}


@pytest.mark.parametrize("case", PARAMETERS)
def test_bad_parameters_are_refused(case, files):
    key, value, said = PARAMETERS[case]
    found = released_files.OPTIMAL | {key: value}
    files.optimal.write_bytes(pickle.dumps({k: v for k, v in found.items() if v is not None}))
    with pytest.raises(ValueError, match=said):
        read_parameters(files.optimal)


class Shout:
    """A pickle of one runs a command."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        import os

        return os.system, (f"touch {self.file}",)


@pytest.mark.parametrize("which", ["optimal", "trajectory", "checkpoint"])
def test_nothing_in_a_file_is_run(which, files, observed, tmp_path):
    file = getattr(files, which)
    file.write_bytes(pickle.dumps(Shout(tmp_path / "ran")))
    with pytest.raises(ValueError, match=file.name):
        read_trajectory(file, observed) if which == "trajectory" else read_twin(files, observed)
    torch.save({"spring_Y": Shout(tmp_path / "ran")}, file)
    with pytest.raises(ValueError, match=r"calls for \w+\.system|not a complete pickle|refused"):
        read_checkpoint(file, 1, 1)
    assert not (tmp_path / "ran").exists()


CHECKPOINTS = {
    "missing": (lambda c: c.pop("collide_fric"), "collide_fric missing; it holds epoch, num_object_springs, spring_Y"),
    "other springs": (lambda c: c.update(num_object_springs=153), "num_object_springs must be 154, as many as .* get, got 153"),
    "a tensor": (lambda c: c.update(num_object_springs=torch.tensor(154)), "num_object_springs must be 154, .* got a Tensor"),
    "one too many": (
        lambda c: c.update(spring_Y=torch.ones(190)),
        r"spring_Y must have shape \(189,\) for the 154 .* and 35 .*, got \(190,\)",
    ),
    "a list": (lambda c: c.update(spring_Y=[1.0] * 189), "spring_Y must be a tensor, got a list"),
    "flat": (lambda c: c.update(spring_Y=torch.ones(189, 1)), r"spring_Y must have shape \(189,\).*got \(189, 1\)"),
    "nan": (lambda c: c["spring_Y"].__setitem__(7, math.nan), "spring_Y must be finite, got nan at index 7"),
    "negative": (lambda c: c["spring_Y"].__setitem__(9, -2.0), r"spring_Y must be >= 0 \[N\], got -2.0 at index 9"),
    "complex": (lambda c: c.update(spring_Y=torch.ones(189, dtype=torch.complex64)), "calls for torch.ComplexFloatStorage"),
    "two elasticities": (lambda c: c.update(collide_elas=torch.ones(2)), r"collide_elas must have shape \(1,\), got \(2,\)"),
}


@pytest.mark.parametrize("case", CHECKPOINTS)
def test_checkpoints_that_do_not_fit_are_refused(case, files, observed, made):
    spoil, said = CHECKPOINTS[case]
    state = released_files.checkpoint(made.stiffness, len(made.own))
    spoil(state)
    torch.save(state, files.checkpoint)
    with pytest.raises(ValueError, match=rf"best_40\.pth: .*{said}"):
        read_twin(files, observed)


TRAJECTORIES = {
    "a dict": (lambda x: {"x": x}, "must hold an array of floating-point numbers, got a dict"),
    "whole numbers": (lambda x: x.astype(int), "got one of type int64"),
    "a frame less": (lambda x: x[1:], r"must have shape \(6, 34, 3\), the recording's frames and its particles, got \(5, 34, 3\)"),
    "with controllers": (lambda x: np.concatenate([x, x[:, :5]], 1), r"got \(6, 39, 3\)"),
    "nan": (lambda x: np.where(np.arange(6)[:, None, None] == 4, np.nan, x), "must be finite, got NaN or infinity in frame 4"),
    "far away": (lambda x: np.where(np.arange(6)[:, None, None] == 2, 1e300, x), "must be finite, got NaN or infinity in frame 2"),
    "another order": (lambda x: x[:, ::-1], r"frame 0 must be the recording's particles to 0.0001 m .*, got 0.\d+ m off"),
}


@pytest.mark.parametrize("case", TRAJECTORIES)
def test_trajectories_that_do_not_fit_are_refused(case, files, observed, made):
    spoil, said = TRAJECTORIES[case]
    files.trajectory.write_bytes(pickle.dumps(spoil(made.stored)))
    with pytest.raises(ValueError, match=rf"inference\.pkl: .*{said}"):
        read_trajectory(files.trajectory, observed)


def test_what_is_missing_is_named(files, observed):
    files.checkpoint.unlink()
    with pytest.raises(ValueError, match=r"best_EPOCH\.pth: missing; twinbench download experiments brings it"):
        read_twin(files, observed)
    files.optimal.unlink()
    with pytest.raises(ValueError, match=r"optimal_params\.pkl: missing; twinbench download experiments_optimization brings it"):
        read_twin(files, observed)


# ---------------------------------------------------------------- the command


def score(made, tmp_path, monkeypatch, *more):
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    options = ["--metrics", "chamfer", "track_error", "--out", str(tmp_path / "out"), *more]
    code = main(["score", "--released", str(made.twins), "--data", str(made.data), *options])
    return code, read_results(tmp_path / "out")


def test_score_prints_both_and_how_far_they_are_apart(made, tmp_path, monkeypatch, capsys):
    code, results = score(made, tmp_path, monkeypatch)
    assert code == 0
    found = {(row["task"], row["method"]): row for row in results.rows}
    ours, stored = "phystwin (released, our engine)", "phystwin (released, stored trajectory)"
    assert set(found) == {(task, method) for task in ("resimulation", "prediction") for method in (ours, stored)}
    scenario = read_case(made.data / NAME)
    # published: tracks matched at frame 0, here the first three points, mean over points, then frames
    for task, frames in (("resimulation", range(1, 4)), ("prediction", range(4, 6))):
        expected = np.mean([np.linalg.norm(made.stored[t, :3].astype(np.float32) - scenario.tracks[t], axis=1).mean() for t in frames])
        assert found[task, stored]["track_error"] == pytest.approx(expected, rel=1e-5)
        assert found[task, ours]["track_error"] == pytest.approx(expected, abs=ROUNDING)
    printed = capsys.readouterr().out
    assert "single_push_rope: our engine is " in printed and "mm at most, in frame" in printed
    (gap,) = csv.DictReader((tmp_path / "out" / "apart.csv").open())
    assert 0 < float(gap["mean"]) < float(gap["largest"]) < ROUNDING
    assert score(made, tmp_path, monkeypatch)[0] == 0
    assert [row["fit_seconds"] for row in read_results(tmp_path / "out").rows] == [row["fit_seconds"] for row in results.rows]  # remembered


def test_a_damaged_file_is_a_failed_row_and_exit_code_1(made, tmp_path, monkeypatch, capsys):
    spoilt = tmp_path / "spoilt"
    shutil.copytree(made.twins, spoilt)
    file = next(spoilt.rglob("best_40.pth"))
    file.write_bytes(file.read_bytes()[:-100])
    code, results = score(replace_twins(made, spoilt), tmp_path, monkeypatch)
    status = {row["method"]: row["status"] for row in results.rows}
    assert code == 1 and sorted(status.values()) == ["failed", "ok"]
    assert "best_40.pth: not a complete checkpoint" in " ".join(capsys.readouterr().out.split())


def test_a_twin_without_a_stored_trajectory_is_scored_alone(made, tmp_path, monkeypatch, capsys):
    alone = tmp_path / "alone"
    shutil.copytree(made.twins, alone, ignore=shutil.ignore_patterns("inference.pkl"))
    code, results = score(replace_twins(made, alone), tmp_path, monkeypatch)
    assert code == 0 and sorted(row["status"] for row in results.rows) == ["ok", "ok", "skipped", "skipped"]
    printed = capsys.readouterr().out
    assert "no trajectory was stored" in printed and "our engine is" not in printed


def test_a_twin_that_blew_up_says_so_to_whoever_asks(files, observed, tmp_path):
    files.settings.write_text(
        json.dumps({"quirks": {"long_frame": False}, "substeps": 1})
    )  # omega dt = 3e2 at 1e5 N and 1 cm; 2 is the limit
    rolled = Engine({NAME: files}).fit([observed], budget=Budget())
    rolled.save(tmp_path)
    for twin in (rolled, Rolled.load(tmp_path)):
        assert twin.positions is None
        with pytest.raises(Diverged):
            twin.rollout(observed.controllers)


def test_twins_and_recordings_in_one_folder(made, tmp_path, monkeypatch):
    # as twinbench download puts them
    shutil.copytree(made.twins, tmp_path / "all")
    shutil.copytree(made.data, tmp_path / "all" / "different_types")
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    assert main(["score", "--released", str(tmp_path / "all"), "--metrics", "chamfer", "--out", str(tmp_path / "out")]) == 0
    assert {row["status"] for row in read_results(tmp_path / "out").rows} == {"ok"}


def test_transfer_and_recordings_without_a_twin(made, tmp_path, monkeypatch, capsys):
    # a published pair, of which one twin was released: it is placed in the other recording, whose own twin is not there
    data = tmp_path / "data"
    shutil.copytree(made.data, data)
    released_files.write_data(data, "rope_double_hand", made.points, made.hands, made.stored)
    code, results = score(replace_twins(made, made.twins, data), tmp_path, monkeypatch, "--tasks", "transfer")
    rows = {row["method"]: row for row in results.rows}
    assert code == 0 and {row["scenario"] for row in rows.values()} == {"rope_double_hand"}
    ours, stored = rows["phystwin (released, our engine)"], rows["phystwin (released, stored trajectory)"]
    assert (ours["status"], stored["status"]) == ("ok", "skipped") and "on no other" in stored["reason"]
    assert ours["track_error"] < 0.01  # the same hands pull the same body, held anew
    assert "Not scored, for want of a twin: rope_double_hand" in capsys.readouterr().out


def replace_twins(made, twins, data=None):
    from types import SimpleNamespace

    return SimpleNamespace(**vars(made) | {"twins": twins, "data": data or made.data})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--released", "{twins}/nowhere", "--data", "{data}"], "no released twins at"),
        (["--released", "{twins}", "--data", "sample"], "holds twins of single_push_rope, and sample recordings of plush_"),
        (["--released", "{twins}"], "no recordings at"),
        (["--released", "{twins}", "--data", "{data}", "--tasks", "dance"], "unknown task 'dance'"),
        (["--released", "{twins}", "--data", "{data}", "--tasks", "transfer"], "nothing to score: no task of transfer"),
    ],
)
def test_wrong_options_are_a_line_and_code_2(options, said, made, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    assert main(["score", *(option.format(twins=made.twins, data=made.data) for option in options)]) == 2
    assert said in capsys.readouterr().err


def test_apart_is_a_distance():
    still = Trajectory(np.zeros((4, 2, 3), np.float32), (2, 0, 0))
    moved = still.positions.copy()
    moved[1, 0] = [3e-3, 0, 4e-3]  # 5 mm
    moved[3, 1] = [0, 1e-2, 0]  # 10 mm
    gap = apart("one", Trajectory(moved, (2, 0, 0)), still, train_end=3)
    assert (gap.mean, gap.mean_train, gap.mean_test) == pytest.approx((15e-3 / 6, 5e-3 / 4, 10e-3 / 2), rel=1e-6)
    assert gap.largest == pytest.approx(1e-2) and gap.frame == 3
    assert "one: our engine is 2.5 mm from the stored trajectory on average (1.25 mm in the train frames, 5 mm in the" in str(gap)
    assert overall([gap]) == ""
    other = replace(gap, scenario="other", mean=5e-4, largest=2e-2, frame=1)
    assert overall([gap, other]) == "All 2: 1.5 mm on average, 20 mm at most, in frame 1 of other"


def test_released_gaussians_are_shown_where_there_are_any(made, observed):
    looks = Looks(released(made.twins))
    shown = looks.fit(observed, preset="quick", seed=0, device="cpu", progress=None, quirks=LOOK)
    assert len(shown.gaussians) == 50 and shown.quirks == LOOK and looks.key[NAME]
    np.testing.assert_array_equal(shown.gaussians.log_scales, made.cloud["scale_0"])
    with pytest.raises(ValueError, match="and the recording has none"):  # fitted as ever, and this recording has none
        looks.fit(replace(observed, name="another"), preset="quick", seed=0, quirks=LOOK)


def test_images_show_the_released_gaussians_and_rows_are_known_by_them(files, tmp_path):
    cache, evaluation = Cache(tmp_path / "cache"), Evaluation("resimulation", "plush_lift")
    fit = Fit("static", ("plush_lift",), 0, (evaluation,))
    opened = open_recordings("sample", split="published", cache=cache)

    def player():
        looks = Looks({"plush_lift": files})
        found = Player(opened, Settings({"static": methods()["static"]}, {"psnr": get_metric("psnr")}, appearance=looks), cache)
        found.learn([fit])
        return found

    def pixels():
        camera = opened.collection.load("plush_lift").cameras[0]
        return player().play(fit, evaluation).image(camera, 0)[..., 3]

    # one opaque Gaussian of 1 cm in the middle of the body, then a hundredth of that
    centre = opened.collection.load("plush_lift").structure.mean(0)
    key, seen = {}, {}
    for size in (1e-2, 1e-4):
        cloud = released_files.gaussians(1, 0) | {"opacity": np.float32([9.0]), "scale_0": np.float32([np.log(size)])}
        cloud |= {name: np.float32([x]) for name, x in zip("xyz", centre, strict=True)}
        files.point_cloud.write_bytes(released_files.point_cloud(cloud))
        key[size], seen[size] = player().row_origin(fit, evaluation).key, pixels()
    assert key[1e-2] != key[1e-4]
    assert seen[1e-2].max() > 0.5  # the nearest pixel may be 0.7 pixels from its centre, where it has 0.9999
    assert seen[1e-2].sum() > 3 * seen[1e-4].sum() > 0


# ---------------------------------------------------------------- writing


def fitted(observed, quirks, **more):
    config = Config(quirks=quirks, iterations=1, population=3, epochs=2, rate=0.05, **more)
    return PhysTwin().fitted([observed], config, seed=0, device="cpu")


@pytest.mark.parametrize(("quirks", "more"), [(AS_PUBLISHED, {}), (CORRECTED, {"substeps": 400})], ids=["as published", "corrected"])
def test_a_fitted_twin_written_and_read_again_rolls_out_alike(quirks, more, observed, tmp_path):
    twin = fitted(observed, quirks, **more)
    ours = twin.rollout(observed.controllers).positions
    files = write_twin(twin, tmp_path, ours)
    assert files.settings.exists() == (quirks != AS_PUBLISHED)
    assert len(set(twin.body.stiffness)) > 100  # every spring has learned its own
    again = read_twin(released(tmp_path)[NAME], observed)
    assert np.abs(again.rollout(observed.controllers).positions - ours).max() < ROUNDING  # only float32 is between them
    np.testing.assert_array_equal(read_trajectory(files.trajectory, observed), ours)


def test_written_files_are_those_that_the_authors_code_reads(observed, tmp_path):
    files = write_twin(fitted(observed, AS_PUBLISHED), tmp_path, np.repeat(observed.structure[None], 6, 0))
    assert pickle.loads(files.optimal.read_bytes()).keys() == released_files.OPTIMAL.keys()
    state = torch.load(files.checkpoint, weights_only=True)
    assert state.keys() == released_files.checkpoint(np.ones(1), 1).keys()
    values = pickle.loads(files.optimal.read_bytes())
    assert all(type(values[f"{end}_max_neighbours"]) is int for end in ("object", "controller"))
    place = Place.of(observed)
    assert state["num_object_springs"] < len(state["spring_Y"]) and state["collide_elas"].shape == (1,)
    stored = pickle.loads(files.trajectory.read_bytes())
    assert stored.dtype == np.float32 and stored.shape == (6, len(place.structure), 3)


def test_twins_that_the_files_cannot_hold_are_refused(made, observed, tmp_path):
    twin = read_twin(released(made.twins)[NAME], observed)
    positions = made.stored
    other = {
        "no place for further physics, and the twin of single_push_rope has Gravity": replace(
            twin, body=replace(twin.body, added=(Gravity(),))
        ),
        "was placed elsewhere than it was fitted": replace(twin, transferred=True),
        "has springs that its parameters do not give": replace(twin, body=replace(twin.body, springs=twin.body.springs[::-1])),
        "must be that of a folder, got '../x'": replace(twin, place=replace(twin.place, name="../x")),
    }
    for said, one in other.items():
        with pytest.raises(ValueError, match=said):
            write_twin(one, tmp_path, positions)
    with pytest.raises(ValueError, match="all particles, got shape"):
        write_twin(twin, tmp_path, positions[1:])
    assert not list(tmp_path.iterdir())


SETTINGS = {
    "key": ({"stepps": 3}, "unknown key 'stepps'; did you mean 'substeps'"),
    "switch": ({"quirks": {"long_frames": True}}, "unknown switch 'long_frames'"),
    "steps": ({"substeps": 0}, r"substeps must lie in \[1, 100000\], got 0"),
    "list": ([1], "must hold an object, got a list"),
}


@pytest.mark.parametrize("case", SETTINGS)
def test_bad_settings_are_refused(case, files, observed):
    value, said = SETTINGS[case]
    files.settings.write_text(json.dumps(value))
    with pytest.raises(ValueError, match=rf"twinbench\.json: .*{said}"):
        read_twin(files, observed)


def test_export_writes_what_score_reads(made, tmp_path, monkeypatch, capsys):
    from twinbench.methods.phystwin import PhysTwinFirst

    presets = dict.fromkeys(("quick", "full"), Config(quirks=CORRECTED, epochs=1, rate=0.05, substeps=400))
    monkeypatch.setattr(PhysTwinFirst, "presets", presets)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    twins = tmp_path / "written"
    assert main(["export", "--out", str(twins), "--data", str(made.data), "--method", "phystwin-first"]) == 0
    assert f"{NAME}: written to {twins}" in capsys.readouterr().out
    code, _ = score(replace_twins(made, twins), tmp_path, monkeypatch)
    (gap,) = csv.DictReader((tmp_path / "out" / "apart.csv").open())
    assert code == 0 and float(gap["largest"]) < ROUNDING
