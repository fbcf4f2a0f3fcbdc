"""Material points: what acts from outside on a body, against closed forms; ground that sticks and slides, grips, drag, gradients."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from twinbench.benchmark.conformance import gradients
from twinbench.physics.batch import Batch
from twinbench.physics.grids import embed
from twinbench.physics.points import material_points
from twinbench.physics.stability import stable_step
from twinbench.physics.system import System
from twinbench.physics.terms import (
    AddedMass,
    AirDrag,
    CoulombGround,
    Gravity,
    GroundPose,
    KelvinVoigt,
    LinearDrag,
    NeoHookean,
    SlidingHand,
    SoftGrip,
    SurfaceDrag,
    Wind,
)
from twinbench.physics.terms.mass_field import MassField

DENSITY, SIZE = 100.0, np.array([0.06, 0.05, 0.026])
MASS = DENSITY * SIZE.prod()


def block(*terms, pitch=0.02, offset=(0.3, 0.25, 0.4), at=(0, 0, 0), controllers=None, hold=None, velocities=None, young=2e4):
    """A block of foam in a grid that does not fit it; the points of its skin are those of all six faces, 7 mm apart."""
    along = [(np.arange(n) + 0.5) * s / n for n, s in zip((24, 20, 12), SIZE, strict=True)]
    samples = np.stack(np.meshgrid(*along, indexing="ij"), -1).reshape(-1, 3) + at
    grid = embed(samples, SIZE.prod(), pitch, axes=np.eye(3), offset=offset)
    faces = []
    for axis in range(3):
        u, w = (np.linspace(0, SIZE[k], round(SIZE[k] / 0.007)) for k in range(3) if k != axis)
        for level in (0, SIZE[axis]):
            flat = np.insert(np.stack(np.meshgrid(u, w, indexing="ij"), -1).reshape(-1, 2), axis, level, axis=1)
            faces.append(flat)
    skin = np.unique(np.concatenate(faces).round(9), axis=0) + at
    area = 2 * (SIZE[0] * SIZE[1] + SIZE[1] * SIZE[2] + SIZE[2] * SIZE[0])
    points = material_points(grid, DENSITY, skin, area)
    if hold is not None:
        held = np.flatnonzero(hold(points.home))
        points.holds[held], points.held[held] = np.arange(len(held)), 1.0
        controllers = np.repeat(points.home[held][None], 2, 0)
    return System(
        positions=grid.positions,
        velocities=velocities,
        springs=np.zeros((0, 2), int),
        stiffness=[],
        controllers=np.zeros((2, 0, 3)) if controllers is None else controllers,
        grid=grid,
        points=points,
        terms=[NeoHookean({"youngs_modulus": young}), *terms],
    )


def middle(system, path):
    """(T, 3) m, the body's centre of mass on a path (T, N, 3) of its nodes."""
    return system.points.positions(path.double().numpy()).transpose(0, 2, 1) @ system.points.masses / MASS


def test_points_carry_the_bodys_mass_and_move_with_it():
    # sum w = 1 and trilinear functions reproduce affine motions: skin points move by it exactly, the nodes' masses are the body's
    one = block()
    assert one.masses.sum() == pytest.approx(MASS, rel=1e-12) and (one.masses > 0).all()
    affine, shift = np.random.default_rng(0).normal(size=(3, 3)), np.array([1.0, 2.0, 3.0])
    skin = one.points.areas > 0
    np.testing.assert_allclose(
        one.points.positions(one.positions @ affine + shift)[skin], one.points.home[skin] @ affine + shift, atol=1e-12
    )
    assert one.points.areas.sum() == pytest.approx(2 * (0.06 * 0.05 + 0.05 * 0.026 + 0.026 * 0.06))


