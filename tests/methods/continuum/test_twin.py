"""The method on recordings that its own engine made: what is fitted comes back, batches are their runs, twins move with the room."""

from dataclasses import replace

import numpy as np
import pytest
from blocks import FRAMES, lifted
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.config import Config
from twinbench.methods.continuum.estimate import estimate, own_values
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.sights import Sight, jitter
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.solids import Solid
from twinbench.methods.continuum.twin import ContinuumTwin
from twinbench.physics.terms import AddedMass, HiddenObstacle

TRUE = dict(youngs_modulus=8e3, damping_time=0.01)


def scene_of(recording, pitch=0.02):
    return Scene.of(recording, Solid.told(recording, body_of(recording, kind="solid", pitch=pitch)))


@pytest.fixture(scope="module")
def truth():
    """(recording, scene) of a block of known stiffness and damping, lifted, its tracks off by 0.3 mm."""
    scene = scene_of(lifted())
    path = Simulator(scene).run([TRUE], FRAMES)[0][:, : scene.counts[0]]
    assert np.isfinite(path).all()
    return lifted(path + np.random.default_rng(0).normal(0, 3e-4, path.shape)), scene


def test_runs_of_a_batch_are_those_of_single_ones(truth):
    # each value has substeps of its own, so that a stiff run beside it changes nothing
    simulator = Simulator(truth[1])
    values = [TRUE, dict(youngs_modulus=5e4), dict(youngs_modulus=3e3, grip0_shift_x=0.004, grip0_reach=1.3)]
    together = simulator.run(values, 6)
    for one, path in zip(values, together, strict=True):
        np.testing.assert_array_equal(simulator.run([one], 6)[0], path)
    assert np.abs(together[0] - together[1]).max() > 1e-3 and np.abs(together[0] - together[2]).max() > 1e-3


@pytest.mark.long
def test_stiffness_and_damping_come_back(truth):
    # data by the twin's own engine and mesh: what is fitted is what made them, within four of the stated standard deviations and 10 %
    recording, scene = truth
    config = Config(starts=1, iterations=4, refinement=3, members=0, grips=False, coarse=1.0)
    found = estimate([recording], [scene], config, fixed=dict(poisson=0.3, drag_damping=0.3, coulomb_friction=0.4))
    assert found.values["youngs_modulus"] == pytest.approx(TRUE["youngs_modulus"], rel=0.1)
    sd = found.fit.sd["youngs_modulus"]
    assert abs(np.log(found.values["youngs_modulus"] / TRUE["youngs_modulus"])) < max(4 * sd, 0.03)
    assert found.values["damping_time"] == pytest.approx(TRUE["damping_time"], rel=0.4)


def test_the_noise_of_tracks_is_told_from_their_jitter(truth):
    # white noise of 0.3 mm on a body that stays where it is: var(a - 2 b + c) = 6 var
    still = np.repeat(truth[0].points[:1], 40, 0) + np.random.default_rng(1).normal(0, 3e-4, (40, *truth[0].points.shape[1:]))
    assert jitter(still, np.ones(still.shape[:2], bool)) == pytest.approx(3e-4, rel=0.1)
    assert Sight.of(truth[0], 5).points.shape[0] == 5


def test_a_twin_moves_with_the_room(truth):
    # everything turned about the vertical and shifted: the roll-out is the same one, turned and shifted (no direction is special)
    recording, scene = truth
    turn, shift = Rotation.from_rotvec([0, 0, 0.7]).as_matrix(), np.array([0.3, -0.2, 0.0])
    move = lambda x: x @ turn.T + shift  # noqa: E731
    moved = replace(
        recording, name="moved", points=move(recording.points), controllers=move(recording.controllers), interior=move(recording.interior)
    )
    twin = ContinuumTwin(scene, TRUE)
    there = twin.retarget(moved)
    assert "told by distance" in there.note  # nothing after frame 0 was looked at
    off = there.rollout(moved.controllers).positions - move(twin.rollout(recording.controllers).positions)
    assert np.abs(off).max() < 2e-3  # the body is laid by closest points of tracks that are 0.3 mm off


def test_a_hand_that_gives_way_is_as_stiff_in_another_recording(truth):
    # a spring of K N/m between hand and body is one whatever the hand holds of it: M w^2 = K, M = sum_i s_i m_i of the points held
    recording, scene = truth
    outward = np.sign(recording.controllers[0].mean(0) - scene.structure.mean(0)) * [0.01, 0, 0]
    there = replace(recording, controllers=recording.controllers + outward)  # it holds less of the block
    twin = ContinuumTwin(scene, TRUE | dict(grip_rate=60.0, grip0_reach=1.2))
    other = twin.retarget(there)

    def spring(one):
        shift, reach = one.simulator.grips(one.values)
        held = one.scene.firmness(shift, reach) @ one.scene.points.masses[one.scene.grasp.points]
        return held, held * one.values["grip_rate"] ** 2

    (here, stiffness), (elsewhere, same) = spring(twin), spring(other)
    assert abs(elsewhere / here - 1) > 0.02
    assert same == pytest.approx(stiffness, rel=1e-9)
    assert "grip_rate" not in ContinuumTwin(scene, TRUE).retarget(there).values  # firm unless said
    rate = {hand: ContinuumTwin(scene, twin.values | dict(grip_hand=hand)).retarget(there).values["grip_rate"] for hand in (0.0, 1.0)}
    assert rate == {0.0: pytest.approx(other.values["grip_rate"]), 1.0: 60.0}  # of a hand that is not here there is nothing to say


