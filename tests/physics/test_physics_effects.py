"""What may be missing from a twin: every effect against a closed form, in float64, and what effects say about themselves.

The step is semi-implicit: v <- v + dt F(x, v) / m, then x <- x + dt v. Where its own solution is known it is matched to rounding.
"""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.physics.batch import Batch
from twinbench.physics.catalogue import terms
from twinbench.physics.system import System
from twinbench.physics.terms import (
    AddedMass,
    AirDrag,
    Anisotropy,
    CompressionSoftening,
    ControllerDelay,
    Gravity,
    GravityTilt,
    GripCompliance,
    GripPoints,
    GroundAdhesion,
    GroundPose,
    HiddenObstacle,
    HiddenTether,
    QuadraticDrag,
    RestShape,
    SecondHand,
    SelfCollision,
    StiffnessField,
    StrainStiffening,
    StribeckGround,
    Wind,
)
from twinbench.physics.terms.directional_ground import DirectionalGround
from twinbench.physics.terms.mass_field import MassField
from twinbench.physics.terms.soft_ground import SoftGround
from twinbench.physics.terms.stages import CELLS, POINTS
from twinbench.physics.terms.stiffness_level import StiffnessLevel
from twinbench.physics.trials import STILL, TABLE, G, body, run, thrown

ROUNDING = 1e-11  # at most 1e4 steps of numbers of order 1, each rounded by 2^-53 = 1.1e-16, with a margin for their summation
SETTLED = 1e-9  # where motion decays as exp(-t / tau) for more than 25 tau: e^-25 = 1e-11 of the way there
EFFECTS = [term for term in terms().values() if term.effect]


def steps(system, dt, count):
    """Positions (count + 1, M, 3) after every single step of ``dt``."""
    return Batch([system], fps=1 / dt, substeps=1, dt=dt, double=True, workers=1).rollout(count + 1).positions[0].numpy()


def end(system, dt, count):
    """(x, v) after ``count`` steps, particles only."""
    _, x, v = Batch([system], fps=1 / (count * dt), substeps=count, dt=dt, double=True, workers=1).march(0, 1)
    return x.numpy()[: system.particle_count], v.numpy()[: system.particle_count]


def prepared(system, **options):
    """What the system is made of once its setup terms have had their say."""
    batch = Batch([system], **{**dict(fps=30, substeps=1, double=True, workers=1), **options})
    return batch.prepare(batch.inputs)


def hanging(*extra, length=0.5, stiffness=30.0, mass=1.0, direction=(0, 0, -1), **values):
    """A mass on a spring of the body, the other end of which a still hand holds at the origin."""
    x = length * np.asarray(direction, float)
    springs = dict(springs=[[0, 1]], stiffness=[stiffness])
    return body([np.zeros(3), x], *extra, masses=[1.0, mass], controllers=np.zeros((1, 1, 3)), grips=[0], **springs, **values)


def rest_place(system, *, dt=1e-3, seconds=20.0, settle=4.0):
    """Where the last particle comes to rest: all motion decays at least at the rate of drag / 2, here exp(-40)."""
    return end(system.with_values(drag_damping=settle), dt, round(seconds / dt))[0][-1]


# ---------------------------------------------------------------- air and gravity


def test_air_drag_slows_what_is_light_and_less_what_is_heavy():
    # m dv/dt = -c v by the step v <- v (1 - c dt / m): v_n = v0 (1 - c dt / m)^n
    c, dt, n, masses = 2.0, 1e-3, 500, np.array([0.5, 4.0])
    _, v = end(body(np.zeros((2, 3)), AirDrag, masses=masses, velocities=np.full((2, 3), [3.0, 0, -1.0]), air_drag=c), dt, n)
    np.testing.assert_allclose(v, [3.0, 0, -1.0] * ((1 - c * dt / masses) ** n)[:, None], rtol=1e-12)


def test_quadratic_drag_slows_as_the_drag_equation_says():
    # dv/dt = -c v^2: v = v0 / (1 + c v0 t), which the step solves exactly, so at any dt
    c, v0, dt, n = 0.7, np.array([3.0, -4.0, 0.0]), 0.01, 200
    _, v = end(body([0, 0, 0], QuadraticDrag, velocities=v0, quadratic_drag=c), dt, n)
    np.testing.assert_allclose(v[0], v0 / (1 + c * 5 * n * dt), rtol=0, atol=ROUNDING)


def test_quadratic_drag_has_a_terminal_velocity():
    # c v^2 = g; after a push and then drag, w = v + g dt and v = w / (1 + c dt w), so c v^2 + c g dt v = g. It settles at 4/s
    c, dt = 0.4, 0.01
    _, v = end(body([0, 0, 0], QuadraticDrag, gravity_z=-G, quadratic_drag=c), dt, 2000)
    assert -v[0, 2] == pytest.approx((-c * G * dt + np.sqrt((c * G * dt) ** 2 + 4 * c * G)) / (2 * c), abs=ROUNDING)
    assert -v[0, 2] == pytest.approx(np.sqrt(G / c), rel=np.sqrt(c * G) * dt)


