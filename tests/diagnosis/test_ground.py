"""A body below the ground that is told, told from noise, from a few strays and from a body that stands on it."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twinbench.datasets.scenario import Observed, Plane
from twinbench.diagnosis.ground import DEEP, is_raised, sunk
from twinbench.diagnosis.springs import _parameters
from twinbench.physics.terms.ground_pose import GroundPose

TILTED = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])


def lying(heights, *, noise=0.0, ground=True, frames=12):
    """Particles at ``heights`` [m] over a ground that is not level; those on it and all others jitter by ``noise`` [m] a coordinate."""
    rng = np.random.default_rng(0)
    heights = np.asarray(heights, float)
    across = rng.uniform(-0.1, 0.1, (len(heights), 3))
    across -= np.outer(across @ TILTED, TILTED)
    points = across + np.outer(heights, TILTED) + rng.normal(0, noise, (frames, len(heights), 3))
    there = np.ones(points.shape[:2], bool)
    plane = Plane(normal=TILTED, offset=0.0) if ground else None
    controllers = points[:, :1]
    return Observed(name="one", points=points, visible=there, motion_valid=there, controllers=controllers, fps=30.0, ground=plane)


@given(st.floats(0.0, 0.2), st.floats(0.0, 0.004))
def test_what_stands_on_the_ground_or_above_is_not_sunk(height, noise):
    # thick or thin, as noisy as a depth camera: its lowest tenth is as low as noise makes it
    assert sunk(lying(height + np.linspace(0, 0.03, 300), noise=noise)) == 0


@pytest.mark.parametrize("factor", [1.5, 3.0, 10.0])
def test_depth_is_told_in_logs_of_what_needs_no_explanation(factor):
    assert sunk(lying(np.full(300, -factor * DEEP))) == pytest.approx(np.log(factor), rel=1e-6)


def test_noise_is_deducted():
    # 1.28 standard deviations below the mean lies a tenth of normal errors; 300 of them place that to a fifth of a deviation
    assert sunk(lying(np.full(300, -0.012), noise=0.003)) == pytest.approx(np.log(0.012 / DEEP), abs=0.1)


def test_few_strays_below_the_ground_say_nothing():
    assert sunk(lying(np.r_[np.full(25, -0.05), np.full(275, 0.01)])) == 0


def test_what_was_raised_onto_the_ground_tells_by_lying_there_exactly():
    # published recordings raise what was seen below; of a flat sheet with errors that is a half
    assert sunk(lying(np.r_[np.zeros(150), np.full(150, 0.002)])) == 0
    assert sunk(lying(np.r_[np.zeros(270), np.full(30, 0.002)])) == pytest.approx(2.0)


def test_without_a_ground_nothing_is_below_it():
    assert sunk(lying(np.full(50, -0.1), ground=False)) == 0
    assert not is_raised(lying(np.zeros(50), ground=False))


@pytest.mark.parametrize("heights, lower", [(np.r_[np.zeros(270), np.full(30, 0.002)], None), (np.full(300, -0.02), -0.021)])
def test_how_far_below_a_body_lay_is_not_known_where_it_was_raised(heights, lower):
    # what lay 20 mm below and was raised looks as what lay 1 mm below and was raised: no interval of the fit ends below
    knobs = [SimpleNamespace(name="ground_raise", decode=float), SimpleNamespace(name="ground_tilt_a", decode=float)]
    fit = SimpleNamespace(model=SimpleNamespace(knobs=knobs), z=np.array([-0.02, 0.0]), covariance=np.eye(2) * (0.001 / 1.645) ** 2)
    chosen = SimpleNamespace(found=SimpleNamespace(fit=fit), score=SimpleNamespace(hypothesis=SimpleNamespace(term=GroundPose, values={})))
    said = _parameters(chosen, SimpleNamespace(case=SimpleNamespace(recording=lying(heights))))
    assert said["ground_raise"]["interval90"] == [pytest.approx(lower) if lower else None, pytest.approx(-0.019)]
    assert said["ground_tilt_a"]["interval90"] == pytest.approx([-0.001, 0.001])
