"""Films and stages of a diagnosis: what it wrote is what is shown, and what cannot be read is said in one line."""

from dataclasses import replace

import numpy as np
import pytest
from blocks import lifted
from twinbench.benchmark.cli import main
from twinbench.benchmark.playground.casting import stage_of
from twinbench.benchmark.playground.diagnosed import is_diagnosis, of_diagnosis, recorded_for, twins_of
from twinbench.diagnosis.keeping import write_tracks, write_twins
from twinbench.diagnosis.outcome import Outcome
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.solids import Solid
from twinbench.methods.continuum.twin import ContinuumTwin
from twinbench.physics.terms import Wind

VALUES = dict(youngs_modulus=8e3, damping_time=0.01, poisson=0.3, drag_damping=0.3)


@pytest.fixture(scope="module")
def made():
    """(a recording of a block that the wind blows at, its twin without and with the wind)."""
    told = lifted()
    scene = Scene.of(told, Solid.told(told, body_of(told, kind="solid", pitch=0.02)))
    sound = ContinuumTwin(scene, VALUES)
    return told, sound, ContinuumTwin(scene, VALUES | dict(wind_y=20.0, wind_speed=3.0), (Wind(),))


@pytest.fixture
def folder(made, tmp_path):
    """What a diagnosis of that recording writes."""
    told, sound, windy = made
    seen, blown = (np.asarray(t.rollout(told.controllers).tracked, float) for t in (sound, windy))
    count = len(told.controllers)
    records = [dict(name=told.name, role="case", frames=count, points=seen.shape[1], fps=told.fps, train_end=count // 2)]
    said = dict(verdict="missing", effect="wind", evidence=dict(recordings=records))
    up = -told.gravity / np.linalg.norm(told.gravity)
    arrays = dict(observed_0=blown, baseline_0=seen, extended_0=blown, controllers_0=told.controllers, up=up)
    hidden = arrays["observed_0"].copy()
    hidden[3, 0] = np.nan
    Outcome(said, arrays | dict(observed_0=hidden), {"baseline": sound, "extended": windy}).write(tmp_path / "out")
    return tmp_path / "out"


def test_tracks_come_back_as_they_were_written(made, folder):
    told, _, windy = made
    assert is_diagnosis(str(folder)) and not is_diagnosis(str(folder.parent))
    scenario, rollouts = of_diagnosis(str(folder))
    assert list(rollouts) == ["without", "with wind"] and not scenario.visible[3, 0] and scenario.visible.sum() == scenario.visible.size - 1
    np.testing.assert_allclose(rollouts["with wind"].tracked, windy.rollout(told.controllers).tracked, atol=1e-6)  # float32
    assert scenario.split.train_end == scenario.frame_count // 2 and scenario.fps == told.fps
    np.testing.assert_allclose(scenario.gravity, told.gravity / np.linalg.norm(told.gravity) * 9.8, atol=1e-6)


def test_twins_stand_side_by_side_and_the_wind_is_what_sets_them_apart(made, folder):
    told = made[0]
    scenario = of_diagnosis(str(folder))[0]
    twins = twins_of(str(folder))
    stage = stage_of(twins, recorded_for(twins, scenario))
    stage.following = True
    first, second = stage.players
    assert (first.name, second.name) == ("without", "with wind")
    assert "wind_y" in second.live.parameters and "wind_y" not in first.live.parameters
    for _ in range(len(told.controllers) - 1):
        stage.step()
    off = [np.linalg.norm(np.subtract(*stage.residual(p)), axis=1).mean() for p in stage.players]
    assert off[1] < 1e-5 < 1e-3 < off[0]  # m; hands come from float32
    stage.restart()
    stage.change({"wind_y": 0.0})
    stage.following = True
    for _ in range(5):
        stage.step()
    np.testing.assert_allclose(first.live.positions, second.live.positions, atol=1e-5)  # no wind, no difference but what the air brakes


def test_the_command_films_a_diagnosis(folder, tmp_path, capsys):
    assert main(["video", str(folder), "--out", str(tmp_path / "film.gif"), str(tmp_path / "film.mp4")]) == 0
    assert (tmp_path / "film.gif").stat().st_size > 5000 and (tmp_path / "film.mp4").stat().st_size > 5000
    assert main(["video", str(folder), "--scenario", "blck", "--out", str(tmp_path / "other.gif")]) == 2
    assert main(["video", str(folder), "--methods", "rigid", "--out", str(tmp_path / "other.gif")]) == 2
    assert main(["play", str(folder), "--methods", "rigid"]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert "blck" in said[0] and "own twins" in said[1] and "own twins" in said[2]
    assert not (tmp_path / "other.gif").exists()


def test_what_cannot_be_read_is_said_in_one_line(folder):
    write_twins({}, folder)
    with pytest.raises(ValueError, match="kept no twins: diagnose again"):
        twins_of(str(folder))
    (folder / "tracks.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(ValueError, match=r"tracks.npz: no tracks of a diagnosis"):
        of_diagnosis(str(folder))
    write_tracks(dict(observed_0=np.zeros((4, 5, 3)), baseline_0=np.zeros((4, 6, 3))), folder)
    with pytest.raises(ValueError, match=r"baseline_0 must have shape \(4, 5, 3\), got \(4, 6, 3\)"):
        of_diagnosis(str(folder))
    (folder / "tracks.npz").unlink()
    with pytest.raises(ValueError, match="no tracks of a diagnosis"):
        of_diagnosis(str(folder))
    (folder / "diagnosis.json").write_text("{}")
    with pytest.raises(ValueError, match="not what twinbench diagnose writes"):
        of_diagnosis(str(folder))


def test_the_next_diagnosis_takes_the_twins_of_the_last_away(made, folder):
    write_twins({"baseline": replace(made[1], values=made[1].values | {"poisson": 0.2})}, folder)
    assert sorted(p.name for p in (folder / "twins").iterdir()) == ["baseline"]
    (found,) = twins_of(str(folder)).values()
    assert found.values["poisson"] == 0.2