def test_quadratic_drag_never_turns_a_particle_around():
    # the force -c v^2 over dt would: c dt v = 200
    _, v = end(body([0, 0, 0], QuadraticDrag, velocities=[1000.0, 0, 0], quadratic_drag=20.0), 0.01, 1)
    assert v[0, 0] == pytest.approx(1000 / 201, rel=1e-14)


def test_wind_takes_a_particle_along():
    # from rest: v = W - s with ds/dt = -(q / W^2) s^2, s(0) = W, so s = W / (1 + q t / W). First order in dt; CALM / q = 1e-3
    q, speed, dt, n = np.array([0.6, -0.8, 0.0]), 2.0, 1e-3, 4000
    values = dict(wind_x=q[0], wind_y=q[1], wind_speed=speed)
    _, v = end(body([0, 0, 0], Wind, masses=[3.0], **values), dt, n)
    np.testing.assert_allclose(v[0], q * (speed - speed / (1 + n * dt / speed)), rtol=0, atol=2e-3)
    np.testing.assert_allclose(end(body([0, 0, 0], Wind, **values), dt, 1)[1][0], q * dt, rtol=1e-12)  # at rest it pulls with q
    # who moves with the wind already, is not pulled; against it, four times as much as at rest: |1 + 1|^2
    for sign, pull in ((1, 0.0), (-1, 4.0)):
        _, v = end(body([0, 0, 0], Wind, velocities=sign * speed * q, **values), dt, 1)
        np.testing.assert_allclose(v[0] - sign * speed * q, pull * q * dt, rtol=0, atol=3e-3 * dt)


def test_a_pendulum_rests_along_tilted_gravity():
    # g + t along the thread, stretched by Y e = m |g + t|
    tilt = np.array([2.0, -1.0, 0.5])
    system = hanging(GravityTilt, mass=2.0, stiffness=300.0, gravity_z=-G, tilt_x=tilt[0], tilt_y=tilt[1], tilt_z=tilt[2])
    pull = tilt - [0, 0, G]
    size = np.linalg.norm(pull)
    np.testing.assert_allclose(rest_place(system), pull / size * 0.5 * (1 + 2.0 * size / 300), rtol=0, atol=SETTLED)


@pytest.mark.parametrize("along", [0.0, 3.0])
def test_tilted_gravity_is_as_strong_as_the_one_that_is_told(along):
    # thread along g' = g (sin a, 0, -cos a), stretched by Y e = m g, whatever t has along g
    sine = 0.3
    told = dict(gravity_z=-G, told_gravity_z=-G, tilt_x=sine * G, tilt_z=along)
    place = rest_place(hanging(GravityTilt, mass=2.0, stiffness=300.0, **told))
    wanted = 0.5 * (1 + 2.0 * G / 300) * np.array([sine, 0, -np.sqrt(1 - sine**2)])
    np.testing.assert_allclose(place, wanted, rtol=0, atol=SETTLED)


# ---------------------------------------------------------------- springs


@pytest.mark.parametrize("b", [0.0, 5.0, 50.0])
def test_a_stiffening_spring_under_load(b):
    # Y (e + b e^3) = m g has one real root
    system = hanging(StrainStiffening, stiffness=30.0, gravity_z=-G, dashpot_damping=2.0, strain_stiffening=b)
    roots = np.roots([b, 0, 1, -G / 30]) if b else np.array([G / 30])
    strain = roots[np.abs(roots.imag) < 1e-9].real.max()
    assert rest_place(system)[2] == pytest.approx(-0.5 * (1 + strain), abs=SETTLED)


def test_stiffening_is_odd():
    # pushed and pulled alike: a mass below its spring and one on it move the same way by the same amount
    values = dict(stiffness=30.0, dashpot_damping=2.0, strain_stiffening=20.0)
    below = rest_place(hanging(StrainStiffening, gravity_z=-G, **values))[2] + 0.5
    above = rest_place(hanging(StrainStiffening, gravity_z=-G, direction=(0, 0, 1), **values))[2] - 0.5
    assert above == pytest.approx(below, abs=SETTLED) and below < -0.05


@pytest.mark.parametrize(("direction", "share"), [(-1, 1.0), (1, 0.4)])
def test_a_softer_spring_in_compression(direction, share):
    # Y e = -m g below, (1 - a) Y e = -m g on top of it: |e| = 0.1 or more at a width of 1e-3, so the other modulus counts by e^-100
    values = dict(stiffness=98.0, gravity_z=-G, dashpot_damping=2.0, compression_softening=0.6, compression_width=1e-3)
    z = rest_place(hanging(CompressionSoftening, direction=(0, 0, direction), **values))[2]
    assert z == pytest.approx(0.5 * (direction - G / (share * 98)), abs=SETTLED)


# ---------------------------------------------------------------- what a body is made of


