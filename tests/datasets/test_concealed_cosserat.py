"""PyElastica's rods in the concealed set against closed forms of beams, chains, shafts and friction, and against the finite elements."""

import sys
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import probes
import pytest
from probes import cord, watch
from twinbench.datasets.concealed import bodies, cosserat, finite, laws, motions
from twinbench.datasets.concealed.case import build, rms
from twinbench.datasets.concealed.cosserat import World, march, simulate
from twinbench.datasets.concealed.effects import EFFECTS, OUTSIDE
from twinbench.datasets.concealed.engines import able
from twinbench.datasets.concealed.motions import Script
from twinbench.datasets.concealed.world import Obstacle, Physics, Unstable
from twinbench.datasets.synthetic.simulate import GRAVITY

pytest.importorskip("elastica", reason="PyElastica is not installed: pip install 'pyelastica>=1'")
pytestmark = pytest.mark.long  # its first run compiles for a minute

NOWHERE = Physics(gravity=(0.0, 0.0, 0.0))
holding = partial(probes.holding, reach=0.03)


def hanging(**about):
    """The same along z, downwards from ``height``."""
    body = cord(**about)
    x, _, z = body.vertices.T
    return replace(body, vertices=np.stack([0 * x, 0 * x, z - x], 1))


def free(frames=16):
    return Script("free", (), frames)


def still(world, steps, watched):
    """Go on for ``steps`` with hands that rest where they began; ``watched`` (world -> value) before each."""
    poses = 2 * world.small + 1
    position = np.tile(np.reshape(world.origins, (-1, 1, 3)), (1, poses, 1))
    rotation = np.tile(np.eye(3), (len(position), poses, 1, 1))
    seen = []
    for _ in range(steps):
        seen.append(watched(world))
        world.step(position, rotation, np.zeros_like(world.start))
    return np.array(seen)


def ringing(signal, rate):
    """Angular frequency and decay [1/s] of a damped cosine with phase."""
    from scipy.optimize import curve_fit

    time = np.arange(len(signal)) / rate
    spectrum = np.abs(np.fft.rfft(signal - signal.mean(), 8 * len(signal)))
    guess = 2 * np.pi * np.argmax(spectrum) * rate / (8 * len(signal))

    def wave(t, a, b, w, d, c):
        return np.exp(-d * t) * (a * np.cos(w * t) + b * np.sin(w * t)) + c

    fitted, _ = curve_fit(wave, time, signal, (signal[0], 0.0, guess, 0.1, 0.0), maxfev=20000)
    return abs(fitted[2]), fitted[3]


def clamped(rigidity, **about):
    """A rod with E I [N m^2] in a firm hand, and its free length: it bends at vertices, and at the last in the hand half of what bends
    is behind it."""
    body = cord(rigidity=rigidity, radius=8e-3, height=0.5, **about)
    return body, holding(body.vertices[0], reach=0.05), 0.4 - body.vertices[2, 0] + 0.01


# --- elasticity -----------------------------------------------------------------------------------------------------------------------


def test_a_cantilever_sags_like_a_slender_beam():
    body, script, span = clamped(0.3, damping=0.02)
    motion = simulate(body, replace(script, frames=20), settle=0.0)
    # Timoshenko: w L^4 / (8 E I) + w L^2 / (2 S), some 2 % of L, with S = E A; 18 segments differ by 1 / 18^2 of it or so.
    load = 0.03 / 0.4 * GRAVITY
    sag = motion.vertices[0, -1, 2] - motion.vertices[-1, -1, 2]
    assert sag == pytest.approx(load * span**4 / (8 * 0.3) + load * span**2 / (2 * march.TAUT * 0.03 * GRAVITY), rel=0.01)


def test_a_clamped_cord_rings_and_dies_out_like_a_beam_of_kelvin_and_voigt():
    tau = 5e-3
    body, script, span = clamped(0.06, damping=tau)
    world = World(body, script, NOWHERE, 16)
    world.rod.velocity_collection[1] = 0.05 * (np.maximum(body.vertices[:, 0] - 0.4 + span, 0) / span) ** 2
    swing = still(world, 400, lambda w: w.positions()[-1, 1])
    frequency, decay = ringing(swing[40:], 480)  # higher modes die out first
    expected = 3.5160 * np.sqrt(0.06 / (0.03 / 0.4) / span**4)  # clamped and free, first mode
    # 18 segments, whose mass is in their ends: lower by some 1 / 18 squared and by shear
    assert frequency == pytest.approx(expected, rel=0.015)
    assert decay == pytest.approx(frequency**2 * tau / 2, rel=0.02)  # w^2 tau / 2


