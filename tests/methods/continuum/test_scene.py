"""A scene in the frame of points that were reported elsewhere."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.phystwin import read_case
from twinbench.datasets.scenario import Plane
from twinbench.methods.continuum.bodies import bodies_of
from twinbench.methods.continuum.scene import Scene

SAMPLE = Path(__file__).parents[3] / "datasets" / "sample"
TURN, SHIFT = np.array([0.05, -0.1, 0.2]), np.array([0.004, -0.002, 0.003])


@pytest.fixture(scope="module")
def scene():
    seen = read_case(SAMPLE / "plush_lift").observed()
    return Scene.of(seen, bodies_of([seen])[0])


def test_what_is_reported_rightly_lies_elsewhere_beside_points_that_are_not(scene):
    # y = R (x - m) + m + s of the points: so of hands, while distances, turns and what is held stay; gravity turns, and is as strong
    moved, rotation, middle = scene.seen_from(TURN, SHIFT), Rotation.from_rotvec(TURN).as_matrix(), scene.structure.mean(0)
    np.testing.assert_allclose(moved.controllers, (scene.controllers - middle) @ rotation.T + middle + SHIFT, atol=1e-12)
    np.testing.assert_allclose(moved.gravity, rotation @ scene.gravity)
    np.testing.assert_array_equal(moved.structure, scene.structure)
    for was, now in zip(scene.hands, moved.hands, strict=True):
        ways, turned = np.diff(was.centre, axis=0), np.diff(now.centre, axis=0)
        np.testing.assert_allclose(turned, ways @ rotation.T, atol=1e-12)
        np.testing.assert_allclose(now.rotation @ rotation, rotation @ was.rotation, atol=1e-12)
        # a point that the hand carries along goes the way that its image in the other frame would be carried
        point = was.centre[0] + [0.01, 0.02, 0.0]
        image = (point - middle) @ rotation.T + middle + SHIFT
        expected = (was.carried(point[None])[:, 0] - middle) @ rotation.T + middle + SHIFT
        np.testing.assert_allclose(now.carried(image[None])[:, 0], expected, atol=1e-12)


def test_the_ground_is_where_it_was_beside_hands_but_never_in_the_body(scene):
    assert isinstance(scene.ground, Plane)
    moved = scene.seen_from(np.zeros(3), -0.01 * scene.ground.normal)  # points 10 mm lower than they are: so is the ground
    assert moved.ground.offset == pytest.approx(scene.ground.offset - 0.01, abs=1e-9)
    turned = [scene.seen_from(turn, np.zeros(3)).ground.normal for turn in 1e-9 * np.random.default_rng(0).normal(size=(50, 3))]
    assert np.abs(turned).max() <= 1.0  # rounding is no error
    raised = scene.seen_from(np.zeros(3), 0.01 * scene.ground.normal)
    assert raised.ground.offset <= (scene.body.surface @ scene.ground.normal).min() + 1e-9
