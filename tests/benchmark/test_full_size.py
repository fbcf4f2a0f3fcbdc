"""The measurement at full published size, tried small on the CPU."""

import json
from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.full_size import PUBLISHED, SMALL, main, recorded, table
from twinbench.benchmark.full_size_steps import Clock, Step, Watch
from twinbench.datasets.synthetic import resolved


@pytest.fixture(scope="module")
def scenario():
    with pytest.MonkeyPatch.context() as patch:  # in larger cells: how it bends is not what is tested
        patch.setattr(resolved, "BLOCK", 0.045)
        return recorded(replace(SMALL, frames=6))


def test_the_full_size_is_the_published_one():
    assert list(PUBLISHED) == ["2000", "5000"]
    for size in PUBLISHED.values():
        assert (size.width, size.height, size.frames, size.preset) == (848, 480, 100, "full")
        assert set(size.limits) == {"epochs"} and size.epochs % 4 == size.updates % 50 == size.iterations % 50 == 0


def test_images_show_the_particles(scenario):
    """The tracked points of frame 0 project into the object's mask of a camera: all that the cameras saw."""
    within = np.zeros(scenario.counts[0], bool)
    for k, camera in enumerate(scenario.cameras):
        column, row = np.round(camera.project(scenario.points[0])[0]).astype(int).T
        seen = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
        within[seen] |= scenario.images.mask(k, 0)[row[seen], column[seen]]
    assert within.mean() > 0.95  # 0.7 mm of noise moves some points across the outline
    assert scenario.images.color(2, 5).shape == (40, 54, 3) and scenario.images.depth(0, 0).dtype == np.float32


def test_a_method_sees_the_images_of_the_train_frames_only(scenario):
    train = scenario.split.train_end
    images = scenario.observed().images
    assert images.mask(0, train - 1).any()
    for beyond in (train, -1):
        with pytest.raises(IndexError, match=f"frame {beyond} is not within reach"):
            images.mask(0, beyond)
    with pytest.raises(IndexError):
        images.until(100).mask(0, train)


def test_the_table_holds_a_step_its_goal_and_its_memory():
    row = table([Step("a case in all", 3.25, 2048.0, "4 of 8 frames", "99 frames")]).splitlines()[-1]
    assert [cell.strip() for cell in row.strip("|").split("|")] == ["a case in all", "3.25", "4 of 8 frames", "600", "2.00", "99 frames"]


def test_what_was_measured_is_carried_on_at_its_pace(monkeypatch):
    """A stage of 10 s before its first unit and 2 s for each: 10 + 2 n seconds, whatever share of it is measured; so in two stages."""
    seconds = iter([0.0, 12.0, 14.0, 16.0])
    monkeypatch.setattr(Clock, "now", lambda clock: next(seconds))
    watch = Watch(Clock("cpu", "full"))
    for unit in (1, 2, 3):
        watch("learning", unit / 3)
    assert watch.whole(3, 100) == (pytest.approx(10 + 2 * 100), 3)
    # two stages: 4 units of 1 s, then, after 5 s, 2 of 3 s: of ten such units 5 + 30 s
    seconds = iter([0.0, 1.0, 2.0, 3.0, 4.0, 12.0, 15.0])
    watch = Watch(Clock("cpu", "full"))
    for share in (1 / 8, 2 / 8, 3 / 8, 4 / 8, 6 / 8, 8 / 8):
        watch("learning", share)
    assert watch.whole(4, 20, first=0.0, last=0.5) == (pytest.approx(20.0), 4)
    assert watch.whole(2, 10, first=0.5, last=1.0) == (pytest.approx(35.0), 2)


@pytest.mark.slow
def test_every_step_runs_on_the_cpu(capsys, tmp_path):
    pytest.importorskip("mujoco")
    main(["--small", "--out", str(tmp_path / "steps.json")])
    said = capsys.readouterr().out
    both, fits = "PhysTwin, both stages", ("GS-Dynamics, fit", "Spring-Gaus, fit", "appearance, fit")
    for step in ("PhysTwin, zero-order stage", both, *fits, "images and metrics"):
        assert f"| {step}" in said
    assert "1 of 2 generations" in said and "failed" not in said and "| a case in all |" in said
    steps = json.loads((tmp_path / "steps.json").read_text())["steps"]["small"]
    whole = sum(step["times"] * step["seconds"] for step in steps)
    assert steps[-1]["seconds"] == pytest.approx(whole) and whole > 0