def test_a_cord_between_two_hands_hangs_as_a_catenary():
    from scipy.optimize import brentq

    length, near, count = 0.4, 0.12, 31
    body = cord(length=length, count=count, rigidity=1e-7, radius=6e-3, height=0.6, damping=0.02, drag=6.0)
    script = holding(body.vertices[0], body.vertices[-1], frames=85, move=(near, 0.0, 0.0), reach=1e-3)
    x = simulate(body, script, settle=0.0).vertices[-1]
    span = length - near
    # 2 a sinh(d / 2 a) = L, sag a (cosh(d / 2 a) - 1); a chain of n links differs by some 1 / n^2, weight stretches it by 1 / 1000.
    a = brentq(lambda a: 2 * a * np.sinh(span / 2 / a) - length, 0.05, 2.0)
    assert x[0, 2] - x[:, 2].min() == pytest.approx(a * (np.cosh(span / 2 / a) - 1), rel=5e-3)
    curve = a * (np.cosh((x[:, 0] - near - span / 2) / a) - np.cosh(span / 2 / a))
    np.testing.assert_allclose(x[:, 2] - x[0, 2], curve, atol=2e-3)
    assert np.linalg.norm(np.diff(x, axis=0), axis=1).sum() == pytest.approx(length, rel=1e-3)


def test_a_hanging_rope_swings_as_bernoulli_has_it():
    from scipy.special import j0, jn_zeros

    count, length, tip = 41, 0.4, 0.02
    body = hanging(count=count, length=length, rigidity=1e-7, radius=6e-3, height=1.0)
    along = np.linspace(1, 0, count)
    first = jn_zeros(0, 1)[0]
    body = replace(body, vertices=body.vertices + tip * j0(first * np.sqrt(along))[:, None] * [0, 1, 0])
    motion = simulate(body, holding(body.vertices[0], frames=45, reach=1e-3), settle=0.0)
    # w = z1 / 2 sqrt(g / L), z1 = 2.4048; bending of its own is 1e-5 of the weight's. Amplitude of 5 %: periods longer by 1e-3.
    frequency, decay = ringing(motion.vertices[:, -1, 1], 30)
    assert frequency == pytest.approx(first / 2 * np.sqrt(GRAVITY / length), rel=0.01)
    assert abs(decay) < 0.03  # nothing damps it


def test_a_twisted_cord_resists_by_its_shear_modulus():
    rigidity, angle = 2e-5, 1.2
    body = cord(rigidity=1e-3, height=0.5, shear=rigidity / (np.pi * 4e-3**4 / 2), damping=0.02)
    script = holding(body.vertices[0], body.vertices[-1], frames=36, turn=(angle, 0, 0))
    law, kept = watch(lambda world: world.rod.internal_couple.copy())
    motion = simulate(body, script, replace(NOWHERE, laws=(law,)), settle=0.0)
    first, last = motion.gripped[0].max() - 1, motion.gripped[1].min()  # segments that the hands hold
    span = (last - first) * body.measure[0]  # between their middles
    couple = kept[-1][1]
    np.testing.assert_allclose(np.abs(couple[2, first:last]), rigidity * angle / span, rtol=0.02)  # G J times angle over length
    assert np.abs(couple[:2]).max() < 1e-3 * rigidity * angle / span


def test_weight_stretches_a_cord_by_next_to_nothing():
    body = hanging(height=0.6, drag=10.0, damping=0.02)
    motion = simulate(body, holding(body.vertices[0], frames=20, reach=1e-3), settle=0.0)
    long = np.linalg.norm(np.diff(motion.vertices[-1], axis=0), axis=1).sum()
    assert long / 0.4 - 1 == pytest.approx(1 / (2 * march.TAUT), rel=0.05)  # W L / (2 E A)


# --- motion ---------------------------------------------------------------------------------------------------------------------------


