"""A hand that the recording does not list: where it may be, the recording in which it is told, and how it is weighed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from blocks import FRAMES, lifted, recorded
from scipy.special import softmax
from twinbench.datasets.scenario import Split
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.effects.grips import HOLD
from twinbench.diagnosis.holding import Hold, _chances, explains, listed, places
from twinbench.diagnosis.inference.blocks import Blocks
from twinbench.diagnosis.page.words import EFFECTS
from twinbench.methods.base import Diverged
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.hands import FINGER, HAND
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.solids import Solid
from twinbench.methods.continuum.twin import ContinuumTwin

CONFIG = DiagnosisConfig(regions=6, times=3, held_out=1, fewest=3)
VALUES = dict(youngs_modulus=8e3, damping_time=0.01, poisson=0.3, drag_damping=0.3)


@pytest.fixture(scope="module")
def twin():
    told = lifted()
    return ContinuumTwin(Scene.of(told, Solid.told(told, body_of(told, kind="solid", pitch=0.02))), VALUES)


@pytest.fixture(scope="module")
def block(twin):
    path = twin.rollout(twin.scene.controllers).tracked
    return recorded(np.asarray(path, float), name="block", split=Split(12, FRAMES))


def test_places_are_tracks_together_and_not_where_a_hand_is(block):
    blocks = Blocks.of(block, CONFIG)
    found = places(block, blocks, CONFIG)
    assert found
    for one in found:
        middle = blocks.regions[one.labels[0]]
        assert len(one.tracks) >= CONFIG.fewest and (blocks.label[one.tracks] == one.labels[0]).all()
        assert np.linalg.norm(block.points[0, one.tracks] - middle, axis=1).max() < FINGER
        assert np.linalg.norm(block.controllers[0] - middle, axis=1).min() > HAND
    hidden = block.visible.copy()
    hidden[3:12, found[0].tracks] = False  # seen in a quarter of the train frames
    seen = replace(block, visible=hidden, motion_valid=hidden & block.motion_valid)
    assert not any(np.isin(found[0].tracks, one.tracks).any() for one in places(seen, blocks, CONFIG))


def test_what_is_listed_is_what_was_seen_and_straight_between(block):
    one = places(block, Blocks.of(block, CONFIG), CONFIG)[0]
    hidden = block.visible.copy()
    hidden[5, one.tracks[0]] = False
    told = listed(replace(block, visible=hidden, motion_valid=hidden & block.motion_valid), one, markers=False)
    count = block.controllers.shape[1]
    assert np.array_equal(told.controllers[:, :count], block.controllers) and (told.grips[count:] == -1).all()
    seen = np.arange(FRAMES) != 5
    assert np.array_equal(told.controllers[seen][:, count:], block.points[seen][:, one.tracks])
    between = (block.points[4, one.tracks[0]] + block.points[6, one.tracks[0]]) / 2
    np.testing.assert_allclose(told.controllers[5, count], between, atol=1e-12)


def test_a_twin_moves_what_its_recording_does_not_list_itself(twin, block, tmp_path):
    one = places(block, Blocks.of(block, CONFIG), CONFIG)[0]
    told = listed(block, one, markers=False)
    whole = replace(twin, scene=Scene.of(told, twin.scene.body))
    part = replace(whole, unlisted=len(one.tracks))
    assert np.array_equal(part.controllers, block.controllers)
    expected = whole.rollout(told.controllers).tracked
    np.testing.assert_array_equal(part.rollout(block.controllers).tracked, expected)
    assert not np.allclose(expected, twin.rollout(block.controllers).tracked, atol=1e-4)
    with pytest.raises(ValueError, match=rf"controllers must have shape \(T, {block.controllers.shape[1]}, 3\)"):
        part.rollout(told.controllers)
    longer = np.concatenate([block.controllers, block.controllers[-1:]])
    stays = np.concatenate([told.controllers, told.controllers[-1:]])
    several = [np.asarray(found.tracked) for found in part.rollouts(np.stack([longer, longer])) if not isinstance(found, Diverged)]
    np.testing.assert_array_equal(several, np.repeat(np.asarray(whole.rollout(stays).tracked)[None], 2, 0))
    part.save(tmp_path)
    again = ContinuumTwin.load(tmp_path)
    assert again.unlisted == part.unlisted
    np.testing.assert_array_equal(again.rollout(block.controllers).tracked, expected)
    elsewhere = part.retarget(block.initial())  # where nobody says what is held
    assert elsewhere.unlisted == 0 and elsewhere.scene.controllers.shape == block.controllers.shape


def hold(nats, p=0.5):
    return Hold(np.array([1, 2]), np.zeros(3), None, SimpleNamespace(p=p), nats, None, np.zeros(0))


def test_chances_are_those_of_one_more_candidate():
    # by Bayes, with equal odds before for effects and for candidates of one: evidence of a tether is the mean of its two candidates'
    logs = {"wind": 12.0, "hidden_tether": 9.0, "creep": 2.0}
    shares = dict(zip(logs, softmax(list(logs.values())), strict=True))
    named = [SimpleNamespace(name="wind", log_evidence=logs["wind"], probability=shares["wind"])]
    found = _chances(hold(11.0), SimpleNamespace(probabilities=shares, named=named))
    tether = np.log((np.exp(9.0) + np.exp(11.0)) / 2)
    expected = softmax([12.0, tether, 2.0])
    assert list(found) == ["wind", "hidden_tether", "creep"] and list(found.values()) == pytest.approx(expected)
    test = SimpleNamespace(scores=[SimpleNamespace(log_evidence=v) for v in logs.values()])
    found = _chances(hold(40.0), SimpleNamespace(probabilities=shares, named=[], test=test))  # by linear evidence, without refits
    assert next(iter(found)) == "hidden_tether" and sum(found.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(("nats", "p", "said"), [(80.0, 0.5, True), (80.0, 0.01, False), (20.0, 0.5, False), (5.0, 0.5, False)])
def test_refits_are_left_out_where_a_hold_says_all(nats, p, said):
    test = SimpleNamespace(scores=[SimpleNamespace(log_evidence=10.0)])
    assert explains(hold(nats, p), test, CONFIG) is said


def test_a_hold_has_the_words_of_a_tether():
    assert HOLD.name in EFFECTS and not HOLD.amounts and HOLD.place == "hold"