def test_a_heavier_end_swings_slower():
    # w^2 = Y / (L0 m (1 + a)); the step's solution from rest is x_n = A cos((n + 1/2) th) / cos(th / 2) with th = 2 asin(w dt / 2)
    a, mass, stiffness, dt, n = 1.5, 2.0, 30.0, 1e-3, 3000
    place = dict(added_mass_x=0.6, added_mass_within=0.03)  # 0.6 m = 20 reaches from the held end
    place["added_mass"] = a * mass / (1 + mass)  # the held end has a mass of 1
    system = hanging(AddedMass, length=0.6, mass=mass, stiffness=stiffness, rest=[0.5], direction=(1, 0, 0), **place)
    theta = 2 * np.arcsin(np.sqrt(stiffness / (0.5 * mass * (1 + a))) * dt / 2)
    x = steps(system, dt, n)[:, 1, 0] - 0.5
    np.testing.assert_allclose(x, 0.1 * np.cos((np.arange(n + 1) + 0.5) * theta) / np.cos(theta / 2), rtol=0, atol=ROUNDING)


def test_added_mass_weighs_and_is_where_it_is_said_to_be():
    # Y e = (m + a M) g, M = 2 m with the held end; a M is shared out by own mass and nearness: exp(-1/2) at r, next to nothing far away
    z = rest_place(hanging(AddedMass, stiffness=98.0, gravity_z=-G, added_mass=1.0, added_mass_z=-0.5, added_mass_within=0.02))[2]
    assert z == pytest.approx(-0.5 * (1 + 3 * G / 98), abs=SETTLED)
    x = [[0, 0, 0], [0.1, 0, 0], [0, 0, 5.0]]
    mass = prepared(body(x, AddedMass, masses=[1, 2, 3], added_mass=0.5, added_mass_within=0.1)).mass
    share = np.array([1, 2 * np.exp(-0.5), 0])
    np.testing.assert_allclose(mass, [1, 2, 3] + 0.5 * 6 * share / share.sum(), rtol=1e-14)
    mass = prepared(body(x, AddedMass, masses=[1, 2, 3], added_mass=0.5, added_mass_within=0.001, added_mass_z=9.0)).mass
    np.testing.assert_allclose(mass, [1, 2, 6], rtol=1e-14)  # 4 m and 4000 reaches from the nearest, which takes all


def test_anisotropy_by_direction():
    # ln(Y'/Y) = d.A d; the average over all directions of a traceless form is 0
    xx, yy, xy, yz, xz = 0.4, -0.1, 0.3, 0.2, -0.5
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, -xx - yy]])
    d = np.random.default_rng(0).normal(size=(50, 3))
    d = np.concatenate([d, np.eye(3)]) * 0.3
    values = dict(anisotropy_xx=xx, anisotropy_yy=yy, anisotropy_xy=xy, anisotropy_yz=yz, anisotropy_xz=xz)
    springs, hand = [[0, k + 1] for k in range(len(d))], [[len(d) + 1, 0]]
    stiff = np.full(len(d) + 1, 7.0)
    system = body([[0, 0, 0], *d], Anisotropy, springs=springs + hand, stiffness=stiff, controllers=[[[1.0, 0, 0]]], **values)
    level = np.log(prepared(system).stiffness.numpy() / 7)
    n = d / np.linalg.norm(d, axis=1, keepdims=True)
    np.testing.assert_allclose(level[:-1], np.einsum("si,ij,sj->s", n, tensor, n), rtol=0, atol=1e-14)
    assert level[-1] == 0 and level[-4:-1].sum() == pytest.approx(0, abs=1e-14)  # the hand's spring; x + y + z


def test_a_body_under_strain_relaxes_to_its_rest_shape():
    # all rest lengths grow by e^s, so a free body ends similar to itself: every distance e^s times what it was
    x = np.random.default_rng(1).random((5, 3))
    springs = np.argwhere(np.triu(np.ones((5, 5)), 1))
    system = body(x, RestShape, springs=springs, stiffness=np.full(10, 20.0), rest_scale=0.1, drag_damping=4.0, dashpot_damping=1.0)
    found, _ = end(system, 2e-3, 10000)
    before, after = (np.linalg.norm(p[springs[:, 0]] - p[springs[:, 1]], axis=1) for p in (x, found))
    np.testing.assert_allclose(after, np.exp(0.1) * before, rtol=1e-7)


def test_a_gradient_of_strain_bends_a_strip():
    # strain g z / R across a strip is that of a bend of curvature g / R, without stress (Timoshenko's bimetal, graded): along x the upper
    # edge grows and the lower shrinks, so it turns down at both ends. Exact for fine cells: exp(k z) differs from 1 + k z by (k h)^2 / 8
    n, h, g = 21, 0.05, 0.4
    x = np.array([[h * i, 0.0, h * j] for i in range(n) for j in range(2)])
    springs = [[2 * i, 2 * i + 1] for i in range(n)] + [[2 * i + a, 2 * i + 2 + b] for i in range(n - 1) for a in (0, 1) for b in (0, 1)]
    system = body(
        x, RestShape, springs=springs, stiffness=np.full(len(springs), 100.0), rest_gradient_z=g, drag_damping=3.0, dashpot_damping=1.0
    )
    radius = np.sqrt(((x - x.mean(0)) ** 2).sum(1).mean())
    found = end(system, 1e-3, 20000)[0].reshape(n, 2, 3)
    np.testing.assert_allclose(found[..., 1], 0, atol=1e-12)
    middle = found.mean(1)
    along = np.diff(middle, axis=0)
    turn = np.diff(np.unwrap(np.arctan2(along[:, 2], along[:, 0])))
    length = np.linalg.norm(along, axis=1)
    curvature = turn / ((length[1:] + length[:-1]) / 2)
    np.testing.assert_allclose(curvature, -g / radius, rtol=0.01)