def test_a_body_falls_as_one():
    # gravity acts by the masses that inertia has: every node falls by g t^2 / 2 and nothing is strained (semi-implicit: g t (t + dt) / 2)
    one = block(Gravity({"gravity_z": -9.8}))
    path = Batch([one], fps=30, substeps=100, double=True).rollout(7).positions[0]
    t = np.arange(7) / 30
    fall = -9.8 * t * (t + 1 / 3000) / 2
    expected = np.stack([0 * t, 0 * t, fall], 1)[:, None].repeat(len(one.positions), 1)
    np.testing.assert_allclose(path.numpy() - one.positions, expected, atol=1e-12)


@pytest.mark.parametrize(("angle", "friction"), [(15.0, 0.4), (25.0, 0.2)])
def test_a_block_sticks_on_a_slope_or_slides_down_it(angle, friction):
    # tan 15 = 0.27 < 0.4: it stays, without creep; tan 25 = 0.47 > 0.2: it slides with g (sin - mu cos), here for half a second
    lean = np.deg2rad(angle)
    gravity = dict(zip(("gravity_x", "gravity_y", "gravity_z"), 9.8 * np.array([np.sin(lean), 0, -np.cos(lean)]), strict=True))
    ground = CoulombGround({"coulomb_friction": friction, "coulomb_normal_z": 1.0, "coulomb_offset": 0.0})
    one = block(Gravity(gravity), ground, KelvinVoigt({"viscosity": 200.0}))
    path = middle(one, Batch([one], fps=60, double=True).rollout(121).positions[0])
    t = np.arange(121) / 60
    if np.tan(lean) < friction:
        assert path[0, 2] - 0.002 < path[-1, 2] < path[0, 2]  # it has sunk in by less than 2 mm
        assert np.abs(path[60:, 0] - path[60, 0]).max() < 2e-5
    else:
        found = np.polyfit(t[30:], path[30:, 0], 2)[0] * 2
        assert found == pytest.approx(9.8 * (np.sin(lean) - friction * np.cos(lean)), rel=0.02)


def test_friction_forgets_where_a_block_was_before_it_was_thrown_up():
    # it lands 40 mm further and stays there: what friction remembers ends where contact ends
    fly = np.array([0.2, 0.0, 1.0])
    ground = CoulombGround({"coulomb_friction": 1.0, "coulomb_normal_z": 1.0, "coulomb_damping": 1.0})
    one = block(Gravity({"gravity_z": -9.8}), ground, KelvinVoigt({"viscosity": 200.0}))
    one = replace(one, velocities=np.tile(fly, (one.particle_count, 1)))
    path = middle(one, Batch([one], fps=60, double=True).rollout(91).positions[0])
    assert path[-1, 0] - path[0, 0] > 0.03  # 2 * 1 / 9.8 s of flight at 0.2 m/s
    assert np.abs(path[75:, 0] - path[75, 0]).max() < 5e-5


def test_a_hand_carries_a_body_and_lags_behind_by_its_weight():
    # at rest the springs of all held points bear the weight: sum m w^2 d = M g; held everywhere: d = g / w^2
    rate = 60.0
    one = block(Gravity({"gravity_z": -9.8}), SoftGrip({"grip_rate": rate}), hold=lambda home: home[:, 0] < np.inf)
    inside = one.points.masses > 0
    one.points.held[~inside] = 0.0
    path = Batch([one], fps=30, double=True).rollout(31).positions[0]
    drop = middle(one, path)[-1] - middle(one, path)[0]
    np.testing.assert_allclose(drop, [0, 0, -9.8 / rate**2], atol=2e-6)


def by_two_hands(*terms):
    """The block, held everywhere: by hand 3 on the left of its middle, by hand 5 on the right."""
    one = block(Gravity({"gravity_z": -9.8}), *terms, hold=lambda home: home[:, 0] < np.inf)
    one.points.held[one.points.masses == 0] = 0.0
    home = one.points.home[one.points.holds >= 0]
    return replace(one, hands=np.where(home[:, 0] < SIZE[0] / 2, 3, 5))


def turned(one, path):
    """How far a path (T, N, 3) ends turned about y: by how much material points rose, for each metre of x that they began at."""
    inside = one.points.masses > 0
    first, last = (one.points.positions(path[t].numpy())[inside] for t in (0, -1))
    along = first[:, 0] - first[:, 0].mean()
    return along @ (last - first)[:, 2] / (along @ along)