def test_a_rope_in_the_air_falls():
    body = cord(height=2.0, drag=0.7)
    motion = simulate(body, free(), settle=0.0)
    time = np.arange(16)[:, None] / 30
    fallen = GRAVITY / 0.7 * (time - (1 - np.exp(-0.7 * time)) / 0.7)  # z'' = -g - c z'
    np.testing.assert_allclose(motion.vertices[0, :, 2] - motion.vertices[:, :, 2], np.broadcast_to(fallen, (16, 21)), atol=2e-5)
    np.testing.assert_allclose(motion.vertices[..., :2], motion.vertices[:1, :, :2].repeat(16, 0), atol=1e-12)


def test_smaller_steps_change_less_and_less(monkeypatch):
    body = cord(length=0.3, count=16, height=0.5, damping=5e-3, rigidity=3e-5)
    script, ends = holding(body.vertices[0], frames=11, move=(0.1, 0.1, 0.1), turn=(1.0, 0.5, 0)), []
    for courant in (1.4, 0.7, 0.35, 0.175):
        monkeypatch.setattr(march, "COURANT", courant)
        ends.append(simulate(body, script, settle=0.0).vertices[-1])
    errors = [np.linalg.norm(a - b, axis=1).mean() for a, b in pairwise(ends)]
    # viscosity is of first order: halving the step halves the change; at the usual step it is microns
    assert errors[0] > 1.7 * errors[1] > 1.7**2 * errors[2]
    assert errors[1] < 2e-5


def test_laws_converge_in_second_order():
    body = hanging(length=0.3, count=11, height=0.6)
    law = laws.tether(np.array([8, 9, 10]), (0.1, 0.0, 0.3), 20.0, 0.02)
    script = holding(body.vertices[0], frames=11)
    ends = [simulate(body, script, Physics(laws=(law,)), substeps=n, settle=0.0).vertices[-1] for n in (8, 16, 32)]
    one, two = (np.linalg.norm(a - b, axis=1).mean() for a, b in pairwise(ends))
    assert one > 3 * two and two < 5e-4  # 4 times, but for the jerk where it begins


def test_the_same_again_is_the_same_to_the_bit():
    rng = np.random.default_rng(1)
    body = bodies.rope(rng)
    script = replace(motions.draw("twist", body, rng), frames=8)
    one, again = (simulate(body, script, settle=0.0).vertices for _ in range(2))
    np.testing.assert_array_equal(one, again)


@pytest.mark.parametrize("kind", ["drag", pytest.param("two_hands", marks=pytest.mark.slow)])
def test_it_agrees_with_the_finite_elements(monkeypatch, kind):
    rng = np.random.default_rng(5)
    body = bodies.rope(rng)
    script = replace(motions.draw(kind, body, rng), frames=26)
    # as extensible as the other engine's rope
    monkeypatch.setattr(march, "TAUT", finite.rods.STIFF * body.young * np.pi * body.radius**2 / (body.mass.sum() * GRAVITY))
    one, other = simulate(body, script), finite.simulate(body, script, substeps=128)
    assert rms(one.vertices - one.vertices[0]) > 0.05
    # segments of 15 mm and two rules of bending; finer meshes come nearer to each other
    assert rms(one.vertices - other.vertices) < 2e-3
    np.testing.assert_allclose(one.position, other.position, atol=1e-12)


def test_a_step_too_far_is_reported():
    with pytest.raises(Unstable, match="free of rope after"):
        simulate(cord(), free(), Physics(laws=(lambda world: lambda time, x, v: 1e3 * v + 10.0,)))


# --- contact --------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slope, mu", [(0.5, 0.25), (0.2, 0.25)])
def test_what_is_steeper_than_friction_slides_and_what_is_not_stays(slope, mu):
    tilt = np.arctan(slope)
    g = GRAVITY * np.array([np.sin(tilt), 0, -np.cos(tilt)])
    law, kept = watch(lambda world: world.table_force().sum())
    motion = simulate(cord(friction=mu), free(), Physics(gravity=tuple(g), laws=(law,)), settle=0.0)
    way = (motion.vertices[-1] - motion.vertices[0]).mean(axis=0)[0]
    slid = max(g[0] + mu * g[2], 0) * 0.5**2 / 2  # s = g (sin - mu cos) t^2 / 2
    assert way == pytest.approx(slid, rel=0.01, abs=3e-5)  # what sticks gives by its springs
    assert kept[-1][1] == pytest.approx(-0.03 * g[2], rel=1e-3)


