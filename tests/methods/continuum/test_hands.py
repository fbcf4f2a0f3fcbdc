"""Hands: their controllers, how they move, and what they hold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Observed
from twinbench.methods.continuum.hands import bar_of, frames_of, groups_of, hands_of
from twinbench.methods.continuum.held import falloff

GRASP = 0.01 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0.5]])
NOTHING = np.zeros((0, 3))


def motion(frames=20):
    """(T, 3, 3) and (T, 3) m: a hand that rises by 20 cm and turns by a radian."""
    share = np.linspace(0, 1, frames)
    return Rotation.from_rotvec(share[:, None] * [0.3, 0.8, 0.5]).as_matrix(), share[:, None] * [0.05, 0.0, 0.2]


def moved(points, turn, shift):
    return np.einsum("tij,nj->tni", turn, points) + shift[:, None]


def row(*, held=0.025, frames=20, offset=0.0, interior=NOTHING, seed=0, **given):
    """A row of tracks from the hand on: those within ``held`` [m] go with it, the others stay; noise of 0.3 mm."""
    turn, shift = motion(frames)
    home = np.stack([np.arange(0, 0.12, 0.005), np.full(24, 0.005), np.full(24, 0.012)], 1) + [offset, 0, 0]
    points = np.where((home[:, 0] - offset < held)[:, None], moved(home, turn, shift), home)
    points = points + np.random.default_rng(seed).normal(0, 3e-4, points.shape)
    seen = np.ones(points.shape[:2], bool)
    return Observed(
        **dict(
            name="row",
            points=points,
            visible=seen,
            motion_valid=seen & (np.arange(frames) < frames - 1)[:, None],
            controllers=moved(GRASP, turn, shift),
            interior=interior,
        )
        | given
    )


def test_firmness_falls_smoothly():
    # 1 up to half the radius, a half at it, 0 from one and a half on; 3 s^2 - 2 s^3 at s = 3 / 4 in between
    np.testing.assert_allclose(falloff([0, 0.01, 0.015, 0.02, 0.03, 0.05], 0.02), [1, 1, 27 / 32, 0.5, 0, 0], atol=1e-12)


def test_hands_that_start_beside_each_other_and_part_are_two():
    turn, shift = motion()
    together = np.concatenate([moved(GRASP, turn, shift), moved(GRASP + [0.03, 0, 0], turn, -shift)], axis=1)
    assert [g.tolist() for g in groups_of(together)] == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]
    assert [g.tolist() for g in groups_of(together[:1])] == [list(range(10))]


def test_controllers_in_a_long_row_are_a_bar():
    rng = np.random.default_rng(0)
    way, off = np.array([0.6, 0.8, 0.0]), np.array([0.3, 0.1, 0.2])
    points = off + np.linspace(-0.15, 0.15, 16)[:, None] * way + 0.01 * np.array([0.8, -0.6, 0]) * np.tile([1, -1], 8)[:, None]
    places = bar_of(points + rng.normal(0, 5e-4, points.shape))
    # its middle line: zigzag points 1 cm off it cancel but for how unevenly they lie, 1 cm / 16 at the ends
    assert np.linalg.norm(places[[0, -1]] - (off + np.array([[-0.15], [0.15]]) * way), axis=1) == pytest.approx([0, 0], abs=3e-3)
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() <= 0.01
    assert bar_of(0.03 * rng.normal(size=(20, 3))) is None and bar_of(points[:2]) is None and bar_of(0.3 * points) is None


def test_a_hand_has_the_frame_that_it_was_moved_by():
    turn, shift = motion()
    rotation, centre, told = frames_of(moved(GRASP, turn, shift))
    np.testing.assert_allclose(rotation, turn, atol=1e-9)
    np.testing.assert_allclose(centre, np.einsum("tij,j->ti", turn, centre[0] - shift[0]) + shift, atol=1e-9)
    assert told == "all"


def test_one_wrong_controller_hardly_turns_a_hand():
    turn, shift = motion()
    points = moved(np.concatenate([GRASP, 0.02 - GRASP]), turn, shift)
    points[5:, 3] += [0.0, 0.02, 0.0]
    rotation = frames_of(points)[0]
    # with equal weights one of ten points 2 cm off turns hands of 1 cm by some 0.2 rad
    assert np.abs(np.swapaxes(turn, 1, 2) @ rotation - np.eye(3)).max() < 0.03


def test_two_controllers_tell_all_but_the_turn_about_their_line_and_one_tells_none():
    about = Rotation.from_rotvec(np.linspace(0, 1, 9)[:, None] * [0, 0, 1.5]).as_matrix()
    rotation, _, told = frames_of(moved(np.array([[0.0, 0, 0], [0.02, 0, 0]]), about, np.zeros((9, 3))))
    np.testing.assert_allclose(rotation, about, atol=1e-9)  # across the line the least turn is the turn
    assert told == "line"
    rotation, centre, told = frames_of(moved(np.zeros((1, 3)), *motion(9)))
    assert told == "point" and (rotation == np.eye(3)).all()
    np.testing.assert_allclose(centre, motion(9)[1])


def test_a_hand_holds_what_moves_with_it():
    (hand,) = hands_of(row(), radius=0.03)
    assert hand.turns == "all" and not hand.notes
    firm = np.zeros(24)
    firm[hand.points] = hand.firmness
    assert (firm[:4] > 0.8).all() and firm[4] > 0.6  # to 2 cm, where half of the neighbours stay behind
    assert firm[5:].max() < 0.2  # what stays behind is not held, though it is as near as 1.5 radii
    carried = hand.carried(row().points[0])
    assert np.linalg.norm(carried[:, :5] - row().points[:, :5], axis=-1).max() < 0.003  # 4 deviations of twice 0.3 mm in 3 axes


def test_points_that_were_not_tracked_are_held_as_their_neighbours_are():
    inner = np.array([[0.01, 0.005, 0.006], [0.035, 0.005, 0.008]])
    (hand,) = hands_of(row(interior=inner), radius=0.03)
    firm = np.zeros(26)
    firm[hand.points] = hand.firmness
    assert firm[24] > 0.8 and firm[25] < 0.2


def test_one_frame_tells_by_distance_alone():
    (hand,) = hands_of(_first(row()), radius=0.02)
    assert "by distance alone" in hand.notes[0] and hand.points.max() < 12


def _first(made):
    return replace(made, points=made.points[:1], visible=made.visible[:1], motion_valid=made.motion_valid[:1])


def test_driven_markers_hold_their_points_and_no_other():
    made = row()
    driven = replace(made, controllers=np.stack([made.points[:, 0], made.points[:, 4]], 1), grips=np.array([0, 4]))
    (hand,) = hands_of(driven)
    assert hand.points.tolist() == [0, 4] and hand.firmness.tolist() == [1, 1] and hand.turns == "line"


def test_a_hand_that_holds_nothing_is_named_with_its_distance():
    with pytest.raises(ValueError, match=r"hand 0 \(controllers 0, 1, 2, 3, 4\) holds nothing: the nearest point .* mm away .*row"):
        hands_of(row(held=0.0))
    with pytest.raises(ValueError, match="radius must be > 0"):
        hands_of(row(), radius=0.0)


def test_a_hand_that_never_comes_near_is_noted():
    (hand,) = hands_of(row(offset=0.5, held=0.0))
    assert not len(hand.points) and "never comes nearer" in hand.notes[0]