def test_one_hand_of_two_holds_otherwise():
    # a rigid body on springs of w^2 for each mass, that drops by d and turns by t about y: sum k (d + t x) = M g, and, since springs hold
    # points against moving sideways as well, sum k (x (d + t x) + z^2 t) = 0
    soft, firm, young = 60.0, 90.0, 2e7
    one = by_two_hands(SoftGrip({"grip_rate": soft, "grip_hand": 5.0, "firm_rate": firm, "grip_damping": 1.0, "firm_damping": 1.0}))
    one = one.with_values(youngs_modulus=young)
    path = Batch([one], fps=30, substeps=2000, double=True).rollout(31).positions[0]
    inside = one.points.masses > 0
    home, m = one.points.home[inside], one.points.masses[inside] / MASS
    (x, _, z), k = (home - m @ home).T, m * np.where(home[:, 0] < SIZE[0] / 2, firm, soft) ** 2
    drop, turn = np.linalg.solve([[k.sum(), k @ x], [k @ x, k @ (x**2 + z**2)]], [-9.8, 0.0])
    assert (middle(one, path)[-1] - middle(one, path)[0])[2] == pytest.approx(drop, rel=0.01)  # what foam this firm bends by
    assert turned(one, path) == pytest.approx(turn, rel=0.01) and turn < 0  # the soft hand is on the right


def test_one_hand_of_two_lets_slip():
    # as above, of the other hand alone: what it holds sinks, and what the first holds stays
    slide = SlidingHand({"slide_most": 1.0, "slide_speed": 0.05, "slide_weights": 0.3, "slide_burden": 9.8, "slide_hand": 5.0})
    one = by_two_hands(SoftGrip({"grip_rate": 60.0, "grip_damping": 1.0}), slide)
    _, _x, _v, carried = Batch([one], fps=30, substeps=100, double=True).march(0, 15, whole=True)
    assert (carried.slid[0] == 0).all() and carried.slid[1, 2] > 0.005  # 0.05 (1 - 0.3) m/s for half a second were 0.0175


@pytest.mark.parametrize("substeps", [100, 400])
def test_a_hand_that_moves_evenly_is_neither_led_nor_followed(substeps):
    # w d + 2 z d' = 0 in an even motion: what is held is where its hand is, at the same time, however long a step is. A hand a step ahead
    # would carry it v dt ahead, 0.17 mm in steps of a hundredth of a frame. Springs have decayed by exp(-0.2 x 300 x 1 s)
    one = block(SoftGrip({"grip_rate": 300.0}), hold=lambda home: home[:, 0] < np.inf)
    way = 0.5 * np.arange(31)[:, None, None] / 30 * [1.0, 0.0, 0.0]
    one = replace(one, controllers=one.controllers[:1] + way)
    path = middle(one, Batch([one], fps=30, substeps=substeps, double=True).rollout(31).positions[0])
    np.testing.assert_allclose(path[-5:] - path[0], way[-5:, 0], atol=1e-6)


def test_a_hand_that_holds_points_is_no_mass_of_the_body():
    # a mass field shares out what the body has, and leaves controllers alone: sum of all masses as before
    one = block(SoftGrip(), MassField({"mass_slope_a": 0.3}), hold=lambda home: home[:, 0] < 0.01)
    batch = Batch([one], fps=30, substeps=10, double=True)
    mass = batch.prepare(batch.inputs).mass
    assert mass[: one.particle_count].sum().item() == pytest.approx(MASS) and not torch.equal(mass, batch.inputs.mass)
    assert (mass[one.particle_count :] == batch.inputs.mass[one.particle_count :]).all()