def boxed():
    """(72, 3) m a box about the origin, longest along x, and the axes that turn it: each points where its largest component is positive."""
    turned = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turned *= np.sign(turned[np.abs(turned).argmax(0), range(3)])
    box = np.array([[i, j, k] for i in range(6) for j in range(4) for k in range(3)]) * [1.0, 0.6, 0.3]
    return box - box.mean(0), turned


def test_the_stiffness_field_follows_the_principal_axes():
    # a box with its axes turned: u = (distance along axis k) / (rms extent), and ln(Y'/Y) is the sum of the modes that are switched on
    box, turned = boxed()
    springs = np.array([[i, i + 1] for i in range(len(box) - 1)])
    modes = dict(slope_a=0.3, slope_b=-0.2, slope_c=0.1, bow_a=0.25, bow_b=-0.15, saddle=0.05)
    values = {f"stiffness_{name}": value for name, value in modes.items()}
    system = body(box @ turned.T + 3.0, StiffnessField, springs=springs, stiffness=np.full(len(springs), 2.0), **values)
    a, b, c = (box[springs].mean(1) / box.std(0)).T
    expected = 0.3 * a - 0.2 * b + 0.1 * c + 0.25 * (a * a - 1) / 2 - 0.15 * (b * b - 1) / 2 + 0.05 * a * b
    np.testing.assert_allclose(np.log(prepared(system).stiffness.numpy() / 2), expected, rtol=0, atol=1e-12)


def test_the_mass_field_follows_the_principal_axes_and_adds_nothing():
    # as above, ln(m'/m) is the sum of the modes, up to what keeps the total; a hand's node, whatever stands for its mass, is left alone
    box, turned = boxed()
    modes = dict(zip((p.name for p in MassField.parameters), (0.3, -0.2, 0.1, 0.25, -0.15), strict=True))
    masses = np.random.default_rng(3).uniform(0.5, 2.0, len(box))
    system = body(box @ turned.T + 3.0, MassField, masses=masses, controllers=np.zeros((1, 1, 3)), **modes)
    a, b, c = (box / box.std(0)).T
    uneven = masses * np.exp(0.3 * a - 0.2 * b + 0.1 * c + 0.25 * (a * a - 1) / 2 - 0.15 * (b * b - 1) / 2)
    found, before = prepared(system).mass.numpy(), prepared(system.with_values(**dict.fromkeys(modes, 0.0))).mass.numpy()
    np.testing.assert_allclose(found[: len(box)], uneven * masses.sum() / uneven.sum(), rtol=0, atol=1e-12)
    assert np.array_equal(before[: len(box)], masses) and np.array_equal(found[len(box) :], before[len(box) :])


def test_stiffness_levels_are_of_the_body_and_of_its_grips():
    # nodes 3 and 4 are hands; a particle that a hand grips is the body's own
    springs = dict(springs=[[0, 1], [3, 1], [2, 1]], stiffness=[2.0, 3.0, 5.0], controllers=np.zeros((1, 2, 3)), grips=[-1, 2])
    system = body(np.eye(3), StiffnessLevel, **springs, body_stiffness=10.0, grip_stiffness=0.5)
    assert prepared(system).stiffness.tolist() == [20.0, 1.5, 50.0]


# ---------------------------------------------------------------- the ground


def test_adhesion_takes_its_force_to_lift():
    # on the table it holds against up to a per mass: pulled up by less, a particle stays; by more, it leaves
    for pull, leaves in ((4.95, False), (5.05, True)):
        plane = dict(adhesion_normal_z=1.0, ground_adhesion=5.0, adhesion_reach=0.02, collide_elas=0.0)
        x, _ = end(body([0, 0, 0], GroundAdhesion, gravity_z=pull, **plane, **TABLE), 1e-4, 20000)
        assert (x[0, 2] > 0.02) if leaves else (abs(x[0, 2]) < 1e-6)


def test_adhesion_takes_its_work_to_lift():
    # thrown off the plane: v^2 = v0^2 - 2 W, W = a r int_0^1 (1 - s^2)^2 ds = 8 a r / 15 per mass; energy is kept to first order in dt
    a, r, v0, dt = 6.0, 0.05, 1.0, 1e-5
    plane = dict(adhesion_normal_z=1.0, ground_adhesion=a, adhesion_reach=r)
    x, v = end(body([0, 0, 0], GroundAdhesion, velocities=[0, 0, v0], **plane), dt, 10000)
    assert x[0, 2] > r and v[0, 2] == pytest.approx(np.sqrt(v0**2 - 16 * a * r / 15), abs=a * dt)
    x, v = end(body([0, 0, 0], GroundAdhesion, velocities=[0, 0, 0.99 * np.sqrt(16 * a * r / 15)], **plane), dt, 20000)
    assert x[0, 2] < r  # a little less does not get away