def test_friction_stops_what_slides():
    mu, speed = 0.25, 0.5
    world = World(cord(friction=mu), free(), Physics(), 32)
    world.rod.velocity_collection[1] = speed
    y = still(world, 300, lambda w: w.positions()[:, 1].mean())
    time = np.arange(300) / 960
    stop = speed / (mu * GRAVITY)  # after 0.2 s: way v^2 / (2 mu g), and then it rests
    expected = np.where(time < stop, speed * time - mu * GRAVITY * time**2 / 2, speed**2 / (2 * mu * GRAVITY))
    np.testing.assert_allclose(y, expected, atol=2e-4)


def test_static_friction_holds_what_kinetic_friction_lets_slide():
    tilt = np.arctan(0.5)
    g = GRAVITY * np.array([np.sin(tilt), 0, -np.cos(tilt)])
    physics = Physics(gravity=tuple(g), laws=(laws.stick(0.5, 0.1),))
    motion = simulate(cord(friction=0.25), free(), physics, settle=0.0)
    assert np.abs(motion.vertices[-1] - motion.vertices[0])[:, 0].max() < 1e-4  # 0.5 < 0.25 + 0.5


def test_a_table_that_moves_and_tilts():
    motion = simulate(cord(friction=0.5), free(31), Physics(belt=(0.06, 0.08)))
    np.testing.assert_allclose((motion.vertices[-1] - motion.vertices[0]).mean(axis=0)[:2], [0.06, 0.08], atol=5e-4)
    ground = (-0.02, 0.1, -0.05)
    x = simulate(cord(friction=1.0, damping=0.01), free(), Physics(ground=ground)).vertices[-1]
    above = (x - [0, 0, ground[0]]) @ np.array([-0.1, 0.05, 1.0]) / np.linalg.norm([-0.1, 0.05, 1.0])
    np.testing.assert_allclose(above, 4e-3, atol=1e-4)


@pytest.mark.parametrize("shape", ["box", "cylinder"])
def test_what_stands_under_a_cord_carries_it(shape):
    body = cord(length=0.06, count=7, height=0.101, rigidity=1e-3, damping=0.01)
    body = replace(body, vertices=body.vertices - [0.03, 0, 0])
    motion = simulate(body, free(), Physics(obstacles=(Obstacle(shape, (0.0, 0.0, 0.05), 0.05),)))
    np.testing.assert_allclose(motion.vertices[-1, :, 2], 0.1 + body.radius, atol=5e-5)


def test_a_cord_hangs_over_a_ball_and_not_through_it():
    body = cord(length=0.3, height=0.16, rigidity=1e-6, damping=0.01, friction=1.0)
    body = replace(body, vertices=body.vertices - [0.15, 0, 0])
    ball = Obstacle("sphere", (0.0, 0.0, 0.1), 0.05)
    x = simulate(body, holding(body.vertices[10], frames=20, reach=1e-3), Physics(obstacles=(ball,)), settle=0.0).vertices[-1]
    from_middle = np.linalg.norm(x - ball.place, axis=1)
    assert from_middle.min() > ball.size + body.radius - 5e-4 and x[0, 2] < 0.1  # its ends hang down beside it


# --- hands and laws -------------------------------------------------------------------------------------------------------------------


def test_a_grip_carries_the_weight_and_slips_by_what_it_may():
    body, most = hanging(height=0.6, drag=8.0, damping=0.01, count=11, length=0.2), 0.03
    weight, script = body.mass.sum() * GRAVITY, holding((0, 0, 0.6), frames=41)
    law, kept = watch(lambda world: world.grip_force(0))
    held = simulate(body, script, Physics(laws=(law,)), settle=0.0)
    np.testing.assert_allclose(np.mean([f for t, f in kept if t > 1], axis=0), [0, 0, -weight], atol=0.01 * weight)
    slipped = simulate(body, script, Physics(laws=(laws.slip(0.5 * weight, 1.0 / weight, most),)), settle=0.0)
    down = [m.vertices[-1, m.gripped[0]].mean(axis=0) - m.position[0, -1] for m in (slipped, held)]
    np.testing.assert_allclose(down[0] - down[1], [0, 0, -most], atol=0.05 * most)
    assert "slip" in slipped.events