def test_quadratic_drag_slows_a_flying_body():
    # M v' = -b v^2, b = C rho / 2 A / 4: 1 / v grows by b t / M
    v0, drag = 3.0, 20.0
    one = block(SurfaceDrag({"drag_coefficient": drag}), young=2e5)
    one = replace(one, velocities=np.tile([v0, 0, 0], (one.particle_count, 1)))
    path = middle(one, Batch([one], fps=60, double=True).rollout(31).positions[0])[:, 0]
    b = drag * 1.2 / 2 * one.points.areas.sum() / 4 / MASS
    t = np.arange(31) / 60
    np.testing.assert_allclose(path - path[0], np.log(1 + b * v0 * t) / b, rtol=2e-3, atol=1e-9)  # first order: b v dt / 2 is 4e-4


def test_forces_by_the_mass_are_those_on_nodes_where_they_do_not_ask_for_the_place():
    # without a place, a sum over points by mass is one over nodes by mass
    terms = (Gravity(), Wind({"wind_x": 1.0}), LinearDrag({"drag_damping": 2.0}))
    pointed = block(*terms)
    plain = replace(pointed, points=None)
    paths = [Batch([s], fps=30, substeps=100, double=True).rollout(7).positions[0].numpy() for s in (pointed, plain)]
    np.testing.assert_allclose(
        *paths, atol=2e-3 * np.abs(paths[0][-1] - paths[0][0]).max()
    )  # the wind asks how fast they are, each by itself


@pytest.mark.parametrize("weights", [0.6, 2.5])
def test_a_hand_lets_slip_what_is_heavier_than_it_holds(weights):
    # held everywhere by a force s M g: a body of M g slides out at c (1 - s) beside its lag of g / w^2, or hangs there, where its bounce of
    # 2 M g does not reach s. Springs of 60 1/s with a fifth of critical damping have decayed by exp(-24) after two seconds; what slides
    # in a substep counts at its end, a share c w^2 / g dt of the lag
    rate, speed = 60.0, 0.05
    slide = SlidingHand({"slide_most": 1.0, "slide_speed": speed, "slide_weights": weights, "slide_burden": 9.8})
    one = block(Gravity({"gravity_z": -9.8}), SoftGrip({"grip_rate": rate}), slide, hold=lambda home: home[:, 0] < np.inf)
    one.points.held[one.points.masses == 0] = 0.0
    path = middle(one, Batch([one], fps=30, substeps=400, double=True).rollout(91).positions[0])[:, 2]
    if weights > 1:
        assert path[-1] - path[0] == pytest.approx(-9.8 / rate**2, abs=2e-6)
    else:
        assert (path[90] - path[60]) == pytest.approx(-speed * (1 - weights), rel=speed * rate**2 / 9.8 / (30 * 400))


@pytest.mark.parametrize("most", [0.004, 0.03])
def test_what_slides_is_held_again(most):
    # as above with s = 0.6: it slides by c (1 - s) t, 0.06 m in three seconds, and d at most, where it stays; then it hangs at its lag
    rate, speed = 60.0, 0.05
    slide = SlidingHand({"slide_most": most, "slide_speed": speed, "slide_weights": 0.6, "slide_burden": 9.8})
    hand = SoftGrip({"grip_rate": rate, "grip_damping": 1.0})
    one = block(Gravity({"gravity_z": -9.8}), hand, slide, hold=lambda home: home[:, 0] < np.inf)
    one.points.held[one.points.masses == 0] = 0.0
    path = middle(one, Batch([one], fps=30, substeps=200, double=True).rollout(91).positions[0])[:, 2]
    assert path[90] - path[0] == pytest.approx(-most - 9.8 / rate**2, rel=1e-3)
    assert path[80] == pytest.approx(path[90], abs=1e-7)