def slope(degrees, **values):
    """A particle on a slope that rises along x, its kinetic friction 0.2: (system, unit vector down the slope)."""
    a = np.radians(degrees)
    normal = dict(ground_normal_x=np.sin(a), ground_normal_z=np.cos(a), ground_offset=0.0)
    start = dict(velocities=values.pop("speed", 0.0) * np.array([np.cos(a), 0, -np.sin(a)]))
    common = dict(gravity_z=-G, collide_elas=0.0, collide_fric=0.2, friction_speed=0.05)
    return body([0, 0, 0], StribeckGround, **start, **{**common, **normal, **values}), np.array([np.cos(a), 0, -np.sin(a)])


def test_static_friction_holds_up_to_its_angle():
    # holds while tan(angle) < mu_k + a = 0.6, tan(31 degrees); kinetic friction alone would slide from tan(11.3 degrees) = 0.2 on.
    # A step of 1e-4 s starts at g dt = 1e-3 m/s before friction stops it, which lowers mu by (1e-3 / 0.05)^2 of a: 2e-4
    for degrees, holds in ((20, True), (30.5, True), (31.5, False)):
        system, down = slope(degrees, friction_excess=0.4)
        x, v = end(system, 1e-4, 20000)
        assert (np.abs(x).max() < 1e-6) if holds else (v[0] @ down > 0.5)


def test_kinetic_friction_once_it_slides():
    # at 1 m/s = 20 friction speeds the excess is gone: v = v0 + g (sin - mu_k cos) t down a slope of 20 degrees on which it would rest
    system, down = slope(20, friction_excess=0.4, speed=1.0)
    _, v = end(system, 1e-4, 5000)
    a = np.radians(20)
    np.testing.assert_allclose(v[0], (1 + G * (np.sin(a) - 0.2 * np.cos(a)) * 0.5) * down, rtol=0, atol=1e-9)


@pytest.mark.parametrize("speeds", [0.3, 1.0, 2.0])
def test_friction_falls_with_slip(speeds):
    # on a level table the normal impulse of a step is m g dt, and friction takes mu(v) g dt: mu = mu_k + a exp(-(v / v_s)^2)
    dt, v0 = 1e-4, speeds * 0.05
    system, along = slope(0, friction_excess=0.4, speed=v0)
    _, v = end(system, dt, 1)
    np.testing.assert_allclose(v[0] - v0 * along, -(0.2 + 0.4 * np.exp(-(speeds**2))) * G * dt * along, rtol=0, atol=1e-14)


def test_without_excess_it_is_the_plain_ground_bit_for_bit():
    rng = np.random.default_rng(3)
    x, v = rng.normal(size=(40, 3)), rng.normal(size=(40, 3)) * 2
    values = dict(gravity_z=-G, **TABLE, collide_elas=0.6, collide_fric=0.4)
    plain, stribeck = (steps(body(np.abs(x), *extra, velocities=v, **values), 1e-3, 1000) for extra in ((), (StribeckGround,)))
    assert (plain[-1, :, 2] < 0.5).any() and np.array_equal(plain, stribeck)


@pytest.mark.parametrize("heading", [0.0, 0.5, 1.7, -2.2])
def test_friction_by_direction(heading):
    # on a level table the normal impulse of a step is m g dt, and friction takes mu(phi) g dt: mu = 0.3 + a cos 2 phi + b sin 2 phi
    dt, along = 1e-4, np.array([np.cos(heading), np.sin(heading), 0.0])
    values = dict(gravity_z=-G, **TABLE, collide_elas=0.0, collide_fric=0.3, friction_along=0.2, friction_diagonal=-0.1)
    _, v = end(body([0, 0, 0], DirectionalGround, velocities=0.5 * along, **values), dt, 1)
    mu = 0.3 + 0.2 * np.cos(2 * heading) - 0.1 * np.sin(2 * heading)
    np.testing.assert_allclose(v[0], (0.5 - mu * G * dt) * along, rtol=0, atol=1e-14)


def test_without_direction_or_pad_it_is_the_plain_ground_bit_for_bit():
    rng = np.random.default_rng(3)
    x, v = rng.normal(size=(40, 3)), rng.normal(size=(40, 3)) * 2
    values = dict(gravity_z=-G, **TABLE, collide_elas=0.6, collide_fric=0.4)
    plain = steps(body(np.abs(x), velocities=v, **values), 1e-3, 1000)
    for term in (DirectionalGround, SoftGround):
        assert np.array_equal(plain, steps(body(np.abs(x), term, velocities=v, **values), 1e-3, 1000))


