"""Bad input of a system or a batch: one ValueError each, that names the field, the rule and the value."""

import re
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import warp as wp
from twinbench.physics.batch import Batch, Inputs
from twinbench.physics.parameters import Parameter
from twinbench.physics.points import Points
from twinbench.physics.system import System
from twinbench.physics.terms import ControllerSprings, Dashpot, Gravity, Ground, SelfCollision, Springs
from twinbench.physics.terms.base import Term
from twinbench.physics.terms.stages import BodyTerm, ContactTerm, MoveTerm

COUNT, EDGES = 4, 4  # a chain of four particles; its last spring leads to controller 1, node 5


def good(**changes):
    """Arguments of a system in order."""
    points = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]])
    given = dict(
        positions=points,
        velocities=np.zeros((COUNT, 3)),
        masses=np.ones(COUNT),
        springs=np.array([[0, 1], [1, 2], [2, 3], [5, 3]]),
        rest=np.full(EDGES, 0.1),
        stiffness=np.full(EDGES, 10.0),
        controllers=np.broadcast_to([[0.0, 0, 0], [0.4, 0, 0]], (3, 2, 3)),
        grips=np.array([0, -1]),
        terms=(Springs(), Dashpot(), ControllerSprings()),
    )
    return {**given, **changes}


def put(name, where, value):
    """The good array called ``name`` with one entry changed."""
    array = np.array(good()[name], float)
    array[where] = value
    return {name: array}


def refused(text, **given):
    """The system is refused in these words."""
    with pytest.raises(ValueError, match=re.escape(text)):
        System(**good(**given))


def test_a_good_system_owns_read_only_copies():
    given = good()
    system = System(**given)
    for name in ("positions", "velocities", "masses", "springs", "rest", "stiffness", "controllers", "grips"):
        own = getattr(system, name)
        np.testing.assert_array_equal(own, given[name])
        assert not own.flags.writeable and not np.shares_memory(own, given[name])
        assert own.dtype == (np.int64 if name in ("springs", "grips") else np.float64)


def test_what_is_not_given_has_the_stated_default():
    system = System(**good(velocities=None, masses=None, rest=None, grips=None))
    np.testing.assert_array_equal(system.velocities, 0)
    np.testing.assert_array_equal(system.masses, 1)
    np.testing.assert_array_equal(system.grips, [-1, -1])
    np.testing.assert_allclose(system.rest, 0.1, rtol=1e-15)  # the start's distances, to controller 1 too: 0.4 - 0.3


def test_whole_numbers_may_come_as_floats():
    system = System(**good(springs=good()["springs"].astype(float), grips=[0.0, -1.0]))
    np.testing.assert_array_equal(system.springs, good()["springs"])


@pytest.mark.parametrize(
    ("text", "given"),
    [
        ("positions must have shape (M, 3), got (4, 2)", dict(positions=np.zeros((4, 2)))),
        ("positions must have shape (M, 3), got (3,)", dict(positions=np.zeros(3))),
        ("positions must have shape (M, 3), got ()", dict(positions=1.0)),
        ("positions must hold at least one particle", dict(positions=np.zeros((0, 3)))),
        ("positions must be an array of shape (M, 3), got rows of different lengths", dict(positions=[[0, 0, 0], [0, 0]])),
        ("positions must hold real numbers, got str", dict(positions=[["a", "b", "c"]])),
        ("positions must hold real numbers, got complex", dict(positions=np.zeros((4, 3), complex))),
        ("positions must hold real numbers, got object [None]", dict(positions=None)),
        ("velocities must have shape (4, 3), got (3, 3)", dict(velocities=np.zeros((3, 3)))),
        ("velocities must have shape (4, 3), got (3,)", dict(velocities=np.zeros(3))),
        ("masses must have shape (4,), got (5,)", dict(masses=np.ones(5))),
        ("masses must have shape (4,), got ()", dict(masses=1.0)),
        ("springs must have shape (E, 2), got (4, 3)", dict(springs=np.zeros((4, 3), int))),
        ("springs must have shape (E, 2), got (0,)", dict(springs=[])),
        ("rest must have shape (4,), got (3,)", dict(rest=np.ones(3))),
        ("stiffness must have shape (4,), got ()", dict(stiffness=10.0)),
        ("stiffness must hold real numbers, got object [None]", dict(stiffness=None)),
        ("controllers must have shape (T, C, 3), got (2, 3)", dict(controllers=np.zeros((2, 3)))),
        ("controllers must have shape (T, C, 3), got (0,)", dict(controllers=[])),
        ("controllers must have shape (T, C, 3), got (5, 2, 2)", dict(controllers=np.zeros((5, 2, 2)))),
        ("controllers must have at least one frame, got shape (0, 2, 3)", dict(controllers=np.zeros((0, 2, 3)))),
        ("grips must have shape (2,), got (1,)", dict(grips=[0])),
    ],
)
def test_shapes(text, given):
    refused(text, **given)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["positions", "velocities", "masses", "rest", "stiffness", "controllers"])