def test_what_a_hand_holds_slides_as_one():
    # held at one end, beside which points bear most of the weight: all slide at c (1 - s), as the hand pulls by the body's weight in all
    speed, weights = 0.05, 0.6
    one = block(
        Gravity({"gravity_x": 9.8, "gravity_z": 0.0}),
        KelvinVoigt({"viscosity": 200.0}),
        SoftGrip({"grip_rate": 300.0, "grip_damping": 1.0}),
        hold=lambda h: h[:, 0] < 0.02,
    )
    one.points.held[one.points.masses == 0] = 0.0
    burden = 9.8 * MASS / (one.points.held @ one.points.masses)
    terms = [*one.terms, SlidingHand({"slide_most": 1.0, "slide_speed": speed, "slide_weights": weights, "slide_burden": burden})]
    one = replace(one, terms=terms, hands=np.zeros(one.controllers.shape[1], int))
    batch = Batch([one], fps=30, substeps=400, double=True)
    out, _x, _v, carried = batch.march(0, 60, whole=True)
    path = middle(one, out[:, : one.particle_count])[:, 0]
    slower = speed * 300.0**2 / burden / (30 * 400)  # of a lag, what slides in a substep, which counts at its end
    assert path[59] - path[29] == pytest.approx(speed * (1 - weights), rel=slower)
    assert carried.slid.shape == (1, 3) and carried.slid[0, 0] < -0.9 * 2 * speed * (1 - weights)


def test_what_slid_out_of_a_hand_does_not_come_back():
    # gravity is turned off: the body stays where it slid to
    slide = SlidingHand({"slide_most": 1.0, "slide_speed": 0.05, "slide_weights": 0.6, "slide_burden": 9.8})
    one = block(Gravity({"gravity_z": -9.8}), SoftGrip({"grip_rate": 60.0, "grip_damping": 1.0}), slide, hold=lambda h: h[:, 0] < np.inf)
    one.points.held[one.points.masses == 0] = 0.0
    batch = Batch([one], fps=30, substeps=40, double=True)
    _, x, v, carried = batch.march(0, 30, whole=True)
    table = batch.inputs.table.clone()
    table[:, batch.column("gravity_z")] = 0.0
    out, _x, _v, after = batch.march(30, 30, replace(batch.inputs, x=x, v=v, table=table, **vars(carried)), whole=True)
    gone = -after.slid[torch.tensor((one.points.masses > 0)[one.points.holds >= 0])].mean(0)  # each point is held by a hand of its own
    assert gone[2] < -0.015  # some 0.05 (1 - 0.6) m/s for a second
    moved = middle(one, torch.stack([batch.inputs.x, out[-1]])[:, : one.particle_count])
    np.testing.assert_allclose(moved[1] - moved[0], gone.numpy(), atol=1e-6)


def graded(term, memory, scale, **values):
    """A batch of two bodies that two hands pull over a table, with ``term`` at some ``values``, every input asking for a gradient, and the
    gradients there.

    What they remember as ``memory`` is some way of ``scale`` m at first.
    """
    batch = Batch(
        [gradients.solid(term, s).with_values(**values) for s in (0, 1)], fps=30, substeps=4 * gradients.SUBSTEPS, double=True, workers=1
    )
    generator = torch.Generator().manual_seed(3)
    begun = torch.randn(getattr(batch.inputs, memory).shape, generator=generator, dtype=torch.float64) * scale
    setattr(batch.inputs, memory, begun)
    inputs = gradients.leaves(batch)
    gradients.loss(batch, inputs).backward()
    return batch, inputs


@pytest.fixture(scope="module", params=[(-1.0, 0.02), (1.0, 0.02), (-1.0, 0.007)], ids=["all hands", "one hand", "two are held again"])
def sliding(request):
    """Bodies that slide out of their hands, some way from where these took hold of them."""
    hand, most = request.param
    return graded(SlidingHand, "slid", 1e-4, slide_hand=hand, slide_most=most)


@pytest.mark.parametrize("name", ["x", "v", "mass", "path", "held", "slid"])
def test_gradients_with_hands_that_let_slip_are_those_of_differences(sliding, name):
    # central differences in float64, relative error below 1e-4
    batch, inputs = sliding
    gradient = getattr(inputs, name).grad
    assert gradient.abs().max() > 1e-9
    gradients.check(batch, inputs, name, gradients.some(gradient))