def test_a_run_that_blows_up_is_run_again_in_half_steps(truth, monkeypatch):
    # steps beyond what is stable blow up; half as long they are those of a run that had so many from the start, and others stay as they are
    simulator = Simulator(truth[1])
    values = simulator._complete(TRUE)
    substeps, rounds = simulator._steps(values)
    short = substeps // 4  # safe steps are half of what is stable: four times as long is twice too long
    monkeypatch.setattr(Simulator, "_steps", lambda self, v: (short if v["youngs_modulus"] == TRUE["youngs_modulus"] else substeps, rounds))
    soft = dict(TRUE, youngs_modulus=5e3)
    both = simulator.run([TRUE, soft], 6)
    assert np.isfinite(both).all()
    np.testing.assert_array_equal(both[1], simulator.run([soft], 6)[0])
    monkeypatch.setattr(Simulator, "_steps", lambda self, v: (2 * short, rounds))
    np.testing.assert_array_equal(both[0], simulator.run([TRUE], 6)[0])


def test_a_body_is_told_by_the_frame_0_in_which_it_is_placed():
    # the same block, one and a half millimetres longer in the other recording's cloud: its cells are that recording's own
    home, body = lifted(), Solid.told(lifted(), body_of(lifted(), kind="solid", pitch=0.02))
    longer = replace(home, points=home.points * [1.0125, 1, 1], interior=home.interior * [1.0125, 1, 1])
    told = body_of(longer, kind="solid", pitch=float(body.grid.size.mean()))
    assert not told.notes
    np.testing.assert_array_equal(body.laid(longer).grid.positions, told.grid.positions)
    moved = replace(home, points=home.points + 0.1, interior=home.interior + 0.1)
    laid = body.laid(moved).grid  # the same cloud: the same cells, moved rigidly (a block is one with itself turned over)
    np.testing.assert_array_equal(laid.volume, body.grid.volume)
    np.testing.assert_allclose(pdist(laid.positions), pdist(body.grid.positions), atol=1e-12)


def test_a_lattice_in_which_a_marker_is_elsewhere_has_the_same_cells():
    # three tracked points of a block are 3 mm aside, all others coincide after a turn: the same body, moved rigidly, though clouds differ
    home, body = lifted(), Solid.told(lifted(), body_of(lifted(), kind="solid", pitch=0.02))
    turn = Rotation.from_rotvec([0.1, 0.02, -0.3])
    points = home.points.copy()
    points[:, :3] += [0, 3e-3, 0]
    there = replace(home, points=turn.apply(points.reshape(-1, 3)).reshape(points.shape), interior=turn.apply(np.array(home.interior)))
    laid = body.laid(there).grid
    np.testing.assert_array_equal(laid.volume, body.grid.volume)
    np.testing.assert_allclose(laid.positions, turn.apply(np.array(body.grid.positions)), atol=1e-3)


def test_what_acts_at_a_place_on_the_body_goes_with_it_and_what_is_in_the_room_stays():
    home, told = lifted(), body_of(lifted(), kind="solid", pitch=0.02)
    weight = {f"added_mass_{a}": v for a, v in zip("xyz", (0.1, 0.02, 0.015), strict=True)}
    ball = {f"obstacle_{a}": v for a, v in zip("xyz", (0.0, 0.0, 0.2), strict=True)}
    twin = ContinuumTwin(Scene.of(home, Solid.told(home, told)), TRUE | weight | ball, (AddedMass(), HiddenObstacle()))
    turn, shift = Rotation.from_rotvec([0, 0, 0.5]), np.array([0.3, -0.1, 0.0])

    def moved(points):
        return turn.apply(np.array(points).reshape(-1, 3)).reshape(np.shape(points)) + shift

    there = replace(home, points=moved(home.points), interior=moved(home.interior), controllers=moved(home.controllers))
    values = twin.retarget(there).values
    expected = turn.apply([0.1, 0.02, 0.015]) + shift
    np.testing.assert_allclose([values[f"added_mass_{a}"] for a in "xyz"], expected, atol=1e-6)
    assert {name: values[name] for name in ball} == ball


def test_values_of_a_recording_are_those_of_its_own_hands():
    values = dict(youngs_modulus=1.0, rec0_grip0_reach=2.0, rec1_grip0_reach=3.0)
    assert own_values(values, 1) == dict(youngs_modulus=1.0, grip0_reach=3.0)


def test_controllers_of_another_shape_are_refused(truth):
    twin = ContinuumTwin(truth[1], TRUE)
    with pytest.raises(ValueError, match=r"controllers must have shape \(T, 12, 3\), got \(5, 3, 3\)"):
        twin.rollout(np.zeros((5, 3, 3)))