def test_numbers_are_finite(name, value):
    changed = put(name, -1, value)
    first = [int(k) for k in np.argwhere(~np.isfinite(changed[name]))[0]]
    refused(f"{name} must be finite, got {value} at {first}", **changed)


@pytest.mark.parametrize("value", [0.5, np.nan, np.inf])
@pytest.mark.parametrize(("name", "where"), [("springs", (2, 1)), ("grips", (1,))])
def test_indices_are_whole_numbers(name, where, value):
    refused(f"{name} must be whole numbers, got {value} at {list(where)}", **put(name, where, value))


@pytest.mark.parametrize(
    ("text", "given"),
    [
        ("masses must be > 0 [kg], got 0.0 at particle 2", put("masses", 2, 0)),
        ("masses must be > 0 [kg], got -1.0 at particle 3", put("masses", 3, -1)),
        ("spring rest length must be > 0 [m], got 0.0 at spring 1, [1, 2]", put("rest", 1, 0)),
        ("spring rest length must be > 0 [m], got -0.1 at spring 3, [5, 3]", put("rest", 3, -0.1)),
        ("spring stiffness must be >= 0 [N], got -3.0 at spring 2", put("stiffness", 2, -3)),
        ("springs must tie nodes 0 to 3 for particles or 4 to 5 for controllers, got [5, 6] at spring 3", put("springs", (3, 1), 6)),
        ("springs must tie nodes 0 to 3 for particles or 4 to 5 for controllers, got [-1, 1] at spring 0", put("springs", (0, 0), -1)),
        ("springs must tie two different nodes, got [2, 2] at spring 1", put("springs", (1, 0), 2)),
        ("grips must be -1 or one of the 4 particles, got 4 at controller 1", dict(grips=[0, 4])),
        ("grips must be -1 or one of the 4 particles, got -2 at controller 0", dict(grips=[-2, 1])),
        ("grips must hold a particle once, got 2 controllers that grip particle 3", dict(grips=[3, 3])),
    ],
)
def test_values(text, given):
    refused(text, **given)


ROPE = dict(hinges=[[0, 1, 2], [1, 2, 3]], chains=[[0, 1, 2, 3]])


def test_hinges_have_the_stated_defaults():
    system = System(**good(**ROPE))
    np.testing.assert_array_equal(system.natural, np.zeros((2, 2)))
    np.testing.assert_array_equal(system.flexure, 1)
    np.testing.assert_allclose(system.span, 0.1, rtol=1e-15)
    assert System(**good()).hinges.shape == (0, 3) and System(**good()).chains == ()
    # through controller 0, which grips particle 0, and to controller 1 at 0.4: the lengths of two segments each
    np.testing.assert_allclose(System(**good(hinges=[[4, 1, 3], [1, 2, 5]])).span, [0.15, 0.15], rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "given"),
    [
        ("hinges must have shape (H, 3), got (2, 2)", dict(hinges=[[0, 1], [1, 2]])),
        ("hinges must be whole numbers, got 0.5 at [0, 1]", dict(hinges=[[0, 0.5, 2]])),
        (
            "hinges must join nodes 0 to 3 for particles or 4 to 5 for controllers, got [1, 2, 6] at hinge 1",
            dict(hinges=[[0, 1, 2], [1, 2, 6]]),
        ),
        ("hinges must join three different nodes, got [1, 2, 1] at hinge 0", dict(hinges=[[1, 2, 1]])),
        ("hinges must join three different nodes, got [0, 1, 4] at hinge 0", dict(hinges=[[0, 1, 4]])),  # 4 grips 0
        ("hinges must each be listed once, got [0, 1, 2] at hinge 0 and again", dict(hinges=[[0, 1, 2], [2, 1, 0]])),
        ("hinges must run the way of their chain, got [3, 2, 1] at hinge 1", {**ROPE, "hinges": [[0, 1, 2], [3, 2, 1]]}),
        ("natural must have shape (2, 2), got (2,)", {**ROPE, "natural": [0.1, 0.2]}),
        ("natural must be finite, got nan at [1, 0]", {**ROPE, "natural": [[0, 0], [np.nan, 0]]}),
        ("hinge span must be > 0 [m], got 0.0 at hinge 1, [1, 2, 3]", {**ROPE, "span": [0.1, 0.0]}),
        ("hinge flexure must be >= 0, got -1.0 at hinge 0, [0, 1, 2]", {**ROPE, "flexure": [-1.0, 1.0]}),
        ("chains must be a list of arrays of nodes, got ndarray", dict(chains=np.array([0, 1]))),
        ("chains[0] must have shape (N,), got ()", dict(chains=[0, 1])),
        ("a chain must have at least 2 nodes, got 1 in chain 1", dict(chains=[[0, 1], [2]])),
        ("chains must hold nodes 0 to 3 for particles or 4 to 5 for controllers, got 9 in chain 0", dict(chains=[[0, 9]])),
        ("chains must not stay at a node, got [1, 1] again in chain 0", dict(chains=[[0, 1, 1]])),
        ("chains must walk each segment once, got [2, 1] again in chain 1", dict(chains=[[0, 1, 2], [2, 1]])),
    ],
)
def test_hinges_and_chains(text, given):
    refused(text, **given)


