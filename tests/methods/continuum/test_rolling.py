"""How a filmed rope's skin rolls: against rotations that are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Observed
from twinbench.methods.continuum.rolling import Rolling
from twinbench.methods.continuum.strands import Strands, embedded

RADIUS, LENGTH, COUNT, FRAMES = 0.005, 0.5, 400, 24
AXIS = np.linspace([0.0, 0.0, -0.3], [LENGTH, 0.0, -0.3], 33)


def skin():
    """(N, 3) m on a straight rope, in its upper half, as a camera sees it."""
    rng = np.random.default_rng(3)
    around = rng.uniform(-np.pi / 2, np.pi / 2, COUNT)
    along = rng.uniform(0.01, LENGTH - 0.01, COUNT)
    return np.stack([along, RADIUS * np.sin(around), -0.3 - RADIUS * np.cos(around)], 1)


def filmed(points, visible=None, controllers=None):
    hands = np.zeros((FRAMES, 0, 3)) if controllers is None else controllers
    return Observed(
        name="rope",
        points=points,
        visible=np.ones(points.shape[:2], bool) if visible is None else visible,
        motion_valid=np.zeros(points.shape[:2], bool),
        controllers=hands,
        surface=np.zeros((0, 3)),
        interior=np.zeros((0, 3)),
        colors=None,
        fps=30.0,
        gravity=np.array([0.0, 0.0, 9.81]),
        ground=None,
    )


def rolled(angle):
    """(T, N, 3) the skin rolled by ``angle`` (T, N) rad about the axis."""
    home, middle = skin(), np.array([0.0, 0.0, -0.3])
    off = (home - middle) * [0, 1, 1]
    turned = np.stack([Rotation.from_rotvec(np.outer(a, [1.0, 0, 0])).apply(off) for a in angle])
    return turned + middle + home * [1, 0, 0]


def followed(recording, path):
    chain = np.arange(len(AXIS))
    strands = Strands(AXIS, (chain,), np.linalg.norm(np.diff(AXIS, axis=0), axis=1))
    points = embedded(strands, recording.points[0], np.full(COUNT, -1))
    return points.followed(path, turning=True, rolling=Rolling.of(recording, AXIS))


STILL = np.broadcast_to(AXIS, (FRAMES, *AXIS.shape))


@pytest.mark.parametrize("most", [0.5, 3.0])
def test_a_skin_that_rolls_about_a_still_axis_is_followed(most):
    angle = np.linspace(0, most, FRAMES)[:, None] * np.ones(COUNT)
    truth = rolled(angle)
    noisy = truth + 5e-4 * np.random.default_rng(0).normal(size=truth.shape) * (np.arange(FRAMES) > 0)[:, None, None]
    # averages over some five frames lag at either end by 0.8 of their deviation, two frames; unrolled it is off by up to two radii
    lag = 2 * 0.8 * most / (FRAMES - 1)
    error = np.abs(followed(filmed(noisy), STILL) - truth)
    assert error.max() < (lag + 0.03) * RADIUS and np.sqrt(np.mean(error[6:-6] ** 2)) < 0.02 * RADIUS
    assert np.sqrt(np.mean((rolled(0 * angle) - truth) ** 2)) > 0.15 * RADIUS


def test_a_twist_along_the_rope_is_followed():
    angle = np.linspace(0, 1.0, FRAMES)[:, None] * (skin()[:, 0] / LENGTH)
    truth = rolled(angle)
    assert np.sqrt(np.mean((followed(filmed(truth), STILL) - truth) ** 2)) < 0.03 * RADIUS


def test_where_nobody_is_seen_it_turns_with_the_hand():
    """Hidden from frame 1 on: what the hand does is all that is known, and right where the hand alone rolls the rope."""
    angle = np.linspace(0, 1.5, FRAMES)[:, None] * np.ones(COUNT)
    hand = np.array([0.02, 0.0, -0.3]) + 0.02 * np.array([[0, 1, 0], [0, -1, 0.3], [0.1, 0.2, 1.0], [0, -0.2, -1.0]])
    off = hand - [0, 0, -0.3]
    hands = np.stack([Rotation.from_rotvec([a, 0, 0]).apply(off) + [0, 0, -0.3] for a in angle[:, 0]])
    truth, visible = rolled(angle), np.ones((FRAMES, COUNT), bool)
    visible[1:] = False
    found = followed(filmed(truth, visible, hands), STILL)
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.02 * RADIUS  # the hand's turns are smoothed over 0.2 s


def test_a_rope_that_nobody_rolls_goes_by_the_least_turns():
    """A straight rope that swings about one end in one plane, without hands: what a rigid body does."""
    turns = [Rotation.from_rotvec([0, a, 0]) for a in np.linspace(0, 1.0, FRAMES)]
    path, truth = (np.stack([turn.apply(points - AXIS[0]) + AXIS[0] for turn in turns]) for points in (AXIS, skin()))
    assert np.abs(followed(filmed(truth), path) - truth).max() < 0.02 * RADIUS


def test_after_the_frames_that_were_observed_the_last_roll_lasts():
    angle = np.minimum(np.linspace(0, 1.0, FRAMES), 0.5)[:, None] * np.ones(COUNT)
    truth = rolled(angle)
    found = followed(filmed(truth[:18]), STILL)
    assert np.sqrt(np.mean((found[18:] - truth[18:]) ** 2)) < 0.06 * RADIUS  # the average of the last frames, of which some rolled less


def test_a_hand_that_is_elsewhere_turns_nothing():
    off = np.array([0.02, 0.2, -0.3]) + 0.02 * np.array([[0, 1, 0], [0, -1, 0.3], [0.1, 0.2, 1.0], [0, -0.2, -1.0]])
    hands = np.stack([Rotation.from_rotvec([a, 0, 0]).apply(off - off.mean(0)) + off.mean(0) for a in np.linspace(0, 1.5, FRAMES)])
    truth, visible = rolled(np.zeros((FRAMES, COUNT))), np.ones((FRAMES, COUNT), bool)
    visible[1:] = False
    assert np.abs(followed(filmed(truth, visible, hands), STILL) - truth).max() < 1e-9  # slopes in frame 0 are exact to its ridge of 1e-9


def test_a_track_that_was_not_seen_in_frame_0_tells_nothing():
    truth = rolled(np.linspace(0, 1.0, FRAMES)[:, None] * np.ones(COUNT))
    visible = np.ones(truth.shape[:2], bool)
    visible[0, ::3] = False
    wrong = truth.copy()
    wrong[0, ::3] = [0.2, 0.003, -0.3]  # meaningless there, as rows that are not visible are
    one, other = (Rolling.of(filmed(points, visible), AXIS) for points in (truth, wrong))
    assert np.array_equal(one.seen, other.seen) and np.array_equal(one.weight, other.weight)


def test_points_without_correspondence_or_too_few_tell_nothing():
    recording = filmed(rolled(np.zeros((FRAMES, COUNT))))
    assert Rolling.of(replace(recording, correspond=False), AXIS) is None
    few = replace(
        recording, points=recording.points[:, :10], visible=recording.visible[:, :10], motion_valid=recording.motion_valid[:, :10]
    )
    assert Rolling.of(few, AXIS) is None