@pytest.fixture(scope="module", params=[-1.0, 1.0], ids=["all hands", "one hand"])
def pulled(request):
    return graded(SoftGrip, "anchor", 1e-5, grip_hand=request.param)


@pytest.mark.parametrize("name", ["x", "v", "mass", "path", "load", "held", "anchor"])
def test_gradients_with_contact_and_grips_are_those_of_differences(pulled, name):
    # central differences in float64, relative error below 1e-4
    batch, inputs = pulled
    gradient = getattr(inputs, name).grad
    assert gradient.abs().max() > 1e-9
    gradients.check(batch, inputs, name, gradients.some(gradient))


def test_an_added_mass_makes_a_body_heavier_where_it_is():
    # a hand that holds all of it gives way by the weight of each part: the mean by (1 + a) g / w^2 of the mass that the springs know
    rate, share = 60.0, 0.5
    heavy = AddedMass({"added_mass": share, "added_mass_x": 0.06, "added_mass_within": 0.02})
    one = block(Gravity({"gravity_z": -9.8}), SoftGrip({"grip_rate": rate}), heavy, hold=lambda home: home[:, 0] < np.inf)
    one.points.held[one.points.masses == 0] = 0.0
    drop = one.points.positions(Batch([one], fps=30, double=True).rollout(61).positions[0].numpy()[-1]) - one.points.positions(
        one.positions
    )
    inside, m = one.points.masses > 0, one.points.masses
    assert (drop[:, 2] @ m) / MASS == pytest.approx(-(1 + share) * 9.8 / rate**2, rel=2e-3)
    near = one.points.home[:, 0] > 0.04
    assert drop[inside & near, 2].mean() < 1.2 * drop[inside & ~near, 2].mean()


def test_a_batch_is_its_systems_to_the_last_bit():
    ground = CoulombGround({"coulomb_normal_z": 1.0, "coulomb_offset": 0.0})
    some = [block(Gravity({"gravity_z": -9.8}), ground, SoftGrip(), hold=lambda h, r=reach: h[:, 0] < r) for reach in (0.01, 0.02, 0.03)]
    together = Batch(some, fps=30, substeps=40).rollout(7).positions
    for one, path in zip(some, together, strict=True):
        assert torch.equal(Batch([one], fps=30, substeps=40).rollout(7).positions[0], path)


def test_going_on_is_not_stopping():
    # what the ground and hands remember is carried on: two marches in a row are one
    ground = CoulombGround({"coulomb_normal_z": 1.0, "coulomb_offset": 0.001})
    hand = SoftGrip({"grip_rate": 60.0}), SlidingHand({"slide_most": 1.0, "slide_speed": 0.1, "slide_weights": 0.05, "slide_burden": 9.8})
    one = block(Gravity({"gravity_z": -9.8, "gravity_x": 2.0}), ground, *hand, hold=lambda home: home[:, 0] < 0.02)
    batch = Batch([one], fps=30, substeps=40)
    whole = batch.march(0, 6)[0]
    first, x, v, carried = batch.march(0, 3, whole=True)
    second = batch.march(3, 3, replace(batch.inputs, x=x, v=v, **vars(carried)))[0]
    assert torch.equal(torch.cat([first, second]), whole)
    assert carried.anchor.abs().max() > 1e-6 and carried.slid.abs().max() > 1e-6


def test_a_stable_step_counts_contacts_and_grips():
    # (w dt)^2 + 2 mu dt < 4, mu = 2 z w, bounds what grips alone allow; beside the foam's own stiffness the step is shorter
    rate = 2000.0
    soft, hard = (block(SoftGrip({"grip_rate": r}), hold=lambda h: h[:, 0] < 0.02) for r in (1.0, rate))
    alone = (np.sqrt(0.8**2 + 4) - 0.8) / rate  # z = 0.2: w dt = -2 z + sqrt(4 z^2 + 4)
    assert stable_step(hard) < min(alone, 0.7 * stable_step(soft))
    path = Batch([hard], fps=1 / (0.9 * stable_step(hard)), substeps=1, double=True).rollout(200)
    assert path.diverged[0] < 0 and np.abs(path.positions[0][-1].numpy() - hard.positions).max() < 1e-3


