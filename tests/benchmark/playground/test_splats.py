"""Gaussians that follow a twin move as its particles do."""

import numpy as np
import pytest
import torch
from playing import springs
from scipy.spatial.transform import Rotation
from twinbench.benchmark.conformance.scene import recording
from twinbench.benchmark.playground.splats import Splats
from twinbench.methods.appearance.gaussians import Gaussians

BONES = recording().structure


@pytest.fixture
def gaussians():
    random = np.random.default_rng(0)
    centres = torch.tensor(BONES[::2] + random.normal(0, 1e-3, BONES[::2].shape))
    shape = len(centres)
    return Gaussians(centres, torch.full((shape,), np.log(2e-3)), torch.full((shape,), 0.5), torch.zeros(shape, 1, 3))


def test_of_a_body_that_moves_rigidly_they_move_rigidly(gaussians):
    turn, shift = Rotation.from_rotvec([0.3, -0.5, 0.9]), np.array([0.1, 0.2, -0.3])
    splats = Splats(gaussians, BONES)
    centres, covariances = splats.at(turn.apply(BONES) + shift)
    np.testing.assert_allclose(centres, turn.apply(gaussians.positions.numpy()) + shift, atol=1e-9)
    np.testing.assert_allclose(covariances, np.broadcast_to(4e-6 * np.eye(3), covariances.shape), rtol=1e-5)  # sd^2 = (2 mm)^2
    np.testing.assert_allclose(splats.colours, 0.5)  # no harmonic says anything: grey


def test_a_page_shows_them_in_place_of_points_and_points_under_a_colour(gaussians, tmp_path):
    pytest.importorskip("viser", reason="viser is not installed (the extra view)")
    from twinbench.benchmark.playground.casting import stage_of
    from twinbench.benchmark.playground.filming import unused_port
    from twinbench.benchmark.playground.page import Page

    stage = stage_of({"springs": springs(ground=None)}, recording())
    page = Page(stage, host="127.0.0.1", port=unused_port(), out=tmp_path, title="made", splats={"springs": Splats(gaussians, BONES)})
    try:
        before = page.pictures[0].handles["splats"].centers.copy()
        assert "points" not in page.pictures[0].handles
        for _ in range(3):
            stage.step()
        page.draw()
        assert np.abs(page.pictures[0].handles["splats"].centers - before).max() > 1e-5
        page.look.colour = "strain"
        page.draw()
        assert page.pictures[0].handles["points"].visible and not page.pictures[0].handles["splats"].visible
    finally:
        page.close()
