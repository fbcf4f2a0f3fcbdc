"""Several twins under the same hands: time, hands that move, what is recorded, and what goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
from playing import springs
from twinbench import score
from twinbench.benchmark.conformance.scene import recording, truth
from twinbench.benchmark.playground.casting import stage_of
from twinbench.benchmark.playground.hands import Hand, hands_in, moved
from twinbench.benchmark.playground.replayed import Replayed
from twinbench.benchmark.playground.stage import SPEED, Player, Stage, Surroundings
from twinbench.datasets.phystwin import read_case
from twinbench.methods.base import Diverged, Trajectory
from twinbench.methods.rigid import RigidTwin
from twinbench.physics.terms import Wind

MADE = recording()


@pytest.fixture
def stage():
    return stage_of({"springs": springs(), "rigid": RigidTwin.of(MADE)}, MADE)


def positions(stage):
    return [player.live.positions.copy() for player in stage.players]


def test_a_recording_that_is_followed_is_the_roll_out_of_it(stage):
    stage.following = True
    for _ in range(MADE.frame_count - 1):
        stage.step()
    assert stage.at_end
    for player, twin in zip(stage.players, (springs(), RigidTwin.of(MADE)), strict=True):
        np.testing.assert_array_equal(player.live.positions, twin.rollout(MADE.controllers).positions[-1])


def test_going_back_and_on_again_repeats_to_the_last_bit(stage):
    stage.place(0, stage.hands[0].position + [0.02, 0, 0])
    seen = []
    for _ in range(6):
        stage.step()
        seen.append(positions(stage))
    assert stage.rewind(3) == 3 and stage.frame == 3
    np.testing.assert_array_equal(positions(stage), seen[2])
    for k in (3, 4, 5):
        stage.step()
        np.testing.assert_array_equal(positions(stage), seen[k])
    assert stage.rewind(100) == 6 and stage.frame == 0 and stage.rewind() == 0


def test_a_hand_comes_to_where_it_is_placed_no_faster_than_hands_are(stage):
    goal = stage.hands[0].position + np.array([0.3, 0.0, -0.1])
    stage.place(0, goal)
    told = [stage.told]
    for _ in range(30):
        stage.step()
        told.append(stage.told)
    speed = np.linalg.norm(np.diff(told, axis=0), axis=2).max() * MADE.fps
    assert speed <= SPEED * (1 + 1e-9)
    np.testing.assert_allclose(told[-1].mean(0), goal, atol=1e-12)
    np.testing.assert_allclose(told[-1] - told[-1].mean(0), told[0] - told[0].mean(0), atol=1e-12)  # rigid


def test_a_hand_turns_about_its_middle():
    # x' = m + R (x - m), R a quarter turn about z: (1, 0) goes to (0, 1)
    hand = Hand(np.array([0, 2]), np.array([[1.0, 0, 0], [-1.0, 0, 0]]), np.zeros(3), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    np.testing.assert_allclose(moved([hand], np.full((3, 3), 7.0)), [[0, 1, 0], [7, 7, 7], [0, -1, 0]], atol=1e-15)


def test_controllers_that_stay_together_are_one_hand():
    path = np.zeros((5, 4, 3))
    path[:, 2:, 0] = 0.5  # half a metre away from the first two
    assert [hand.members.tolist() for hand in hands_in(path)] == [[0, 1], [2, 3]]
    assert hands_in(np.zeros((5, 0, 3))) == ()


def test_what_was_recorded_can_be_scored_and_the_twin_that_was_seen_is_perfect_in_it(stage, tmp_path):
    stage.take()
    stage.place(0, stage.hands[0].position + [0.01, 0.01, -0.02])
    for _ in range(10):
        stage.step()
    written = stage.save(tmp_path / "played")
    assert (written.frame_count, written.name) == (11, "played")
    read_case(tmp_path / "played")
    twin = springs().retarget(written.initial())
    trajectory = springs().rollout(written.controllers)
    # the same engine along the same hands, from the same start: float32 on the disk of the published layout, and back
    np.testing.assert_allclose(trajectory.tracked, written.points, atol=1e-6)
    assert score("track_error" if written.tracks is not None else "chamfer", trajectory, written, range(1, 11)).mean < 1e-5
    assert np.isfinite(twin.rollout(written.controllers).positions).all()


def test_a_take_loses_what_is_gone_back_and_ends_with_a_new_start(stage):
    stage.take()
    for _ in range(4):
        stage.step()
    assert stage.taking == 5
    stage.rewind(2)
    assert stage.taking == 3
    stage.restart()
    assert stage.taking == 0


def test_nothing_is_written_that_is_no_recording(stage, tmp_path):
    with pytest.raises(ValueError, match="at least 4 frames, got 0: record first"):
        stage.save(tmp_path / "played")
    stage.take()
    for _ in range(4):
        stage.step()
    stage.players[0].fault = "springs stands still"
    with pytest.raises(ValueError, match="what failed cannot be recorded: springs stands still"):
        stage.save(tmp_path / "played")
    stage.players[0].fault = ""
    (tmp_path / "played").mkdir()
    (tmp_path / "played" / "mine").write_text("kept")
    with pytest.raises(ValueError, match="already exists"):
        stage.save(tmp_path / "played")
    assert [file.name for file in tmp_path.iterdir()] == ["played"] and (tmp_path / "played" / "mine").read_text() == "kept"


@pytest.mark.parametrize("error", [Diverged("the simulation blew up in frame 3", 3), ZeroDivisionError("division by zero")])
def test_a_twin_that_fails_stands_still_says_so_and_the_others_go_on(stage, error, monkeypatch):
    live = stage.players[0].live
    own, calls = live.step, []

    def step(controllers):
        calls.append(controllers)
        if len(calls) == 3:
            raise error
        own(controllers)

    monkeypatch.setattr(live, "step", step)
    for _ in range(5):
        stage.step()
    assert len(calls) == 3 and live.frame == 2 and stage.frame == 5
    assert stage.players[1].live.frame == 5 and not stage.players[1].fault
    assert f"springs stands still: {'' if isinstance(error, Diverged) else 'ZeroDivisionError: '}{error}" in stage.players[0].fault
    assert list(stage.faults) == [stage.players[0].fault]
    stage.rewind(4)
    assert not stage.players[0].fault and stage.frame == 1
    stage.step()
    assert live.frame == 2


def test_a_parameter_goes_to_all_twins_that_have_it_or_to_one():
    stage = stage_of({"one": springs(), "other": springs(), "rigid": RigidTwin.of(MADE)}, MADE)
    stage.change({"gravity": 3.0})
    stage.change({"stiffness": 2.0}, "other")
    one, other = (stage.players[k].live.parameters for k in (0, 1))
    assert one["gravity"].value == other["gravity"].value == 3.0
    assert (one["stiffness"].value, other["stiffness"].value) == (1.0, 2.0)
    stage.change({"gravity": -1.0})
    assert [said.split(":")[0] for said in stage.faults] == ["one", "other"] and one["gravity"].value == 3.0


def test_an_effect_parts_two_twins_and_they_are_one_again_without_it():
    windy = springs(added=(Wind({"wind_x": 3.0}),), ground=None)
    stage = stage_of({"without": springs(ground=None), "with": windy}, MADE)
    for _ in range(10):
        stage.step()
    without, blown = (player.live.positions for player in stage.players)
    assert (blown - without).mean(0)[0] > 1e-3 and stage.players[1].live.parameters["wind_x"].value == 3.0
    stage.restart()
    stage.change({"wind_x": 0.0})
    for _ in range(10):
        stage.step()
    without, blown = (player.live.positions for player in stage.players)
    np.testing.assert_allclose(blown, without, atol=1e-5)  # another kernel: float32 in another order


def test_a_residual_is_what_a_twin_is_off_and_none_of_the_truth():
    trajectory = Trajectory(truth().astype(np.float32), MADE.counts)
    around = Surroundings(MADE.gravity, MADE.ground, MADE.fps, MADE.grips)
    shifted = Trajectory(trajectory.positions + np.float32(0.5) * (np.arange(len(trajectory.positions)) > 0)[:, None, None], MADE.counts)
    players = [Player(name, Replayed(one, MADE.controllers, MADE.fps)) for name, one in (("truth", trajectory), ("off", shifted))]
    stage = Stage(players, around, MADE, following=True)
    stage.step()
    for player, far in zip(players, (0.0, 0.5 * np.sqrt(3)), strict=True):
        seen, there = stage.residual(player)
        assert len(seen) == MADE.visible[1].sum()
        np.testing.assert_allclose(np.linalg.norm(there - seen, axis=1), far, atol=1e-6)


def test_twins_with_other_controllers_are_refused():
    less = replace(MADE, controllers=MADE.controllers[:, :1], grips=MADE.grips[:1])
    with pytest.raises(ValueError, match="the same controllers"):
        stage_of({"springs": springs(), "fewer": springs(controllers=less.controllers, grips=less.grips)}, MADE)


@pytest.mark.parametrize("wrong", [[np.nan, 0, 0], [np.inf, 0, 0]])
def test_a_hand_is_not_placed_nowhere(stage, wrong):
    with pytest.raises(ValueError, match="finite numbers"):
        stage.place(0, wrong)
    stage.step()
    assert np.isfinite(stage.told).all()