def test_bad_points_are_refused():
    one = block()
    with pytest.raises(ValueError, match="holds must be -1 or one of the 0 controllers"):
        replace(one, points=replace(one.points, holds=np.zeros(len(one.points.holds), int)))
    with pytest.raises(ValueError, match="hands must be numbers >= 0, got -1 at controller 0"):
        replace(one, controllers=np.zeros((2, 1, 3)), grips=[-1], hands=[-1])
    with pytest.raises(ValueError, match="weights must sum to 1"):
        replace(one, points=replace(one.points, weights=2 * one.points.weights))
    with pytest.raises(ValueError, match="masses of points must be >= 0"):
        replace(one, points=replace(one.points, masses=-one.points.masses), masses=one.masses)
    with pytest.raises(ValueError, match="with the term soft_grip must have material points"):
        Batch([replace(one, points=None, terms=(NeoHookean(), SoftGrip()))], fps=30)
    with pytest.raises(ValueError, match="system 1 is unlike system 0"):
        Batch([one, replace(one, points=None)], fps=30)


def test_drag_by_the_particle_counts_points_like_particles():
    # a body law that does not ask for the mass acts at every point alike: said in its docstring, checked here for one
    one = block(AirDrag({"air_drag": 1e-4}))
    one = replace(one, velocities=np.tile([1.0, 0, 0], (one.particle_count, 1)))
    path = middle(one, Batch([one], fps=600, substeps=10, double=True).rollout(3).positions[0])[:, 0]
    count = len(one.points.home)
    slowed = (path[1] - path[0]) - (path[2] - path[1])
    assert slowed == pytest.approx(1e-4 * count / MASS / 600**2, rel=0.02)


@pytest.mark.parametrize(("angle", "stays"), [(20.0, True), (28.0, False)])
def test_friction_is_higher_at_rest_where_it_is_said_to_be(angle, stays):
    # mu 0.2 + 0.25 at rest: tan 20 = 0.36 < 0.45 holds, though 0.36 > 0.2; tan 28 = 0.53 slides, and once it is ten times as fast as the
    # speed over which friction falls, by mu = 0.2 alone: g (sin - mu cos)
    lean = np.deg2rad(angle)
    gravity = dict(zip(("gravity_x", "gravity_y", "gravity_z"), 9.8 * np.array([np.sin(lean), 0, -np.cos(lean)]), strict=True))
    values = {"coulomb_friction": 0.2, "coulomb_rest_friction": 0.25, "coulomb_speed": 0.05, "coulomb_normal_z": 1.0, "coulomb_offset": 0.0}
    one = block(Gravity(gravity), CoulombGround(values), KelvinVoigt({"viscosity": 200.0}))
    path = middle(one, Batch([one], fps=60, double=True).rollout(121).positions[0])
    if stays:
        assert np.abs(path[60:, 0] - path[60, 0]).max() < 2e-5
    else:
        t = np.arange(121) / 60
        found = np.polyfit(t[60:], path[60:, 0], 2)[0] * 2
        assert found == pytest.approx(9.8 * (np.sin(lean) - 0.2 * np.cos(lean)), rel=0.02)


def test_a_ground_lies_elsewhere_for_what_sticks_to_it_too():
    # raised by 5 mm the plane lifts a body that lies on it by as much
    ground = CoulombGround({"coulomb_normal_z": 1.0, "coulomb_offset": 0.0})
    paths = []
    for height in (0.0, 0.005):
        one = block(Gravity({"gravity_z": -9.8}), ground, KelvinVoigt({"viscosity": 200.0}), GroundPose({"ground_raise": height}))
        paths.append(middle(one, Batch([one], fps=60, double=True).rollout(91).positions[0]))
    assert paths[1][-1, 2] - paths[0][-1, 2] == pytest.approx(0.005, abs=5e-5)
