"""How a recording starts."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.datasets.scenario import Observed
from twinbench.methods.continuum.start import start_velocity, starts_at_rest


def cloud(speeds, *, count=200, noise=0.0, field=None, seed=0, fps=30.0):
    """A recording in which points go by ``speeds`` (F - 1,) [m/s] along ``field``, a function of places."""
    rng = np.random.default_rng(seed)
    home = rng.uniform(-0.1, 0.1, (count, 3))
    way = (lambda x: np.tile([1.0, 0, 0], (len(x), 1))) if field is None else field
    gone = np.concatenate([[0.0], np.cumsum(speeds)]) / fps
    points = home + gone[:, None, None] * way(home) + rng.normal(0, noise, (len(gone), count, 3))
    seen = np.ones(points.shape[:2], bool)
    valid = seen & (np.arange(len(gone)) < len(gone) - 1)[:, None]
    inner = rng.uniform(-0.1, 0.1, (20, 3))
    return Observed(
        name="cloud", points=points, visible=seen, motion_valid=valid, controllers=np.zeros((len(gone), 0, 3)), interior=inner, fps=fps
    )


@pytest.mark.parametrize(
    ("rest", "speeds"),
    [(True, [0.0] * 10), (True, [0.1 * (2 * k + 1) for k in range(10)]), (False, [0.3] * 10), (False, [0.3 - 0.02 * k for k in range(10)])],
    ids=["still", "sets off", "goes on", "slows down"],
)
def test_rest_is_told_from_motion(rest, speeds):
    start = starts_at_rest(cloud(speeds, noise=1e-3))
    assert start.rest == rest
    # noise of 1 mm in two frames, 12 numbers from 200 tracks: sqrt(2 * 12 / 200) * 30 mm/s = 10.4; third differences tell it to a fifth
    assert start.error == pytest.approx(0.0104, rel=0.2) and abs(start.speed - speeds[0]) < 4 * start.error


@pytest.mark.parametrize("hand", [0.0, 0.5, 3.0])
def test_what_is_let_go_did_not_lie_still(hand):
    # a fall: 3.3 mm to frame 1 and 13 to frame 2, where a hand, if there is one, moved by so many times as much
    fall = [0.1 * (2 * k + 1) for k in range(10)]
    gone = 0.1 / 30 * np.arange(11)[:, None, None] ** 2 * [hand, 0, 0]
    hands = dict(controllers=np.repeat(gone, 4, 1), grips=np.full(4, -1))
    made = replace(cloud(fall, noise=1e-3), **hands)
    assert starts_at_rest(made).rest and starts_at_rest(made).still == (hand > 1)
    assert starts_at_rest(replace(cloud([0.0] * 10, noise=1e-3), **hands)).still  # what a hand does not move yet


def test_too_few_frames_are_taken_for_a_rest():
    start = starts_at_rest(cloud([0.5]))
    assert start.rest and "rest is assumed" in start.words


def test_an_affine_velocity_is_found_everywhere():
    slope = np.array([[0.5, 2.0, 0.0], [-1.0, 0.3, 0.0], [0.0, 0.4, -0.7]])
    made = cloud([1.0, 1.0], field=lambda x: x @ slope.T + [0.1, 0, 0.2])
    np.testing.assert_allclose(start_velocity(made), made.structure @ slope.T + [0.1, 0, 0.2], atol=1e-9)


def test_noise_and_wrong_tracks_hardly_enter():
    made = cloud([0.3, 0.3], noise=1e-3, count=400)
    points = made.points.copy()
    points[1, :20] += 0.05  # 5 % that jump by 5 cm, 1.5 m/s in each axis
    found = start_velocity(replace(made, points=points))
    # 7.3 mm/s from noise (as above); the jumps would add 75 mm/s were they trusted
    assert np.sqrt(np.mean(np.sum((found - [0.3, 0, 0]) ** 2, axis=1))) < 0.03


def test_few_tracks_tell_a_rigid_field():
    made = cloud([1.0, 1.0], count=6, field=lambda x: np.cross([0.2, -1.0, 0.5], x) + [0, 0.1, 0])
    np.testing.assert_allclose(start_velocity(made), np.cross([0.2, -1.0, 0.5], made.structure) + [0, 0.1, 0], atol=1e-9)


def test_a_start_velocity_needs_two_frames():
    with pytest.raises(ValueError, match=r"two observed frames, got 1 \(scenario cloud\)"):
        start_velocity(cloud([]))
