"""What hands hold and how it goes with them: exact motions, whose strays are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Scenario, Split
from twinbench.diagnosis.inference.carried import FEWEST, GONE, beside, stray_of

FRAMES, FLOOR = 40, 1e-3


def held(seed=0, *, strays=0.0, noise=0.0, soft=0.0, hands=1, markers=False) -> Scenario:
    """A cloud of 40 tracks in each of some hands of ten points, 30 cm apart, that lift and turn; the hands' own points err by ``noise`` [m]
    all the time, tracks of the last hand stray by ``strays`` [m] from frame 1 on, and sag by ``soft`` [m] for each metre that it went."""
    random = np.random.default_rng(seed)
    time = np.linspace(0, 1, FRAMES)
    turn = Rotation.from_rotvec(np.outer(time, [0.2, 0.3, 0.4])).as_matrix()
    way = np.outer(time**2, [0.1, 0.0, 0.2])
    points, controllers = [], []
    for k in range(hands):
        middle = np.array([0.3 * k, 0.0, 0.1])
        fist, cloud = (random.uniform(-0.01, 0.01, (n, 3)) for n in (10, 40))
        fist, cloud = (np.einsum("tij,nj->tni", turn, part) + middle + way[:, None] for part in (fist, cloud))
        if k == hands - 1:
            aside = random.normal(size=cloud.shape[1:])
            cloud[1:] += strays * aside / np.linalg.norm(aside, axis=1, keepdims=True)
            cloud[..., 2] -= soft * np.linalg.norm(way, axis=1)[:, None]
        points.append(cloud)
        controllers.append(fist + noise * random.normal(size=fist.shape))
    points, controllers = np.concatenate(points, 1), np.concatenate(controllers, 1)
    visible = np.ones(points.shape[:2], bool)
    if markers:
        points = np.concatenate([points, controllers], 1)
        visible = np.ones(points.shape[:2], bool)
    grips = points.shape[1] - controllers.shape[1] + np.arange(controllers.shape[1]) if markers else None
    about = dict(name="held", points=points, visible=visible, motion_valid=visible, controllers=controllers, fps=30.0)
    return Scenario(**about, split=Split(FRAMES - 10, FRAMES), **({} if grips is None else dict(grips=grips)))


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