def test_a_body_sinks_into_a_soft_ground_by_its_weight():
    # K s = g: s = g / K of the pad's thickness. Restitution 0 and a step of 1e-3 s: a bounce of the pad's own pace sqrt(K / d) dies out by
    # drag, as exp(-2 t)
    pad, firm = 0.02, 40.0
    values = dict(gravity_z=-G, **TABLE, collide_elas=0.0, drag_damping=4.0, ground_pad=pad, ground_firm=firm)
    x, _ = end(body([0, 0, 0.01], SoftGround, **values), 1e-3, 20000)
    assert x[0, 2] == pytest.approx(-pad * G * np.exp(-4.0 * 1e-3) / firm, abs=1e-9)  # drag takes its share of g dt before the push does


def test_a_soft_ground_rubs_with_its_push_and_is_hard_below():
    pad, firm, dt = 0.02, 40.0, 1e-4
    values = dict(**TABLE, collide_elas=0.0, collide_fric=0.3, ground_pad=pad, ground_firm=firm)
    # pressed to a half: it pushes by K / 2 and rubs with mu of that
    _, v = end(body([0, 0, -pad / 2], SoftGround, velocities=[1.0, 0, 0], **values), dt, 1)
    np.testing.assert_allclose(v[0], [1 - 0.3 * firm / 2 * dt, 0, firm / 2 * dt], rtol=0, atol=1e-14)
    # thrown down at 3 m/s, of which it takes 2 K d / 2 = 0.8 of 9 m^2/s^2: it reaches the hard plane, and no further but for a step
    x, _ = end(body([0, 0, 0], SoftGround, velocities=[0, 0, -3.0], **values), dt, 100)
    assert -pad - 1e-12 < x[0, 2] < -pad + 5e-3


@pytest.mark.parametrize(("a", "b"), [(0.3, 0.0), (0.0, -0.2), (0.2, 0.3)])
def test_a_ground_that_lies_elsewhere(a, b):
    # n = z, so the first axis least along it is x, and z x x = y: n' = (sin a, cos a sin b, cos a cos b). The plane turns about the point
    # below the body's middle and then rises by h along n'. Particles fall onto a plane put there by hand in the same way
    rng = np.random.default_rng(4)
    x = rng.random((30, 3)) + [2.0, -1.0, 0.3]
    n = np.array([np.sin(a), np.cos(a) * np.sin(b), np.cos(a) * np.cos(b)])
    foot = np.array([*x.mean(0)[:2], 0.1])
    by_hand = dict(zip(("ground_normal_x", "ground_normal_y", "ground_normal_z"), n, strict=True)) | dict(ground_offset=n @ foot + 0.05)
    given = dict(gravity_z=-G, ground_normal_z=1.0, ground_offset=0.1, ground_raise=0.05, ground_tilt_a=a, ground_tilt_b=b)
    found, expected = steps(body(x, GroundPose, **given), 1e-3, 600), steps(body(x, gravity_z=-G, **by_hand), 1e-3, 600)
    assert (np.diff(expected[:, :, 2], axis=0) > 0).any()  # some bounced
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)  # bounces amplify rounding


def test_adhesion_goes_where_the_ground_goes():
    plane = dict(adhesion_normal_z=1.0, ground_raise=0.1, ground_tilt_a=0.2, **TABLE)
    system = body([[1.0, 2.0, 0.5]], GroundAdhesion, GroundPose, **plane)
    row = dict(zip(Batch([system], fps=30, substeps=1).columns, prepared(system).table[0].tolist(), strict=True))
    for name in ("normal_x", "normal_y", "normal_z", "offset"):
        assert row[f"adhesion_{name}"] == row[f"ground_{name}"]
    assert row["ground_offset"] == pytest.approx(np.sin(0.2) + 0.1, abs=1e-15)  # below (1, 2, 0.5): n' . (1, 2, 0) = sin(a)


def test_a_ground_pose_needs_a_ground():
    system = System(positions=[[0, 0, 0]], springs=np.zeros((0, 2), int), stiffness=[], controllers=STILL, terms=[Gravity(), GroundPose()])
    with pytest.raises(ValueError, match="no term of this batch has a parameter 'ground_normal_x'"):
        prepared(system)


# ---------------------------------------------------------------- what the recording does not list


def test_a_body_rests_on_an_obstacle():
    # k d^2 / (d + s) = g at rest on top, s = 2 mm: d = (g + sqrt(g^2 + 4 k g s)) / 2k
    k = 2000.0
    values = dict(hidden_obstacle=k, obstacle_radius=0.1, obstacle_z=-0.3)
    depth = (G + np.sqrt(G * G + 4 * k * G * 0.002)) / (2 * k)
    x = rest_place(body([0, 0, 0], HiddenObstacle, gravity_z=-G, **values))
    np.testing.assert_allclose(x, [0, 0, -0.2 - depth], rtol=0, atol=SETTLED)


