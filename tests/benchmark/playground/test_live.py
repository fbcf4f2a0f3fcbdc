"""Twins stepped frame by frame do what their roll-outs do; states can be kept and set again; parameters act as physics says."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from playing import springs
from twinbench.benchmark.conformance.checking import Skipped
from twinbench.benchmark.conformance.methods import Subject
from twinbench.benchmark.conformance.scene import recording
from twinbench.benchmark.playground.live import Rerolled, live_of
from twinbench.datasets.scenario import Plane
from twinbench.methods.base import Diverged
from twinbench.methods.gs_dynamics.windows import travel
from twinbench.methods.registry import methods
from twinbench.methods.rigid import RigidTwin

SUBJECTS = {name: Subject(found) for name, found in sorted(methods().items())}


@cache
def fitted(name):
    """The twin of the made recording; one that builds on another is fitted from there, as in a run."""
    below = methods()[name].builds_on
    return SUBJECTS[name].fit(MADE, start=fitted(below)) if below else SUBJECTS[name].fitted


MADE = recording()


def stepped(live, path):
    found = [live.positions]
    for controllers in path[1:]:
        live.step(controllers)
        found.append(live.positions)
    return np.stack(found)


@pytest.mark.long
@pytest.mark.parametrize("name", SUBJECTS)
def test_steps_along_a_path_are_the_roll_out_along_it_to_the_last_bit(name):
    try:
        twin = fitted(name)
    except Skipped as reason:
        pytest.skip(str(reason))
    path = MADE.controllers
    expected = twin.rollout(path).positions
    live = live_of(twin, path=path, fps=MADE.fps, known=True)
    assert live.positions.dtype == np.float32 and live.counts == MADE.counts and live.fps == MADE.fps
    found = stepped(live, path)
    if name.startswith("gs-dynamics"):  # between two steps it waits, where a roll-out draws a line to the later one
        steps, _states = twin._steps(path)
        assert travel(path, 0).max() > 0 and "straight lines" in live.note
        np.testing.assert_array_equal(found[steps], expected[steps])
    else:
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", SUBJECTS)
def test_a_state_that_is_set_again_goes_on_as_before(name):
    try:
        twin = fitted(name)
    except Skipped as reason:
        pytest.skip(str(reason))
    live = live_of(twin, path=MADE.controllers, fps=MADE.fps)
    stepped(live, MADE.controllers[:4])
    kept, positions = live.state, live.positions
    first = stepped(live, MADE.controllers[3:])
    live.state = kept
    assert live.frame == 3
    np.testing.assert_array_equal(live.positions, positions)
    np.testing.assert_array_equal(stepped(live, MADE.controllers[3:]), first)


def test_a_twin_that_does_not_say_where_its_hands_are_is_refused():
    with pytest.raises(ValueError, match="a RigidTwin does not say where its hands are: name its recording"):
        live_of(RigidTwin.of(MADE))


def test_a_twin_of_another_package_is_rolled_out_anew_and_may_bring_its_own_steps():
    class Own(RigidTwin):
        def live(self):
            return "its own"

    assert live_of(Own.of(MADE)) == "its own"

    class Summed(type(RigidTwin.of(MADE))):
        """Has a memory: the sum of all ways."""

        def rollout(self, controllers):
            found = super().rollout(controllers)
            return replace(found, positions=np.cumsum(found.positions, 0, dtype=np.float32))

    twin = Summed.of(MADE)
    found = stepped(Rerolled(twin, MADE.controllers, MADE.fps), MADE.controllers)
    np.testing.assert_array_equal(found, twin.rollout(MADE.controllers).positions)


def test_a_body_held_at_rest_is_pulled_up_by_its_weight():
    # m a = hands + m g: at rest the hands carry all of the weight, m 9.8 = 48 * 9.8 N (1 kg a particle)
    live = live_of(springs(ground=None))
    live.set({"drag_damping": 10.0})  # 1/s: what swings comes to rest
    for _ in range(300):
        live.step(live.controllers)
    forces = live.forces()
    moved = stepped(live, [live.controllers] * 3)
    assert np.abs(np.diff(moved, axis=0)).max() < 1e-5  # m a frame: at rest
    weight = live.mass.sum() * MADE.gravity
    np.testing.assert_allclose(forces.hands.sum(0), -weight, atol=0.01 * np.linalg.norm(weight))
    assert not len(forces.contact)


def test_a_body_that_lies_is_carried_by_the_ground():
    # sum of impulses over a frame / its time = weight, once it lies still; nothing holds it
    up = -MADE.gravity / np.linalg.norm(MADE.gravity)
    low = float((MADE.structure @ up).min())
    free = dict(controllers=np.zeros((len(MADE.controllers), 0, 3)), grips=np.zeros(0, int))
    live = live_of(springs(ground=Plane(up, low - 0.002), **free))
    for _ in range(150):
        live.step(np.zeros((0, 3)))
    total = []
    for _ in range(30):  # impacts come and go: their mean carries the weight
        live.step(np.zeros((0, 3)))
        total.append(live.forces().contact.sum(0))
    weight = live.mass.sum() * MADE.gravity
    np.testing.assert_allclose(np.mean(total, 0), -weight, atol=0.03 * np.linalg.norm(weight))


def test_without_gravity_nothing_falls_and_twice_as_much_falls_twice_as_far():
    free = dict(controllers=np.zeros((len(MADE.controllers), 0, 3)), grips=np.zeros(0, int), ground=None)
    fell = {}
    for strength in (0.0, 5.0, 10.0):
        live = live_of(springs(**free))
        live.set({"gravity": strength, "drag_damping": 0.0})
        before = live.positions.mean(0)
        stepped(live, np.zeros((7, 0, 3)))
        fell[strength] = float((live.positions.mean(0) - before) @ MADE.gravity / np.linalg.norm(MADE.gravity))
    # x = g t^2 / 2 with t = 6 frames of 1/30 s, first order in the substep: half a substep of t more
    assert abs(fell[0.0]) < 1e-6
    np.testing.assert_allclose([fell[5.0], fell[10.0]], [0.5 * g * 0.2**2 for g in (5.0, 10.0)], rtol=2 / (6 * live.substeps) + 1e-3)


def test_a_parameter_may_change_between_two_frames_without_a_jump():
    live = live_of(springs(ground=None))
    stepped(live, [live.controllers] * 10)
    before, frame = live.positions, live.frame
    live.set({"stiffness": 4.0})
    np.testing.assert_array_equal(live.positions, before)
    assert live.frame == frame and live.parameters["stiffness"].value == 4.0 and live.substeps >= 1
    live.step(live.controllers)
    assert 0 < np.abs(live.positions - before).max() < 0.05


@pytest.mark.parametrize(("name", "said"), [("gravty", "did you mean 'gravity'"), ("gravity", r"gravity must lie in \[0, 30\]")])
def test_what_no_parameter_may_be_is_refused(name, said):
    with pytest.raises(ValueError, match=said):
        live_of(springs()).set({name: -1.0})


def test_a_hand_that_is_nowhere_diverges_and_changes_nothing():
    live = live_of(springs(ground=None))
    live.step(live.controllers)
    kept, positions = live.state, live.positions
    with pytest.raises(Diverged, match="blew up in frame 2"):
        live.step(live.controllers + 1e12)
    np.testing.assert_array_equal(live.positions, positions)
    assert live.frame == 1 and live.state[0] is kept[0]
    live.step(live.controllers)
