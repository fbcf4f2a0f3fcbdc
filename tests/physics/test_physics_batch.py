"""A batch is nothing but its systems side by side: every comparison here is exact, bit for bit, unless it says why not."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from twinbench.physics.batch import FAR, Batch, Inputs, first_bad
from twinbench.physics.stability import stable_step
from twinbench.physics.system import System
from twinbench.physics.terms import ControllerSprings, Dashpot, Gravity, Ground, LinearDrag, SelfCollision, Springs
from twinbench.physics.terms.grip_slip import GripSlip
from twinbench.physics.terms.plasticity import Plasticity
from twinbench.physics.terms.viscoelastic import Viscoelastic
from twinbench.physics.topology import controller_springs, object_springs

FPS, SUBSTEPS = 30, 40
AIR = (Springs, Dashpot, Gravity, LinearDrag, Ground, ControllerSprings)
KINDS = {"air": AIR, "contacts": (*AIR, SelfCollision), "memories": (*AIR, Plasticity, SelfCollision, Viscoelastic, GripSlip)}
every_kind = pytest.mark.parametrize("kinds", KINDS.values(), ids=KINDS)
both_precisions = pytest.mark.parametrize("double", [False, True], ids=["float32", "float64"])


def make(kinds, seed, *, count=None, frames=None, grip=True):
    """A body of its own size, numbers of controllers, length and parameters, thrown at the table z = 0, held by a grip, pulled by hands."""
    rng = np.random.default_rng(seed)
    count = rng.integers(12, 40) if count is None else count
    frames = rng.integers(3, 8) if frames is None else frames
    points = rng.random((count, 3)) * 0.08 - [0, 0, 0.083]
    hands = rng.integers(1, 4)
    path = points[None, :hands] + np.cumsum(rng.normal(size=(frames, hands, 3)) * 0.003, 0)
    path[0] = points[:hands]
    path[:, int(grip) :] += [0.0, 0.01, -0.01]
    ties = controller_springs(path[0, int(grip) :], points, radius=0.05, max_neighbours=6)
    ties[:, 0] += count + int(grip)
    springs = np.concatenate([object_springs(points, radius=0.035, max_neighbours=10), ties])
    terms = [k() for k in kinds]
    system = System(
        positions=points,
        velocities=rng.normal(size=points.shape) * 0.3 + np.array([0.2, 0.0, 0.3]),
        masses=rng.uniform(0.5, 2, count),
        springs=springs,
        stiffness=rng.uniform(50, 100, len(springs)),
        controllers=path,
        grips=[0] + [-1] * (hands - 1) if grip else None,
        terms=terms,
    )
    ranges = dict(dashpot_damping=(1, 5), gravity_x=(-5, 5), drag_damping=(0, 5), collide_elas=(0, 1), controller_velocity=(0, 1))
    ranges |= dict(plastic_rate=(5, 50), yield_strain=(0.01, 0.03), branch_stiffness=(0.5, 2), slip_rate=(5, 50), slip_force=(0.5, 2))
    values = {name: rng.uniform(*limits) for name, limits in ranges.items() if name in system.values}
    return system.with_values(**values, **({"collision_dist": rng.uniform(0.01, 0.03)} if SelfCollision in kinds else {}))


def roll(systems, frames=6, **options):
    """(positions of each system, diverged) of a batch."""
    found = Batch(systems, **{"fps": FPS, "substeps": SUBSTEPS, "workers": 1, **options}).rollout(frames)
    return found.positions, found.diverged.tolist()


def equal(found, expected):
    """Whether two lists of tensors agree to the last bit; NaN equals NaN."""
    return len(found) == len(expected) and all(
        a.shape == b.shape and a.dtype == b.dtype and np.array_equal(a.numpy(), b.numpy(), equal_nan=True)
        for a, b in zip(found, expected, strict=True)
    )


# ---------------------------------------------------------------- side by side


@both_precisions
@every_kind
def test_batched_results_are_the_single_ones(kinds, double):
    systems = [make(kinds, seed, grip=seed % 2 == 0) for seed in range(5)]
    assert len({s.particle_count for s in systems}) > 2 and len({len(s.controllers) for s in systems}) > 1
    together, diverged = roll(systems, double=double)
    assert equal(together, [roll([s], double=double)[0][0] for s in systems])
    assert diverged == [-1] * 5
    for system, x in zip(systems, together, strict=True):
        assert x.dtype == (torch.float64 if double else torch.float32) and x.shape == (6, system.particle_count, 3)
        np.testing.assert_array_equal(x[0], system.positions.astype(np.float64 if double else np.float32))
        assert (x[-1] - x[0]).abs().max() > 0.01  # they move


@every_kind
@pytest.mark.parametrize("count", [2, 20])  # one system a thread; more than the sixteen shares that two threads take turns at
def test_threads_do_not_matter(kinds, count):
    systems = [make(kinds, seed) for seed in range(count)]
    assert equal(roll(systems, workers=2)[0], roll(systems, workers=1)[0])


@every_kind
def test_a_run_repeats(kinds):
    batch = Batch([make(kinds, seed) for seed in range(3)], fps=FPS, substeps=SUBSTEPS, workers=2)
    assert equal(batch.rollout().positions, batch.rollout().positions)


@every_kind
def test_permuted_systems_have_permuted_results(kinds):
    systems = [make(kinds, seed) for seed in range(5)]
    order = [3, 0, 4, 2, 1]
    straight = roll(systems)[0]
    assert equal(roll([systems[k] for k in order])[0], [straight[k] for k in order])


@every_kind
def test_the_same_system_twice(kinds):
    system = make(kinds, 0)
    first, second = roll([system, system])[0]
    assert equal([first], [second])


@every_kind
def test_systems_with_substeps_and_steps_of_their_own(kinds):
    systems, substeps, dt = [make(kinds, seed) for seed in range(4)], [40, 17, 64, 25], [8e-4, 2e-3, 5e-4, 1.3e-3]
    assert equal(roll(systems, substeps=substeps)[0], [roll([s], substeps=n)[0][0] for s, n in zip(systems, substeps, strict=True)])
    each = [roll([s], substeps=n, dt=h)[0][0] for s, n, h in zip(systems, substeps, dt, strict=True)]
    assert equal(roll(systems, substeps=substeps, dt=dt)[0], each)
    assert not equal(each, roll(systems)[0])


def test_bare_systems_beside_others():
    # no springs, no controllers, a single particle: nothing to gather, nothing to follow
    full = make(AIR, 0)
    bare = replace(full, springs=np.zeros((0, 2)), stiffness=[], rest=[], controllers=np.zeros((1, 0, 3)), grips=None)
    one = replace(bare, positions=[[0.0, 0, -1]], velocities=None, masses=None, home=None)
    systems = [bare, full, one]
    assert equal(roll(systems)[0], [roll([s])[0][0] for s in systems])


@every_kind
def test_inputs_take_the_place_of_what_the_systems_hold(kinds):
    # what a fit changes through tensors is what another system would hold
    one, other = make(kinds, 0, count=20, frames=5), make(kinds, 0, count=20, frames=5)
    rng = np.random.default_rng(1)
    other = replace(
        other,
        velocities=other.velocities + 0.1,
        masses=other.masses * rng.uniform(0.5, 2, 20),
        stiffness=other.stiffness * rng.uniform(0.5, 2, len(other.stiffness)),
        rest=other.rest * rng.uniform(0.9, 1.1, len(other.rest)),
        controllers=other.controllers + 0.001,
    ).with_values(gravity_z=5.0)
    batch, target = (Batch([s], fps=FPS, substeps=SUBSTEPS) for s in (one, other))
    given = Inputs(**{f.name: getattr(target.inputs, f.name) for f in fields(Inputs)})
    assert equal(batch.rollout(inputs=given).positions, target.rollout().positions)
    assert not equal(batch.rollout().positions, target.rollout().positions)


# ---------------------------------------------------------------- frames and paths


@every_kind
def test_a_roll_out_shorter_than_the_path_is_its_beginning(kinds):
    system = make(kinds, 0, frames=6)
    whole = roll([system], frames=None)[0][0]
    assert len(whole) == 6
    for frames in (1, 2, 5):
        assert equal(roll([system], frames=frames)[0], [whole[:frames]])


@every_kind
def test_a_path_shorter_than_the_longest_holds_its_last_frame(kinds):
    short, long = make(kinds, 0, frames=3), make(kinds, 1, frames=7)
    padded = replace(short, controllers=np.concatenate([short.controllers, np.repeat(short.controllers[-1:], 6, 0)]))
    in_batch, beyond, explicit = roll([short, long], frames=None)[0][0], roll([short], frames=9)[0][0], roll([padded], frames=None)[0][0]
    assert (len(in_batch), len(beyond), len(explicit)) == (7, 9, 9)
    assert equal([in_batch, beyond], [explicit[:7], explicit])


@both_precisions
def test_grips_are_on_their_controllers_at_every_frame(double):
    # whatever pulls on it; between frames the path is straight, and a + (b - a) 0 is a
    system = make(AIR, 4, count=20, frames=5)
    few = dict(springs=system.springs[:30], stiffness=system.stiffness[:30], rest=system.rest[:30])
    system = replace(system, grips=np.arange(system.controllers.shape[1]) + 7, **few)
    assert len(system.grips) > 1
    x = roll([system], frames=7, double=double)[0][0]
    held = system.grips.tolist()
    # each controller carries its particle along where it found it
    path = torch.tensor(system.controllers - system.controllers[0] + system.positions[held], dtype=x.dtype)
    rounding = 4 * torch.finfo(x.dtype).eps  # of numbers below 1 m, added in another order
    assert (x[1:5, held] - path[1:]).abs().max() <= rounding
    assert (x[5:, held] - path[[-1, -1]]).abs().max() <= rounding


def test_a_grip_moves_at_the_speed_of_its_controller():
    # v = (path[f + 1] - path[f]) fps, and what its springs feel is what a particle so moved would do: their other ends are dragged along
    system = make(AIR, 0, frames=6)
    _, x, v = Batch([system], fps=FPS, substeps=SUBSTEPS, double=True).march(0, 3)
    np.testing.assert_array_equal(x[0], system.controllers[3, 0])
    np.testing.assert_allclose(v[0], (system.controllers[4, 0] - system.controllers[3, 0]) * FPS, rtol=1e-12)


# ---------------------------------------------------------------- blow-ups


def test_a_system_that_blows_up_is_reported_and_alone():
    for kinds in KINDS.values():
        for position in range(3):
            systems = [make(kinds, seed, frames=6) for seed in range(3)]
            bad = replace(systems[position], stiffness=systems[position].stiffness * 1e7)
            assert stable_step(bad) < 1 / FPS / SUBSTEPS / 100
            calm = roll(systems)[0]
            systems[position] = bad
            found, diverged = roll(systems)
            others = [k for k in range(3) if k != position]
            assert equal([found[k] for k in others], [calm[k] for k in others])
            assert [diverged[k] for k in others] == [-1, -1]
            far = ~(found[position].abs() < FAR).flatten(1).all(1)  # NaN and infinity are not below anything
            assert diverged[position] == int(far.nonzero()[0]) >= 1


def test_the_frame_of_a_particle_that_leaves_the_room():
    # 10.1 km/s at 30 frames a second: 336.7 m a frame, beyond 1000 m in frame 3
    at_ease = make(AIR, 0)
    alone = dict(springs=np.zeros((0, 2)), stiffness=[], controllers=np.zeros((1, 0, 3)), terms=at_ease.terms)
    gone = System(positions=[[0.0, 0, -1]], velocities=[[10100.0, 0, 0]], **alone).with_values(drag_damping=0.0)
    assert roll([gone, at_ease])[1] == [3, -1]
    assert roll([at_ease, gone], frames=3)[1] == [-1, -1]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, FAR, -2 * FAR])
def test_first_bad_frame(value):
    x = torch.zeros(5, 4, 3)
    assert first_bad(x) == -1
    x[3, 2, 1] = value
    assert first_bad(x) == 3
    x[1, 0, 0] = value
    assert first_bad(x) == 1
    x[0, 3, 2] = value
    assert first_bad(x) == 0


# ---------------------------------------------------------------- terms in the list and out of it


def close(found, expected):
    """Whether two roll-outs in float64 agree to rounding: kernels of other lists of terms may be compiled to another order of sums."""
    return all(a.dtype == torch.float64 and torch.allclose(a, b, rtol=0, atol=1e-9) for a, b in zip(found, expected, strict=True))


def without(system, *kinds):
    return replace(system, terms=[t for t in system.terms if not isinstance(t, kinds)])


NOTHING = {
    Springs: dict(),
    Dashpot: dict(dashpot_damping=0.0),
    Gravity: dict(gravity_x=0.0, gravity_y=0.0, gravity_z=0.0),
    LinearDrag: dict(drag_damping=0.0),
    Ground: dict(ground_offset=-10.0),
    SelfCollision: dict(collision_dist=0.0),
}


@pytest.mark.parametrize("term", NOTHING, ids=lambda t: t.__name__)
def test_a_term_left_out_is_a_term_that_does_nothing(term):
    system = make(KINDS["contacts"], 0)
    neutral = system.with_values(**NOTHING[term])
    if term is Springs:  # its parameter belongs to the springs
        neutral = replace(system, stiffness=0 * system.stiffness)
    found = roll([without(system, term)], double=True)[0]
    assert close(found, roll([neutral], double=True)[0])
    assert not close(found, roll([system], double=True)[0])


def test_without_their_term_controllers_pull_on_nothing():
    # as if their springs had never been drawn; a grip is no spring and stays
    system = make(AIR, 0, count=20)
    own = (system.springs < 20).all(1)
    assert 0 < own.sum() < len(own)
    undrawn = replace(system, springs=system.springs[own], stiffness=system.stiffness[own], rest=system.rest[own])
    found = roll([without(system, ControllerSprings)], double=True)[0]
    assert equal(found, roll([without(undrawn, ControllerSprings)], double=True)[0])
    assert close(found, roll([undrawn], double=True)[0])
    assert not close(found, roll([system], double=True)[0])
    last = min(5, len(system.controllers) - 1)
    np.testing.assert_array_equal(found[0][last, 0], system.controllers[last, 0])


@pytest.mark.parametrize("controller", [0, 1])
def test_a_spring_to_a_controller_that_grips_is_one_to_its_particle(controller):
    # such a spring is the body's own, with or without the term
    system = make(AIR, 4, count=20)
    # a controller may not grip a particle that its springs pull
    free = np.setdiff1d(np.arange(20), system.springs[(system.springs >= 20).any(1)])
    held = [*free[[5, 3]], *[-1] * (system.controllers.shape[1] - 2)]
    end, other = held[controller], free[0]
    more = dict(grips=held, stiffness=np.append(system.stiffness, 80.0), rest=np.append(system.rest, 0.05))
    to_controller = replace(system, springs=np.concatenate([system.springs, [[20 + controller, other]]]), **more)
    to_particle = replace(system, springs=np.concatenate([system.springs, [[end, other]]]), **more)
    for change in (lambda s: s, lambda s: without(s, ControllerSprings)):
        assert equal(roll([change(to_controller)])[0], roll([change(to_particle)])[0])
        assert not equal(roll([change(to_controller)])[0], roll([change(replace(system, grips=held))])[0])


def test_the_order_of_springs_ends_does_not_matter():
    # forces are central and equal: a spring is the same from either end
    system = make(AIR, 0)
    assert equal(roll([replace(system, springs=system.springs[:, ::-1])])[0], roll([system])[0])


# ---------------------------------------------------------------- contacts and the way back


def test_a_driven_particle_does_not_yield_in_a_contact():
    # against a wall of infinite mass the normal velocity turns to -e times itself, whatever the driven particle's own mass
    terms = (SelfCollision({"collision_dist": 0.02, "collide_object_elas": 0.7, "collide_object_fric": 0.0}),)
    still = np.zeros((2, 1, 3))
    one = System(
        positions=[[0, 0, 0], [0.01, 0, 0]],
        velocities=[[0, 0, 0], [-1, 0, 0]],
        masses=[0.5, 2.0],
        springs=np.zeros((0, 2), int),
        stiffness=[],
        controllers=still,
        grips=[0],
        terms=terms,
    )
    _, _, v = Batch([one], fps=1e4, substeps=1, double=True).march(0, 1)
    np.testing.assert_allclose(v[:2], [[0, 0, 0], [0.7, 0, 0]], atol=1e-15)


def test_an_input_changed_in_place_before_the_way_back_is_refused():
    batch = Batch([make(AIR, 0, frames=6)], fps=FPS, substeps=SUBSTEPS, double=True)
    stiffness = batch.inputs.stiffness.clone().requires_grad_()
    out, _, _ = batch.march(0, 2, replace(batch.inputs, stiffness=stiffness))
    with torch.no_grad():
        stiffness += 1.0
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        out.sum().backward()


@every_kind
def test_along_other_ways_is_what_systems_with_these_ways_do(kinds):
    one = make(kinds, 5, frames=6)
    ways = one.controllers + np.cumsum(np.random.default_rng(0).normal(0, 1e-3, (3, *one.controllers.shape)), axis=1)
    ways[:, 0] = one.controllers[0]
    options = dict(fps=FPS, substeps=SUBSTEPS, workers=1)
    batch = Batch([one] * 3, **options)
    moved, apart = batch.rollout(6, batch.along(ways)).positions, roll([replace(one, controllers=way) for way in ways])[0]
    assert all(torch.equal(a, b) for a, b in zip(moved, apart, strict=True))
    with pytest.raises(ValueError, match="must begin where"):
        batch.along(ways + 0.01)
    with pytest.raises(ValueError, match=r"shape \(3, T"):
        batch.along(ways[:2])
