"""The picture of a recording: what it shows, where it goes, and what it refuses."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.cli import main
from twinbench.benchmark.opening import open_recordings
from twinbench.benchmark.picture import Player, view
from twinbench.benchmark.plan import plan
from twinbench.benchmark.runner import Settings
from twinbench.datasets.scenario import Scenario, Split
from twinbench.methods.registry import methods
from twinbench.metrics.base import get_metric


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))


@pytest.mark.parametrize("out", [None, "deep/er/here.svg"])
def test_the_command_writes_a_picture(tmp_path, capsys, out):
    pytest.importorskip("matplotlib")
    assert main(["picture", "plush_lift", "--methods", "static", "rigid", *(["--out", out] if out else [])]) == 0
    printed, err = capsys.readouterr()
    path = tmp_path / (out or "results/sample/plush_lift.png")
    assert err == "" and str(path.relative_to(tmp_path)) in printed
    start = path.read_bytes()[:5]
    assert start == (b"<?xml" if out else b"\x89PNG\r")
    assert [file.name for file in path.parent.iterdir()] == [path.name]  # nothing temporary is left
    if out:  # letters are drawn as outlines, but matplotlib leaves the text beside them
        text = path.read_text()
        assert all(word in text for word in ("static", "rigid", "never seen", "chamfer [mm] of plush_lift", "frame 33", "frame 47"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["plush_lft"], "did you mean 'plush_lift'"),
        (["--metric", "chamfr"], "did you mean 'chamfer'"),
        (["--methods", "rgid"], "did you mean 'rigid'"),
        (["--out", "here.pgn"], "must end in one of"),
        (["--preset", "ful"], "did you mean 'full'"),
        (["--out", f"{__file__}/here.png"], "choose another with --out"),
    ],
)
def test_wrong_options_are_refused_before_any_work(tmp_path, capsys, options, message):
    pytest.importorskip("matplotlib")
    assert main(["picture", *options]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "cache" / "fits").exists() and not (tmp_path / "results").exists()


def test_without_matplotlib_it_says_what_to_install(monkeypatch, capsys):
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["picture", "--methods", "static"]) == 2
    assert "[plots]" in capsys.readouterr().err


def test_the_view_is_upright_and_across_the_motion():
    # points that move along y under gravity along +x: seen from z, up is -x
    points = np.zeros((4, 1, 3))
    points[:, 0, 1] = [0, 1, 2, 3]
    seen = np.ones((4, 1), bool)
    scenario = Scenario(
        name="", points=points, visible=seen, motion_valid=seen, controllers=points, split=Split(2, 4), gravity=np.array([9.8, 0, 0])
    )
    np.testing.assert_allclose(view(scenario), [[0, 1, 0], [-1, 0, 0]], atol=1e-12)


def test_a_picture_shows_what_a_run_scores(tmp_path):
    # the mean of the drawn curve over the test frames is the row's figure, whoever fitted the twin
    cache = Cache(tmp_path / "cache")
    opened = open_recordings("sample", split="published", cache=cache)
    known = {"chamfer": get_metric("chamfer")}
    player = Player(opened, Settings({"rigid": methods()["rigid"]}, known), cache)
    rollouts, fitted = player.play_all("plush_drag", 0, lambda label, fraction: None)
    scenario = opened.collection.load("plush_drag")
    drawn = known["chamfer"](rollouts["rigid"], scenario, scenario.split.test).mean()
    rows = player.run(plan(opened.collection, methods=["rigid"], tasks=["prediction"], scenarios=["plush_drag"]))
    assert fitted and drawn == pytest.approx(rows[0]["chamfer"], rel=1e-12)


def test_a_transfer_target_has_no_fitted_frames(tmp_path):
    # plush_lift with its own twin taken from the plan: only the twin fitted on plush_drag is left
    cache = Cache(tmp_path / "cache")
    opened = open_recordings("sample", split="published", cache=cache)
    opened = replace(opened, collection=replace(opened.collection, in_domain=()))
    settings = Settings({name: methods()[name] for name in ("static", "rigid")}, {"chamfer": get_metric("chamfer")})
    rollouts, fitted = Player(opened, settings, cache).play_all("plush_lift", 0, lambda label, fraction: None)
    assert not fitted and list(rollouts) == ["static", "rigid"]
    np.testing.assert_allclose(rollouts["static"].tracked[0], opened.collection.load("plush_lift").points[0], atol=1e-7)
