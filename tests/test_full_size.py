"""The measurement at full published size, tried small on the CPU."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.full_size import PUBLISHED, SMALL, Step, main, recorded, table


@pytest.fixture(scope="module")
def scenario():
    pytest.importorskip("mujoco")
    return recorded(replace(SMALL, frames=6))


def test_the_full_size_is_the_published_one():
    assert (PUBLISHED.width, PUBLISHED.height, PUBLISHED.frames, PUBLISHED.preset, PUBLISHED.limits) == (848, 480, 100, "full", {})


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
    row = table([Step("images", 3.25, 2048.0, "99 frames")]).splitlines()[-1]
    assert [cell.strip() for cell in row.strip("|").split("|")] == ["images", "3.25", "10", "2.00", "99 frames"]


@pytest.mark.slow
def test_every_step_runs_on_the_cpu(capsys):
    pytest.importorskip("mujoco")
    main(["--small"])
    said = capsys.readouterr().out
    for step in ("zero-order stage", "first-order stage", "GS-Dynamics, updates", "appearance fit", "images", "metrics"):
        assert f"| {step}" in said
    assert "3 evaluations of 8 frames" in said and "chamfer 0.0" in said and "chamfer nan" not in said