def test_an_obstacle_stops_and_takes_energy():
    # Hunt and Crossley: dv/dt = P(d) (1 - v / v_r), so v dv / (1 - v / v_r) = -P dd depends on the depth alone, and its integral from -u to
    # 0 on the way in is minus that from 0 to e on the way out: u - v_r ln(1 + u / v_r) = -e - v_r ln(1 - e / v_r)
    from scipy.optimize import brentq

    u, recoil = 1.0, 0.5
    values = dict(hidden_obstacle=2e4, obstacle_radius=0.1, obstacle_x=-0.2)
    x, v = end(body([0, 0, 0], HiddenObstacle, velocities=[-u, 0, 0], **values), 1e-5, 40000)
    leave = brentq(lambda e: -e - recoil * np.log(1 - e / recoil) - u + recoil * np.log(1 + u / recoil), 0.0, recoil * (1 - 1e-12))
    assert v[0, 0] == pytest.approx(leave, rel=1e-3)  # first order in dt: w dt = 1e-3 with w^2 = k
    assert x[0, 0] > -0.1
    _, v = end(body([0, 0.11, 0], HiddenObstacle, velocities=[-u, 0, 0], **values), 1e-3, 1000)
    assert v[0].tolist() == [-u, 0, 0]  # passing by at 11 cm, it is not touched


def test_an_obstacle_rubs():
    # at 2 m/s across, where a wall (a sphere of 1 m, 10 mm deep) pushes with P = k d^2 / (d + s): dv_t/dt = -mu P / sqrt(1 +
    # (v_c / v_t)^2). One step from there is the law itself; 1e-8 is its rounding, 1e-16 of 2 m/s over dt
    deep, k, dt = 0.01, 2000.0, 1e-6
    values = dict(hidden_obstacle=k, obstacle_radius=1.0, obstacle_z=-1.0 + deep)
    _, v = end(body([0, 0, 0], HiddenObstacle, velocities=[2.0, 0, 0], **values), dt, 1)
    push = k * deep**2 / (deep + 0.002)
    np.testing.assert_allclose((v[0] - [2, 0, 0]) / dt, [-0.3 * push / np.sqrt(1 + (0.05 / 2) ** 2), 0, push], rtol=1e-8, atol=1e-8)


def test_a_tether_holds_its_patch():
    # m k w (|y - x| - L) = m g: hangs L + g / (k w) below the anchor, w = exp(-1/2) at one reach from the middle of the patch; what is far
    # away falls
    k, length, anchor, at = 100.0, 0.07, np.array([0.3, -0.2, 1.0]), np.array([0.05, 0, 0])
    values = dict(hidden_tether=k, tether_within=0.05, tether_anchor_x=anchor[0], tether_anchor_y=anchor[1], tether_anchor_z=anchor[2])
    values |= dict(tether_length=length)
    x = rest_place(body(at, HiddenTether, masses=[2.0], gravity_z=-G, **values))
    np.testing.assert_allclose(x, anchor - [0, 0, length + G / (k * np.exp(-0.5))], rtol=0, atol=SETTLED)
    far = body([5.0, 0, 0], HiddenTether, gravity_z=-G, **values)
    np.testing.assert_allclose(end(far, 1e-3, 1000)[1][0], [0, 0, -G], rtol=0, atol=ROUNDING)
    slack = body(anchor - [0, 0, 0.9 * length], HiddenTether, gravity_z=-G, **values | dict(tether_within=10.0))
    np.testing.assert_allclose(end(slack, 1e-6, 1)[1][0], [0, 0, -G * 1e-6], rtol=1e-12)


def test_a_second_hand_carries_its_patch_along_what_was_seen():
    # y = y0 + u t: the particle goes with it, g / b below; the other one, 20 reaches away, is left alone. With t = 0.1 s, b = 400 / s^2 the
    # motion about it is critically damped at 20 / s
    b, frames, fps = 400.0, 61, 30
    x, u = np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.array([0.5, -0.3, 0.2])
    seen = x + (np.arange(frames) / fps)[:, None, None] * u
    values = dict(second_hand=b, second_hand_within=0.05, second_hand_lead=0.1, gravity_z=-G)
    system = body(x, SecondHand, seen=seen, controllers=np.zeros((frames, 0, 3)), velocities=[u, [0, 0, 0]], **values)
    out = Batch([system], fps=fps, substeps=100, double=True, workers=1).rollout(frames).positions[0].numpy()
    np.testing.assert_allclose(out[-1, 0], seen[-1, 0] - [0, 0, G / b], rtol=0, atol=SETTLED)
    t, dt = (frames - 1) / fps, 1 / 3000
    np.testing.assert_allclose(out[-1, 1], [1, 0, -G * t * (t + dt) / 2], rtol=0, atol=1e-10)


# ---------------------------------------------------------------- hands