def test_a_soft_grip_gives_by_weight_over_stiffness():
    body = hanging(height=0.6, drag=8.0, damping=0.01, count=11, length=0.2)
    weight = body.mass.sum() * GRAVITY
    stiffness = weight / 0.02
    law, kept = watch(lambda world: world.grip_force(0))
    physics = Physics(laws=(laws.soft_grip(stiffness, 2 * np.sqrt(stiffness * body.mass.sum())), law))
    motion = simulate(body, holding((0, 0, 0.6), frames=41), physics, settle=0.0)
    down = motion.vertices[:, motion.gripped[0], 2].mean(axis=1)
    assert down[0] - down[-1] == pytest.approx(0.02, rel=0.01)  # m g / k
    np.testing.assert_allclose(np.mean([f for t, f in kept if t > 1], axis=0), [0, 0, -weight], atol=0.01 * weight)


def test_a_hand_carries_and_turns_what_it_holds():
    body, turn = cord(height=0.5, damping=0.01), np.array([0.3, -0.4, 1.0])
    script = holding(body.vertices[0], frames=31, move=(0.1, 0.05, 0.1), turn=tuple(turn))
    law, kept = watch(lambda world: (world.rod.director_collection.copy(), world.rotation(0).copy()))
    motion = simulate(body, script, Physics(laws=(law,)), settle=0.0)
    held, rest = motion.gripped[0], motion.vertices[0, motion.gripped[0]] - motion.position[0, 0]
    for t in (10, 20, 30):
        there = motion.position[0, t] + rest @ motion.rotation[0, t].T
        np.testing.assert_allclose(motion.vertices[t, held], there, atol=1e-12)
    (first, _), (last, rotation) = kept[0][1], kept[-1][1]
    for segment in range(len(held) - 1):  # directors in rows turn with the hand
        np.testing.assert_allclose(last[:, :, segment], first[:, :, segment] @ rotation.T, atol=1e-9)


def test_mass_that_is_dropped():
    body = hanging(height=0.6, drag=8.0, damping=0.01, count=11, length=0.2)
    law, kept = watch(lambda world: world.grip_force(0)[2])
    physics = Physics(laws=(laws.drops_mass(2 * body.mass, 0.6), law))
    simulate(body, holding((0, 0, 0.6), frames=41), physics, settle=0.0)
    weight = body.mass.sum() * GRAVITY
    assert np.mean([f for t, f in kept if 0.4 < t < 0.6]) == pytest.approx(-2 * weight, rel=0.01)
    assert np.mean([f for t, f in kept if t > 1.1]) == pytest.approx(-weight, rel=0.01)


def test_terminal_velocity_in_wind():
    body, c, wind = cord(height=3.0), 20.0, np.array([0.4, -0.3, 0.0])
    motion = simulate(body, free(31), Physics(laws=(laws.air(c, tuple(wind)),)), settle=0.0)
    terminal = np.sqrt(body.mass.sum() * GRAVITY / (c * body.area.sum()))  # m g = c A v^2
    speed = (motion.vertices[-1] - motion.vertices[-2]).mean(axis=0) * 30
    np.testing.assert_allclose(speed, wind - [0, 0, terminal], atol=0.02 * terminal)


def test_only_ropes(monkeypatch):
    assert able("cosserat", "rope", EFFECTS) and not able("cosserat", "cloth", ())
    assert "pyelastica" in cosserat.about()
    with pytest.raises(ValueError, match="simulates ropes, got a cloth"):
        simulate(bodies.draw("cloth", np.random.default_rng(0)), free())
    body = cord()
    with pytest.raises(ValueError, match="join each vertex to the next"):
        simulate(replace(body, elements=body.elements[::-1]), free())
    monkeypatch.setitem(sys.modules, "elastica", None)
    with pytest.raises(ValueError, match="pip install 'pyelastica"):
        simulate(body, free())


ROPES = [("effect", n) for n, p in EFFECTS.items() if "rope" in p.bodies] + [
    ("outside", n) for n, p in OUTSIDE.items() if "rope" in p.bodies
]


@pytest.mark.slow
@pytest.mark.parametrize("kind, name", ROPES)
def test_everything_that_a_rope_has_can_be_concealed(kind, name):
    case = build(kind, name, "rope", seed=11, engine="cosserat")
    assert 0.010 <= case.label["displacement"] <= 0.060 * (EFFECTS | OUTSIDE)[name].most and "pyelastica" in case.label["engine"]
    assert np.isfinite(case.fit.controllers).all() and case.label["displacement_transfer"] > 0.005