def test_springs_know_when_there_are_no_controllers():
    given = dict(controllers=np.zeros((1, 0, 3)), grips=None)
    refused("springs must tie nodes 0 to 3 for particles, got [5, 3] at spring 3", **given)


def test_a_grip_does_not_tie_a_particle_to_itself():
    # node 5 is controller 1, which holds particle 3: the spring between them would have both ends on one node
    refused("got [5, 3] at spring 3: one node through its grip", grips=[-1, 3])


def test_coinciding_particles_have_no_rest_length():
    # the start's distance is the default, and it is zero
    refused("spring rest length must be > 0 [m], got 0.0 at spring 0, [0, 1]", rest=None, **put("positions", 1, [0.0, 0, 0]))


def test_messages_name_the_system():
    refused("spring stiffness must be >= 0 [N], got -3.0 at spring 2 (system rope_push_02)", name="rope_push_02", **put("stiffness", 2, -3))
    refused("got the class Springs: write Springs() (system rope_push_02)", name="rope_push_02", terms=[Springs])


# ---------------------------------------------------------------- terms


@wp.func
def pull_along_x(x: Any, v: Any, m: Any, p: Any, o: int):
    f = type(x)()
    f[0] = p[o]
    return f


class Wind(BodyTerm):
    """A term whose parameter is called like another's."""

    name = "wind"
    parameters = (Parameter("gravity_x", 1.0, 0.0, 2.0, "N", "a name that gravity has already"),)
    law = pull_along_x
    twin = staticmethod(lambda x, v, home, m, gravity_x: np.array([gravity_x, 0.0, 0.0]))


class Misplaced(Term):
    name = "misplaced"
    stage = "bodi"


class Bounce(MoveTerm):
    """A second term that wants to move particles, or to be the contact."""

    name = "bounce"
    twin = staticmethod(lambda x, v, dt: (x, v))


class Touch(ContactTerm):
    name = "touch"
    twin = staticmethod(lambda xi, xj, vi, vj, mi, mj: 0 * vi)


@pytest.mark.parametrize(
    ("text", "terms"),
    [
        ("terms must be instances of Term, got the class Gravity: write Gravity()", [Springs(), Gravity]),
        ("terms must be instances of Term, got 'gravity'", ["gravity"]),
        ("terms must be a list of terms, got Gravity(values={", Gravity()),
        ("terms must be a list of terms, got None", None),
        ("terms must each be listed once, got springs 2 times", [Springs(), Gravity(), Springs()]),
        ("parameter names must be unique in a system, got gravity_x in both gravity and wind", [Gravity(), Wind()]),
        (
            "term misplaced has the unknown stage 'bodi'; did you mean 'body'? known: axial, strand, hinge,",
            [Misplaced()],
        ),
    ],
)
def test_terms(text, terms):
    refused(text, terms=terms)


def test_unknown_parameters_of_a_system_suggest_the_nearest():
    system = System(**good())
    with pytest.raises(ValueError, match="no term of this system has a parameter 'dashpot_dampin'; did you mean 'dashpot_damping'"):
        system.with_values(dashpot_dampin=1.0)
    with pytest.raises(ValueError, match=re.escape("dashpot_damping must lie in [0, 200] N s/m, got -1")):
        system.with_values(dashpot_damping=-1)


def test_with_values_leaves_the_original_alone():
    system = System(**good())
    changed = system.with_values(dashpot_damping=7.0, controller_velocity=0.5)
    assert (changed.values["dashpot_damping"], changed.values["controller_velocity"]) == (7.0, 0.5)
    assert (system.values["dashpot_damping"], system.values["controller_velocity"]) == (100.0, 1.0)


# ---------------------------------------------------------------- batches


def batch_refused(text, systems, **options):
    with pytest.raises(ValueError, match=re.escape(text)):
        Batch(systems, **{"fps": 30, "substeps": 10, **options})