@pytest.mark.parametrize(("substeps", "tau"), [(10, 0.05), (40, 0.05), (10, -0.07), (10, 0.2), (10, 1 / 30)])
def test_a_delayed_path_is_shifted(substeps, tau):
    # a hand that moves at constant speed: path(t - tau) is exact under linear interpolation, held before the first and after the last frame
    t = np.arange(12) / 30
    start, speed = np.array([[0.1, 0.2, 0.3], [1.0, 0.0, 0.0]]), np.array([[0.5, 0.0, -0.2], [0.0, 0.3, 0.0]])
    path = start + t[:, None, None] * speed
    system = body([[0, 0, 0], [1.0, 0.5, 0]], ControllerDelay, controllers=path, grips=[-1, 1], controller_delay=tau)
    found = prepared(system, substeps=substeps).path
    shift = np.clip(t - tau, 0, t[-1])[:, None, None] * speed
    np.testing.assert_allclose(
        found, start + [[0, 0, 0], [0, 0.5, 0]] + shift, rtol=0, atol=1e-14
    )  # a grip carries its particle where it found it
    out = Batch([system], fps=30, substeps=substeps, double=True).rollout(12).positions[0]
    np.testing.assert_allclose(out[1:, 1], found[1:, 1], rtol=0, atol=1e-14)


def test_each_system_has_a_delay_of_its_own():
    path = (np.arange(8) / 30)[:, None, None] * np.ones(3)
    systems = [body([0, 0, 0], ControllerDelay, controllers=path, controller_delay=tau) for tau in (0.0, 0.05)]
    batch = Batch(systems, fps=30, substeps=4, double=True)
    found = batch.prepare(batch.inputs).path.numpy()
    assert np.array_equal(found[:, 0], path[:, 0])
    np.testing.assert_allclose(found[:, 1, 0], np.maximum(0, np.arange(8) / 30 - 0.05), rtol=0, atol=1e-15)


def test_a_hand_that_was_elsewhere_holds_the_body_elsewhere():
    # rest lengths |c + s - x0| from hands at c are met at x0 - s, and by four hands around it nowhere else
    hands, shift = np.array([[0.2, 0, -0.1], [-0.1, 0.2, -0.1], [-0.1, -0.2, -0.1], [0, 0, 0.25]]), np.array([0.02, -0.01, 0.015])
    values = dict(zip(("grip_shift_x", "grip_shift_y", "grip_shift_z"), shift, strict=True))
    springs = dict(springs=[[1 + k, 0] for k in range(4)], stiffness=np.full(4, 50.0))
    system = body([0.01, 0.02, 0.0], GripPoints, controllers=hands[None], **springs, **values)
    np.testing.assert_allclose(rest_place(system), [0.01, 0.02, 0] - shift, rtol=0, atol=SETTLED)


def test_a_softer_hold_sags_further():
    # Y e^-c e = m g for the hand's spring, Y e = m g for the body's own
    stiff = dict(stiffness=[98.0, 98.0], gravity_z=-G, dashpot_damping=2.0)
    x = [[0, 0, -0.5], [1.0, 0, -0.5], [1.0, 0, 0]]
    hands = dict(controllers=[[[0, 0, 0], [1.0, 0, 0]]], grips=[-1, 2])
    system = body(x, GripCompliance, springs=[[3, 0], [2, 1]], grip_compliance=1.2, **stiff, **hands)
    found, _ = end(system.with_values(drag_damping=2.0), 1e-3, 30000)
    np.testing.assert_allclose(found[:2, 2], [-0.5 * (1 + np.exp(1.2) * G / 98), -0.5 * (1 + G / 98)], rtol=0, atol=SETTLED)


# ---------------------------------------------------------------- what effects say about themselves


# fmt: off
KNOWN = {
    "quadratic_drag", "plate_drag", "wind", "gravity_tilt", "strain_stiffening", "compression_softening", "anisotropy", "bending",
    "bending_damping", "torsion", "plasticity", "creep", "viscoelastic", "internal_friction", "added_mass", "pressure",
    "friction_law", "ground_adhesion", "hidden_obstacle", "ground_pose", "self_contact", "hidden_tether", "grip_slip",
    "grip_compliance", "tearing", "stiffness_patch", "rest_shape", "controller_delay", "camera_pose", "track_drift", "grip_points",
}
# fmt: on


def test_effects_have_names_that_are_known():
    # what each effect does is tested in test_terms_conformance.py
    assert {term.effect.name for term in EFFECTS} <= KNOWN


def test_all_effects_at_once():
    # any two may be combined, in one list and with uneven stiffness: of no size they change nothing, at a tenth of the typical one all act
    kinds = [t for t in EFFECTS if t is not SelfCollision and t.stage != "move" and t.stage not in (*CELLS, *POINTS)] + [StiffnessField]
    plain = thrown(GravityTilt, None, roped=True)
    together = replace(plain, terms=[*plain.terms, *(k() for k in kinds)]).with_values(adhesion_normal_z=1.0)
    typical = {name: 0.1 * value for k in kinds if k.effect for name, value in k.effect.typical.items()}
    systems = [together, together.with_values(**typical)]
    none, some = (p.numpy() for p in Batch(systems, fps=30, substeps=60, double=True, workers=1).rollout().positions)
    np.testing.assert_allclose(none, run(GravityTilt, None, roped=True), rtol=0, atol=1e-11)
    assert np.isfinite(some).all() and np.abs(some - none).max() > 1e-3
