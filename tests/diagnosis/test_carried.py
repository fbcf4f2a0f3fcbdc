"""What hands hold and how it goes with them: exact motions, whose strays are known."""

from dataclasses import replace

import numpy as np
import pytest
from carrying import FRAMES, held
from twinbench.diagnosis.carried import FEWEST, GONE, beside, stray_of

FLOOR = 1e-3


def test_what_is_carried_rigidly_does_not_stray():
    one = held().observed()
    (hand,) = beside(one)
    assert hand.own < 1e-6  # a turn of half a radian a second is smoothed by a quadratic over 0.2 s to a micrometre
    seen = np.isfinite(hand.gone)
    assert seen.any() and np.abs(hand.gone - hand.carried)[seen].max() < 1e-5
    assert (np.linalg.norm(hand.carried, axis=2)[seen.all(2)] >= GONE).all()
    assert stray_of(one, FLOOR) is not None and stray_of(one, FLOOR) < np.log(0.01)


@pytest.mark.parametrize("far", [0.004, 0.01])
def test_strays_are_told_in_the_hands_own_and_the_floor(far):
    # log(far / sqrt(own^2 + floor^2)): of exact hands, and of such whose points err by 2 mm in each of three components, whose motion is
    # known to some 2 mm at the tracks
    assert stray_of(held(strays=far).observed(), FLOOR) == pytest.approx(np.log(far / FLOOR), abs=0.01)
    rough = held(strays=far, noise=0.002).observed()
    (hand,) = beside(rough)
    assert hand.own == pytest.approx(0.002 * np.sqrt(3), rel=0.4)
    assert stray_of(rough, FLOOR) == pytest.approx(np.log(far / np.hypot(hand.own, FLOOR)), abs=0.2)


def test_the_hand_that_holds_worst_counts():
    one, two = (stray_of(held(strays=0.01, hands=hands).observed(), FLOOR) for hands in (1, 2))
    assert two == pytest.approx(one, abs=0.05)
    assert stray_of(held(soft=0.1).observed(), FLOOR) > np.log(3)  # 22 cm away it hangs 22 mm behind, and 2 where it set out


def test_tracks_that_do_not_tell_are_left_out():
    one = held(strays=0.01)
    few = replace(one, points=one.points[:, : FEWEST - 1], visible=one.visible[:, : FEWEST - 1], motion_valid=one.visible[:, : FEWEST - 1])
    point = replace(one, controllers=one.controllers[:, :1], grips=one.grips[:1])  # a hand whose turning is not told
    gone = one.visible.copy()
    gone[3:] = False
    lost = replace(one, visible=gone, motion_valid=gone)
    for other in (few, point, lost, held(strays=0.01, markers=True)):
        assert stray_of(other.observed(), FLOOR) is None
    hidden = one.visible.copy()
    hidden[:, ::2] = np.arange(FRAMES)[:, None] < 1  # every other track is seen in frame 0 alone: the others tell as before
    assert stray_of(replace(one, visible=hidden, motion_valid=hidden).observed(), FLOOR) == pytest.approx(
        stray_of(one.observed(), FLOOR), abs=0.05
    )


def test_frames_held_out_say_nothing():
    one = held(strays=0.002)
    later = one.points.copy()
    later[one.split.train_end :] += 0.1
    assert stray_of(replace(one, points=later).observed(), FLOOR) == stray_of(one.observed(), FLOOR)