def test_a_batch_holds_systems_with_the_same_kinds_of_terms():
    springs, with_gravity = System(**good(terms=[Springs()])), System(**good(terms=[Springs(), Gravity()]))
    swapped = System(**good(terms=[Gravity(), Springs()]))
    batch_refused("a batch needs at least one system", [])
    batch_refused("all systems of a batch must have the same kinds of terms in the same order", [springs, with_gravity])
    batch_refused("all systems of a batch must have the same kinds of terms in the same order", [with_gravity, swapped])


def test_one_term_moves_particles_and_one_makes_contacts():
    batch_refused("a system can have one term that moves particles, got ground, bounce", [System(**good(terms=[Ground(), Bounce()]))])
    batch_refused("a system can have one contact term, got self_collision, touch", [System(**good(terms=[SelfCollision(), Touch()]))])


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("fps must be a number > 0 and finite, got 0", dict(fps=0)),
        ("fps must be a number > 0 and finite, got -30", dict(fps=-30)),
        ("fps must be a number > 0 and finite, got nan", dict(fps=np.nan)),
        ("fps must be a number > 0 and finite, got inf", dict(fps=np.inf)),
        ("substeps must be whole numbers >= 1 or 'auto', got 0", dict(substeps=0)),
        ("substeps must be whole numbers >= 1 or 'auto', got -3", dict(substeps=-3)),
        ("substeps must be whole numbers >= 1 or 'auto', got 2.5", dict(substeps=2.5)),
        ("substeps must be whole numbers >= 1 or 'auto', got nan", dict(substeps=np.nan)),
        ("substeps must be whole numbers >= 1 or 'auto', got [10, 0]", dict(substeps=[10, 0])),
        ("substeps must be a number or one for each of the 2 systems, got 'Auto'", dict(substeps="Auto")),
        ("substeps must be a number or one for each of the 2 systems, got [1, 2, 3]", dict(substeps=[1, 2, 3])),
        ("dt must be > 0 and finite [s], got 0.0", dict(dt=0.0)),
        ("dt must be > 0 and finite [s], got -1e-05", dict(dt=-1e-5)),
        ("dt must be > 0 and finite [s], got nan", dict(dt=np.nan)),
        ("dt must be > 0 and finite [s], got [0.001, 0]", dict(dt=[1e-3, 0])),
        ("dt must be a number or one for each of the 2 systems, got [1, 2, 3]", dict(dt=[1, 2, 3])),
    ],
)
def test_time_of_a_batch(text, options):
    system = System(**good())
    batch_refused(text, [system, system], **options)


def test_unknown_columns_suggest_the_nearest():
    batch = Batch([System(**good())], fps=30, substeps=10)
    with pytest.raises(ValueError, match="no term of this batch has a parameter 'dashpot'; did you mean 'dashpot_damping'"):
        batch.column("dashpot")
    assert batch.inputs.table[0, batch.column("dashpot_damping")] == 100


def test_frames_of_a_roll_out_are_not_negative():
    batch = Batch([System(**good())], fps=30, substeps=10)
    with pytest.raises(ValueError, match="frame must be a whole number >= 0, got -1"):
        batch.march(-1, 2)
    for frames in (-2, 0, 2.5):
        with pytest.raises(ValueError, match=f"frames must be a whole number >= 1, got {frames}"):
            batch.rollout(frames)


@pytest.mark.parametrize("name", [f.name for f in fields(Inputs)])
def test_inputs_that_the_kernels_would_read_past_are_refused(name):
    nodes, one = np.arange(4)[:, None], np.ones((4, 1))
    points = Points(nodes, one, good()["positions"], *np.ones((2, 4)), holds=np.full(4, -1), held=np.zeros(4))
    batch = Batch([System(**good(**ROPE, points=points))], fps=30, substeps=10)
    own = getattr(batch.inputs, name)
    other = own[:, :-1] if name == "path" else own[:-1] if len(own) else own.new_zeros((1, *own.shape[1:]))
    for wrong in (other, own.double()):
        with pytest.raises(ValueError, match=f"inputs.{name} must be"):
            batch.march(0, 1, replace(batch.inputs, **{name: wrong}))


def test_time_steps_that_numpy_and_people_write():
    system = System(**good())
    assert Batch([system, system], fps=np.float32(30), substeps=np.array([10, 20])).substeps.tolist() == [10, 20]
    for options in (dict(fps="30"), dict(fps=None), dict(fps=[30]), dict(substeps=np.inf), dict(dt=np.inf)):
        with pytest.raises(ValueError, match="must be"):
            Batch([system], **{"fps": 30, **options})
