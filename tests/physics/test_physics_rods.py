"""Hinges and ropes against closed forms of beams and rods, in float64.

A rope of segments l whose first segment is gripped is a beam clamped in the middle of that segment: the hinge at its end stands for a
length l that begins there. With that length the discretisation is second order in l.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from twinbench.physics.batch import Batch
from twinbench.physics.hinges import natural_curvature
from twinbench.physics.kernels import build
from twinbench.physics.system import System
from twinbench.physics.terms import Bending, BendingDamping, Dashpot, Gravity, LinearDrag, Springs, Torsion
from twinbench.physics.topology import rope_hinges, sheet_hinges

DENSITY = 0.05  # kg/m
KINDS = (Springs, Dashpot, Gravity, LinearDrag, Bending, BendingDamping, Torsion)
NEUTRAL = dict(dashpot_damping=0.0, gravity_z=0.0, drag_damping=0.0)  # one list of laws: all tests share two compiled kernels


def line(count, segment):
    return np.arange(count)[:, None] * [segment, 0.0, 0.0]


def rope(points, *, grips=(), axial=500.0, path=None, chained=True, ring=False, **options):
    """A rope of uniform density through ``points``; ``options`` are fields of the system and values of parameters."""
    chain = np.append(np.arange(len(points)), 0) if ring else np.arange(len(points))
    springs = np.stack([chain[:-1], chain[1:]], 1)
    lengths = np.linalg.norm(np.diff(points[chain], axis=0), axis=1)
    masses = np.zeros(len(points))
    for k in (0, 1):
        np.add.at(masses, springs[:, k], DENSITY * lengths / 2)
    fields = {k: options.pop(k) for k in ("velocities", "natural", "flexure", "rest") if k in options}
    return System(
        positions=points,
        springs=springs,
        stiffness=np.full(len(springs), axial),
        masses=masses,
        controllers=points[None, list(grips)] if path is None else path,
        grips=list(grips),
        hinges=rope_hinges(chain),
        chains=[chain] if chained else [],
        terms=[k() for k in KINDS],
        **fields,
    ).with_values(**{**NEUTRAL, **options})


def run(system, seconds, dt, frames=1, *, directors=None, **options):
    """(frames + 1, M, 3) positions at equal times, and the end's (v, directors)."""
    substeps = round(seconds / dt / frames)
    batch = Batch([system], fps=frames / seconds, substeps=substeps, double=True, workers=1, **options)
    inputs = batch.inputs if directors is None else replace(batch.inputs, directors=torch.as_tensor(directors, dtype=torch.float64))
    out, _, v, carried = batch.march(0, frames, inputs, whole=True)
    return np.concatenate([inputs.x[None].numpy(), out.numpy()]), v.numpy(), carried.directors.numpy()


def start_directors(system):
    return Batch([system], fps=1, substeps=1, double=True, workers=1).inputs.directors.numpy()


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def smallest_rotation(t, u):
    """The rotation that takes unit vector ``t`` to ``u`` about t x u."""
    axis, sine = np.cross(t, u), np.linalg.norm(np.cross(t, u))
    return Rotation.from_rotvec(axis / max(sine, 1e-300) * np.arctan2(sine, t @ u))


def measure(x, directors):
    """(n - 2, 3) curvatures and twist of an open rope: the binormal in the frame half way, by rotations."""
    t = unit(np.diff(x, axis=0))
    found = []
    for j in range(len(t) - 1):
        angle = np.arctan2(np.linalg.norm(np.cross(t[j], t[j + 1])), t[j] @ t[j + 1])
        binormal = 2 * np.tan(angle / 2) * unit(np.cross(t[j], t[j + 1])) if angle > 0 else np.zeros(3)
        d, e = directors[j], directors[j + 1]
        carried = smallest_rotation(t[j], t[j + 1]).apply(d)
        tau = np.arctan2(np.cross(carried, e) @ t[j + 1], carried @ e)
        first = Rotation.from_rotvec(tau / 2 * t[j + 1]).apply(carried)
        found.append([binormal @ np.cross(t[j + 1], first), -binormal @ first, tau])
    return np.array(found)


def slope(errors):
    """Observed order from errors at l, l/2, l/4, ..."""
    return -np.polyfit(np.arange(len(errors)), np.log2(np.abs(errors)), 1)[0]


# ---------------------------------------------------------------- beams

BEAM, STIFF = 0.5, 0.025  # m from the clamp to the tip, N m^2
FIRST = 1.8751040687**2 * np.sqrt(STIFF / DENSITY) / BEAM**2  # rad/s: cos(z) cosh(z) = -1 at z = 1.8751, Euler and Bernoulli


def beam(count, **options):
    """A cantilever along x, clamped ``BEAM`` before its tip."""
    return rope(line(count, BEAM / (count - 1.5)), grips=(0, 1), bending_stiffness=STIFF, **options)


def test_cantilever_under_its_own_weight():
    # tip deflection rho g L^4 / (8 B), second order in l; g is such that it is L / 1000, so that angles are small to (1e-3)^2.
    # Critically damped in the first mode, so that after 3 s of 20 /s decay exp(-30) of the way is left
    g = 8 * STIFF * 1e-3 / (DENSITY * BEAM**3)
    errors = []
    for count in (6, 11, 21):
        system = beam(count, gravity_z=-g, drag_damping=2 * FIRST)
        x = run(system, 3.0, 2e-4)[0][-1]
        # the discrete beam exactly: hinge i turns by (l / B) times the moment of the weights beyond it
        arm = np.maximum(system.positions[None, :, 0] - system.positions[1:-1, None, 0], 0)  # (hinges, nodes)
        turned = system.span[0] / STIFF * (arm * system.masses * g).sum(1)
        assert x[-1, 2] == pytest.approx(-(arm[:, -1] * turned).sum(), rel=1e-5)
        errors.append(-x[-1, 2] / (1e-3 * BEAM) - 1)
    assert slope(errors) == pytest.approx(2, abs=0.2) and abs(errors[-1]) < 0.01


def first_mode(system):
    """The cantilever's first mode at its nodes, 1 at the tip."""
    z, s = 1.8751040687, np.maximum(system.positions[:, 0] - (system.positions[-1, 0] - BEAM), 0) / BEAM
    ratio = (np.cos(z) + np.cosh(z)) / (np.sin(z) + np.sinh(z))
    shape = np.cosh(z * s) - np.cos(z * s) - ratio * (np.sinh(z * s) - np.sin(z * s))
    shape[:2] = 0
    return shape / shape[-1]


def swing(count, **options):
    """(times, tip's height / its start) of a cantilever that is let go in its first mode with 1e-4 of its length."""
    system = beam(count, **options)
    shape = first_mode(system)
    start = replace(system, positions=system.positions + 1e-4 * BEAM * shape[:, None] * [0, 0, 1], rest=system.rest, span=system.span)
    x = run(start, 2.0, 1e-4, 2000)[0]
    return np.arange(2001) * 1e-3, x[:, -1, 2] / (1e-4 * BEAM)


def crossings(t, z):
    k = np.flatnonzero(z[:-1] * z[1:] < 0)
    return t[k] - z[k] * (t[k + 1] - t[k]) / (z[k + 1] - z[k])


def test_frequency_of_a_cantilever():
    # zero crossings of the tip are pi / w apart, w = 1.8751^2 sqrt(B / rho) / L^2; second order in l. (w dt)^2 / 24 = 1e-7 is nothing
    errors = [np.pi / np.diff(crossings(*swing(count))).mean() / FIRST - 1 for count in (6, 11, 21)]
    assert slope(errors) == pytest.approx(2, abs=0.35) and abs(errors[-1]) < 0.01


def test_bending_damping():
    # Kelvin and Voigt: a mode of frequency w decays at eta w^2 / (2 B); the frequency is that of the same beam undamped. The tip's speed at
    # zero crossings falls by that rate; the step's own part, first order, is dt w times it: 1e-3
    eta = 2 * 0.03 * STIFF / FIRST
    t, free = swing(11)
    w = np.pi / np.diff(crossings(t, free)).mean()
    _, z = swing(11, bending_damping=eta)
    peaks = np.flatnonzero((np.abs(z[1:-1]) > np.abs(z[:-2])) & (np.abs(z[1:-1]) >= np.abs(z[2:]))) + 1
    peaks = peaks[np.abs(z[peaks]) > 1e-3][1:]  # the first is in the higher modes of the discrete beam too
    rate = -np.polyfit(t[peaks], np.log(np.abs(z[peaks])), 1)[0]
    assert rate == pytest.approx(eta * w**2 / (2 * STIFF), rel=0.01)
    assert np.abs(free[peaks]).max() > 0.9  # without it nothing decays


@pytest.mark.parametrize("chained", [True, False], ids=["rope", "hinges alone"])
def test_natural_curvature_makes_an_arc(chained):
    # all angles a of 2 tan(a / 2) = s n: a regular polygon; nodes on a circle of radius l / (2 sin(a / 2)), whatever the stiffness
    n, share, segment, count = 0.3, 1.2, 0.05, 9
    # bent already, by 0.2 rad: hinges alone only know how much, not which way
    way = 0.2 * np.arange(count - 1)[:, None]
    start = np.concatenate([np.zeros((1, 3)), segment * np.cumsum(np.concatenate([np.cos(way), np.sin(way), 0 * way], 1), 0)])
    system = rope(start, grips=(0, 1), natural=np.tile([n, 0.0], (count - 2, 1)), chained=chained)
    x = run(system.with_values(bending_stiffness=0.02, natural_share=share, drag_damping=15.0, torsion_stiffness=0.02), 6.0, 2e-4)[0][-1]
    t = unit(np.diff(x, axis=0))
    angles = np.arccos((t[:-1] * t[1:]).sum(1))
    # without a chain n fades by (1e-3 / n)^2 / 2
    np.testing.assert_allclose(2 * np.tan(angles / 2), share * n, rtol=1e-6 if chained else 1e-5)
    radius = segment / (2 * np.sin(angles[0] / 2))
    centre = x[1] + np.cross([0, 0, 1], unit(x[2] - x[0])) * radius
    np.testing.assert_allclose(np.linalg.norm(x[1:] - centre, axis=1), radius, rtol=1e-6)
    np.testing.assert_allclose(x[:, 2], 0, atol=1e-12)


def test_natural_curvature_has_a_direction():
    # kb = n1 m2 - n2 m1 in the clamp's material frame
    count, natural = 7, np.array([0.2, -0.1])
    system = rope(line(count, 0.05), grips=(0, 1), natural=np.tile(natural, (count - 2, 1)), bending_stiffness=0.02, torsion_stiffness=0.02)
    x, _, d = run(system.with_values(drag_damping=15.0), 6.0, 2e-4)
    t = unit(np.diff(x[-1], axis=0))
    binormal = 2 * np.cross(t[0], t[1]) / (1 + t[0] @ t[1])
    np.testing.assert_allclose(binormal, natural[0] * np.cross(t[0], d[0]) - natural[1] * d[0], atol=1e-6)
    np.testing.assert_allclose(measure(x[-1], d), np.tile([*natural, 0.0], (count - 2, 1)), atol=1e-6)


# ---------------------------------------------------------------- twist


def twisted(count, total, **options):
    """A straight rope gripped by both end segments, and directors of which the last is turned by ``total`` rad."""
    system = rope(line(count, 0.05), grips=(0, 1, count - 2, count - 1), **options)
    d = start_directors(system).copy()
    d[-1] = Rotation.from_rotvec([total, 0, 0]).apply(d[-1])
    return system, d


def test_twist_spreads_evenly():
    # no torque from anywhere: tau = total / length everywhere. Jacobi's slowest mode of 10 free segments keeps
    # 1 - 0.6 (1 - cos(pi / 11)) = 0.976 a step: 1000 steps leave 1e-10; steps of 0.2 rad at most come first
    system, d = twisted(12, 2.0, bending_stiffness=1.0, torsion_stiffness=0.1)
    x, _, found = run(system, 0.1, 1e-4, directors=d)
    np.testing.assert_allclose(measure(x[-1], found)[:, 2], 2.0 / 10, atol=1e-8)
    np.testing.assert_allclose(x[-1], x[0], atol=1e-12)


@pytest.mark.parametrize(("share", "buckles"), [(0.85, False), (1.15, True)])
def test_greenhills_buckling(share, buckles):
    # a straight rod with both ends clamped, without tension, buckles where C total / L = 8.987 B / L, whatever L
    # (Greenhill 1883; tan(z / 2) = z / 2 at z = 8.987); 20 segments are second order: 1 %
    stiffness, torsion = 0.01, 0.02
    system, d = twisted(20, share * 8.987 * stiffness / torsion, bending_stiffness=stiffness, torsion_stiffness=torsion, axial=50.0)
    d[1:-1] = [Rotation.from_rotvec([k / 18 * share * 8.987 * stiffness / torsion, 0, 0]).apply(d[0]) for k in range(1, 18)]
    noise = np.random.default_rng(0).normal(size=system.positions.shape) * 1e-5
    noise[[0, 1, -2, -1]] = 0
    bent = replace(system, positions=system.positions + noise, rest=system.rest, span=system.span).with_values(drag_damping=5.0)
    d = d - unit(np.diff(bent.positions, axis=0)) * (d * unit(np.diff(bent.positions, axis=0))).sum(1, keepdims=True)
    x = run(bent, 6.0, 2e-4, directors=unit(d))[0][-1]
    away = np.abs(x[:, 1:]).max()
    assert away > 1e-3 if buckles else away < 1e-5


@pytest.mark.parametrize(("ratio", "buckles"), [(1.4, False), (2.1, True)])
def test_michells_ring(ratio, buckles):
    # a ring without natural curvature, closed with one full turn of twist, leaves its plane where 2 pi C > 2 pi sqrt(3) B (Michell 1889)
    count, radius, stiffness = 24, 0.1, 0.01
    angle = np.arange(count) / count * 2 * np.pi
    circle = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    noise = 1e-5 * np.random.default_rng(0).normal(size=circle.shape)
    # naturally round, as Michell's rod is bent evenly, would hold the ring in its plane: it is straight by nature
    system = rope(circle + noise, ring=True, bending_stiffness=stiffness, torsion_stiffness=ratio * stiffness, drag_damping=10.0)
    x = system.positions
    t = unit(np.roll(x, -1, 0) - x)
    d = start_directors(system)
    up = unit(np.array([0, 0, 1.0]) - t * t[:, 2:])
    d = np.cos(angle)[:, None] * up + np.sin(angle)[:, None] * np.cross(t, up)
    found = run(system, 3.0, 1e-4, directors=d)[0][-1]
    away = np.abs(found[:, 2] - found[:, 2].mean()).max()
    assert away > 0.1 * radius if buckles else away < 1e-3 * radius


def test_a_grip_that_goes_round_a_cone_turns_by_its_solid_angle():
    # parallel transport around a cone of half angle a turns a director by 2 pi (1 - cos a) (Gauss and Bonnet). Between frames tangents
    # follow great circles, so that a loop of K frames is a spherical polygon, whose area is that of K equal triangles; the limit is
    # within 1 / K^2
    a, turns, segment = 0.7, 48, 0.05
    phase = np.arange(turns + 1) / turns * 2 * np.pi
    t = np.stack([np.sin(a) * np.cos(phase), np.sin(a) * np.sin(phase), np.full(turns + 1, np.cos(a))], 1)
    points = np.arange(4)[:, None] * segment * t[0]
    system = rope(
        points, grips=(0, 1), path=np.stack([0 * t, segment * t], 1), bending_stiffness=0.01, torsion_stiffness=0.01, drag_damping=5.0
    )
    start = start_directors(system)
    x, _, d = run(system, 2.0, 2.0 / turns / 200, turns)
    np.testing.assert_allclose(unit(x[-1, 1] - x[-1, 0]), t[0], atol=1e-12)
    turned = np.arctan2(np.cross(start[0], d[0]) @ t[0], start[0] @ d[0]) % (2 * np.pi)
    dihedral = np.arctan2(1 / np.tan(np.pi / turns), np.cos(a))  # of a base of the triangle with apex 2 pi / K on the axis
    polygon = turns * (2 * np.pi / turns + 2 * dihedral - np.pi)
    assert turned == pytest.approx(polygon, abs=1e-9)
    assert turned == pytest.approx(2 * np.pi * (1 - np.cos(a)), abs=10 / turns**2)
    assert np.abs(measure(x[-1], d)[:, 2]).max() < 0.01  # the free rest of the rope has followed


def test_directors_start_where_curvature_fits_and_twist_rests():
    # a helix whose natural curvature is its own, given in frames rolled by 1 rad: the rope starts at rest, kappa = natural and tau = 0
    s = np.linspace(0, 4, 12)[:, None]
    points = 0.1 * np.concatenate([np.cos(s), np.sin(s), 0.4 * s], 1)
    plain = rope(points)
    own = natural_curvature(points, plain.hinges, plain.chains) @ [[np.cos(1), np.sin(1)], [-np.sin(1), np.cos(1)]]
    system = replace(plain, natural=own).with_values(bending_stiffness=0.01, torsion_stiffness=0.004)
    np.testing.assert_allclose(measure(points, start_directors(system)), np.c_[own, np.zeros(10)], atol=1e-9)
    x, v, _ = run(system, 0.1, 1e-4)
    assert np.abs(v).max() < 1e-9 and np.abs(x[-1] - points).max() < 1e-10


def test_free_segments_reach_the_balance_of_torques():
    # natural curvature of another direction than the rope's own: energy does not change, to first order, with any free segment's angle
    rng = np.random.default_rng(1)
    points = line(8, 0.05) + rng.normal(size=(8, 3)) * 0.01
    natural = rng.normal(size=(6, 2)) * 0.3
    system = rope(points, grips=(0, 1), natural=natural, bending_stiffness=0.01, torsion_stiffness=0.006)
    d = start_directors(system)
    t = unit(np.diff(points, axis=0))

    def energy(j, angle):
        e = d.copy()
        e[j] = Rotation.from_rotvec(angle * t[j]).apply(d[j])
        return elastic(system, points, e)

    slopes = [(energy(j, 1e-5) - energy(j, -1e-5)) / 2e-5 for j in range(7)]
    stiff = 0.006 / 0.05
    assert np.abs(slopes[1:]).max() < 1e-6 * stiff  # a step of Newton's method from within 1e-3 rad of rest ends 1e-6 from it
    assert abs(slopes[0]) > 1e-3 * stiff  # the clamped one is where it was found


@pytest.mark.parametrize("ring", [False, True])
def test_twist_is_at_rest_after_a_single_substep(ring):
    # a straight rope of 60 segments, a ring of 24: directors are off by random small angles; where angles are small the energy is
    # quadratic in them, so that one step of Newton's method ends at its least: no segment's torque is left but the clamped one's
    count, radius = (24, 0.1) if ring else (60, 0.1)
    angle = np.arange(count) / count * 2 * np.pi
    points = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1) if ring else line(count, 0.01)
    system = rope(points, ring=ring, grips=(0, 1), bending_stiffness=0.01, torsion_stiffness=0.007)
    chain = np.append(np.arange(count), 0) if ring else np.arange(count)
    t = unit(np.diff(points[chain], axis=0))
    d = start_directors(system)
    off = np.random.default_rng(2).normal(size=len(t)) * 1e-3
    off[0] = 0
    d = np.cos(off)[:, None] * d + np.sin(off)[:, None] * np.cross(t, d)
    _, _, after = run(system, 1e-9, 1e-9, directors=d)
    pairs = [(k, (k + 1) % len(t)) for k in range(len(t) if ring else len(t) - 1)]
    carried = np.array([smallest_rotation(t[a], t[b]).apply(after[a]) for a, b in pairs])
    e, u = after[[b for _, b in pairs]], t[[b for _, b in pairs]]
    tau = np.arctan2((np.cross(carried, e) * u).sum(1), (carried * e).sum(1))
    left = np.diff(tau) if not ring else np.delete(tau - np.roll(tau, 1), 0)  # torques on segments but the first; isotropic: of twist alone
    assert np.abs(left).max() < 1e-7 and np.abs(off).max() > 1e-3  # 1e-3 rad, squared
    if not ring:
        np.testing.assert_allclose(after, start_directors(system), atol=1e-4)  # a free end leaves no twist: all the angles are gone


def test_a_rope_that_leaves_its_plane_is_itself_in_finer_steps():
    # thrown aside while it falls, 31 nodes: in five times as many steps it differs by first order in the step alone. Directors that take
    # a Jacobi step in each substep lag by N^2 of them, and differ by 20 mm
    points = line(31, 0.5 / 30)
    speeds = points[:, :1] * [0.0, 2.0, 0.0]
    speeds[:2] = 0
    values = dict(gravity_z=-9.8, dashpot_damping=0.05, bending_stiffness=1e-4, bending_damping=5e-7, torsion_stiffness=1e-4)
    system = rope(points, grips=(0, 1), velocities=speeds, axial=120.0, **values)
    coarse, fine = (run(system, 1.0, 1 / (30 * n), 30)[0] for n in (100, 500))
    assert np.linalg.norm(coarse - fine, axis=2).max() < 2e-3


# ---------------------------------------------------------------- forces and energy


def elastic(system, x, directors):
    """Bending and twist energy [J] of an open rope, by rotations of material frames."""
    v = system.values
    kappa = measure(x, directors)
    bend = (kappa[:, :2] - v["natural_share"] * system.natural) ** 2
    each = v["bending_stiffness"] * bend.sum(1) + v["torsion_stiffness"] * kappa[:, 2] ** 2
    return (system.flexure * each / system.span).sum() / 2


def crooked(seed=0, count=7, **options):
    """A rope of random shape with natural curvature and stiffness of its own at every hinge."""
    rng = np.random.default_rng(seed)
    points = line(count, 0.05) + rng.normal(size=(count, 3)) * 0.015
    own = dict(natural=rng.normal(size=(count - 2, 2)) * 0.3, flexure=rng.uniform(0.5, 2, count - 2))
    return rope(points, **{**own, **options}).with_values(bending_stiffness=0.01, torsion_stiffness=0.007, natural_share=0.8)


def first_push(system, directors=None):
    """(M, 3) force on each particle in the very first step, and the directors then."""
    batch = Batch([system], fps=1e4, substeps=1, double=True, workers=1)
    inputs = batch.inputs if directors is None else replace(batch.inputs, directors=torch.as_tensor(directors, dtype=torch.float64))
    _, _, v = batch.march(0, 1, inputs)
    return (v - inputs.v).numpy() * 1e4 * system.masses[:, None], inputs.directors.numpy()


def test_forces_are_minus_the_gradient_of_the_energy():
    # the directors go along with their segments by the smallest rotation; central differences: h^2 = 1e-12, rounding 1e-17 / h = 1e-11
    system = crooked()
    rng = np.random.default_rng(3)
    t = unit(np.diff(system.positions, axis=0))
    d = unit(np.cross(t, rng.normal(size=t.shape)))  # any directors, also far from rest
    force, _ = first_push(system, d)

    def energy(x):
        u = unit(np.diff(x, axis=0))
        return elastic(system, x, np.array([smallest_rotation(a, b).apply(e) for a, b, e in zip(t, u, d, strict=True)]))

    for i, k in np.ndindex(system.positions.shape):
        h = np.zeros_like(system.positions)
        h[i, k] = 1e-6
        slope = (energy(system.positions + h) - energy(system.positions - h)) / 2e-6
        assert force[i, k] == pytest.approx(-slope, abs=1e-7 * np.abs(force).max())


def test_hinges_alone_push_against_their_energy():
    # E = B (2 tan(a / 2) - s n)^2 / (2 l); n fades below 1e-3 rad: by (1e-3 / a)^2 / 2, 1e-5 at a = 0.2
    system = crooked(chained=False).with_values(torsion_stiffness=0.0)
    force, _ = first_push(system)

    def energy(x):
        t = unit(np.diff(x, axis=0))
        bent = 2 * np.tan(np.arccos((t[:-1] * t[1:]).sum(1)) / 2)
        return (system.flexure * 0.01 / system.span * (bent - 0.8 * system.natural[:, 0]) ** 2).sum() / 2

    for i, k in np.ndindex(system.positions.shape):
        h = np.zeros_like(system.positions)
        h[i, k] = 1e-6
        slope = (energy(system.positions + h) - energy(system.positions - h)) / 2e-6
        assert force[i, k] == pytest.approx(-slope, abs=1e-5 * np.abs(force).max())


@pytest.mark.parametrize("chained", [True, False], ids=["rope", "hinges alone"])
def test_forces_of_a_hinge_are_in_balance(chained):
    # no net force; no net torque either, where no segment has one of its own: directors rest to 1e-3 rad (100 relaxations), so to 1e-4 N m.
    # The moments of damping turn nobody about the rope's axis, so damping is for hinges alone here, which near straight, below 1e-3 rad,
    # feel turning: (1e-3 / 0.2)^2 of 0.3 N m
    system = crooked(chained=chained, velocities=np.random.default_rng(5).normal(size=(7, 3)))
    force, _ = first_push(system if chained else system.with_values(bending_damping=1e-4))
    assert np.abs(force).max() > 0.1
    np.testing.assert_allclose(force.sum(0), 0, atol=1e-10)
    np.testing.assert_allclose(np.cross(system.positions, force).sum(0), 0, atol=1e-4 if chained else 2e-5)


def test_a_rotated_rope_moves_alike():
    # objectivity: positions, velocities and directors rotated together give the same motion, rotated
    system = crooked(velocities=np.random.default_rng(5).normal(size=(7, 3)))
    q = Rotation.from_rotvec([0.3, -1.1, 0.7])
    other = replace(system, positions=q.apply(system.positions.copy()), velocities=q.apply(system.velocities.copy()))
    d = start_directors(system).copy()
    one, two = run(system, 0.2, 1e-4, 4, directors=d), run(other, 0.2, 1e-4, 4, directors=q.apply(d))
    for a, b in zip(one[0], two[0], strict=True):
        np.testing.assert_allclose(q.apply(a), b, atol=1e-10)
    np.testing.assert_allclose(q.apply(one[2]), two[2], atol=1e-9)
    assert np.abs(one[0][-1] - one[0][0]).max() > 0.05


def test_a_plane_rope_bends_alike_with_and_without_directors():
    # the natural curvature of hinges alone fades by (1e-3 / a)^2 / 2 at angles a of 0.1 rad and more: 1e-4 of its part in a metre's way
    points = line(9, 0.05)
    points[:, 2] = 1.5 * points[:, 0] ** 2
    own = dict(natural=np.tile([0.1, 0.0], (7, 1)), velocities=np.linspace(0, 1, 9)[:, None] * [0.1, 0, 0.5])
    a, b = (
        rope(points, chained=c, grips=(0,), bending_stiffness=0.01, torsion_stiffness=0.01, bending_damping=1e-5, **own)
        for c in (True, False)
    )
    x, y = (run(s, 0.3, 1e-4, 3)[0] for s in (a, b))
    np.testing.assert_allclose(x, y, atol=1e-5)
    assert np.abs(x[-1] - x[0]).max() > 0.05


def energies(system, x, v, directors):
    lengths = np.linalg.norm(np.diff(x, axis=0), axis=1)
    stretch = (system.stiffness * system.rest * (lengths / system.rest - 1) ** 2).sum() / 2
    return stretch + elastic(system, x, directors) + (system.masses[:, None] * v**2).sum() / 2


def history(system, seconds, dt, frames):
    """Energies at equal times."""
    batch = Batch([system], fps=frames / seconds, substeps=round(seconds / dt / frames), double=True, workers=1)
    inputs, found = batch.inputs, []
    for frame in range(frames + 1):
        found.append(energies(system, *(t.numpy() for t in (inputs.x, inputs.v, inputs.directors))))
        _, x, v, carried = batch.march(frame, 1, inputs, whole=True)
        inputs = replace(inputs, x=x, v=v, **vars(carried))
    return np.array(found)


def test_energy_without_damping_is_kept_to_first_order():
    # straight by nature: a free rope has no twist and nothing that its relaxation could take out
    rng = np.random.default_rng(5)
    points = line(7, 0.05) + rng.normal(size=(7, 3)) * 0.004
    system = rope(points, velocities=rng.normal(size=(7, 3)), bending_stiffness=0.01, torsion_stiffness=0.007)
    found = [history(system, 0.1, dt, 10) for dt in (5e-5, 2.5e-5, 1.25e-5)]
    errors = [np.abs(energy - energy[0]).max() for energy in found]
    assert slope(errors) == pytest.approx(1, abs=0.2)
    assert errors[-1] < 0.005 * found[0][0]


def test_bending_damping_takes_energy_out():
    # a third of critical for single hinges: the loss of every tenth of a second is far above the step's own error (see above)
    system = crooked(velocities=np.random.default_rng(5).normal(size=(7, 3))).with_values(bending_damping=2e-5)
    found = history(system, 1.0, 5e-5, 10)
    assert (np.diff(found) < 0).all() and found[-1] < 0.7 * found[0]


# ---------------------------------------------------------------- the engine around them


def mixed(seed):
    """A rope with a side hinge that follows no chain, held at both ends, of its own size."""
    rng = np.random.default_rng(seed)
    count = 6 + seed
    points = line(count, 0.05) + rng.normal(size=(count, 3)) * 0.01
    path = points[None, [0, 1, -1]] + np.cumsum(rng.normal(size=(4, 3, 3)) * 0.003, 0)
    path[0] = points[[0, 1, -1]]
    system = rope(points, grips=(0, 1, count - 1), path=path, natural=rng.normal(size=(count - 2, 2)) * 0.3)
    hinges = np.concatenate([system.hinges, [[0, 3, 5], [1, 3, 4]]])
    natural = np.concatenate([system.natural, [[0.4, 0.0], [0.1, 0.0]]])
    given = dict(hinges=hinges, natural=natural, span=None, flexure=rng.uniform(0.5, 1.5, len(hinges)))
    return replace(system, **given).with_values(bending_stiffness=0.01, torsion_stiffness=0.005, bending_damping=1e-5, gravity_z=-9.8)


def positions(systems, **options):
    found = Batch(systems, **{**dict(fps=30, substeps=100, double=True, workers=1), **options}).rollout(4).positions
    return [p.numpy() for p in found]


@pytest.mark.parametrize("double", [True, False], ids=["float64", "float32"])
def test_batched_ropes_are_the_single_ones(double):
    systems = [mixed(seed) for seed in range(3)]
    for together, workers in ((positions(systems, double=double), 1), (positions(systems, double=double, workers=2), 2)):
        for system, x in zip(systems, together, strict=True):
            assert np.array_equal(x, positions([system], double=double)[0]), workers


def test_systems_without_hinges_beside_others():
    bare = replace(mixed(0), hinges=None, natural=None, span=None, flexure=None, chains=())
    systems = [bare, mixed(1), bare]
    for x, y in zip(positions(systems), [positions([s])[0] for s in systems], strict=True):
        assert np.array_equal(x, y)


def test_gathered_forces_are_those_of_lone_threads():
    # as on a GPU: springs gathered at every node instead of each once; sums in another order, 400 steps
    batch = Batch([mixed(0), mixed(1)], fps=30, substeps=100, double=True, workers=1)
    expected = batch.rollout(4).positions
    batch.kernels = build(batch.laws, True, False, 1, 1)
    for x, y in zip(batch.rollout(4).positions, expected, strict=True):
        assert torch.allclose(x, y, rtol=0, atol=1e-9)


def test_hinges_without_stiffness_are_none():
    system = mixed(0).with_values(bending_stiffness=0.0, torsion_stiffness=0.0, bending_damping=0.0)
    bare = replace(system, hinges=None, natural=None, span=None, flexure=None, chains=())
    np.testing.assert_allclose(positions([system])[0], positions([bare])[0], atol=1e-12)
    assert np.abs(positions([mixed(0)])[0] - positions([bare])[0]).max() > 1e-3


def test_without_links_hinges_to_controllers_are_none():
    # like springs; a hinge through a grip is one through its particle
    system = mixed(0)
    hand = replace(system, controllers=np.concatenate([system.controllers, system.controllers[:, :1] + 0.05], 1), grips=[*system.grips, -1])
    count = len(system.positions)
    more = dict(hinges=np.concatenate([hand.hinges, [[count + 3, 2, 4]]]), natural=None, span=None, flexure=None)
    ties = {**more, "hinges": np.where(np.arange(count - 2 + 2)[:, None] < 0, 0, hand.hinges), "natural": None}
    assert np.array_equal(positions([replace(hand, **more)])[0], positions([replace(hand, **ties)])[0])
    held = np.where(system.hinges == 0, count, system.hinges)  # controller 0 grips particle 0
    assert np.array_equal(positions([replace(system, hinges=held)])[0], positions([system])[0])


def test_a_sheet_resists_folding():
    # a flat square lattice bent about one axis by a small angle a at the middle row: the energy of its hinges there is B a^2 / (2 l) each
    k = np.arange(5)
    points = np.stack(np.meshgrid(0.02 * k, 0.02 * k, [0.0], indexing="ij"), -1).reshape(-1, 3)
    near = np.argwhere(np.triu(np.linalg.norm(points[:, None] - points[None], axis=2) < 0.021, 1))
    hinges = sheet_hinges(points, near)
    assert len(hinges) == 2 * 3 * 5  # every inner node of every row and column
    flat = System(
        positions=points,
        springs=near,
        stiffness=np.full(len(near), 10.0),
        controllers=np.zeros((1, 0, 3)),
        hinges=hinges,
        terms=[k() for k in KINDS],
    ).with_values(**NEUTRAL, bending_stiffness=1e-3)
    assert np.abs(first_push(flat)[0]).max() < 1e-12
    a = 0.1
    beyond = points[:, 0] - 0.04
    folded = np.where(beyond[:, None] > 0, [0.04, 0, 0] + beyond[:, None] * [np.cos(a), 0, np.sin(a)] + points * [0, 1, 0], points)
    force, _ = first_push(replace(flat, positions=folded, span=flat.span, rest=flat.rest))
    # a moment 2 tan(a / 2) B / l on the next nodes: force M / l across, of which 1 / cos^2(a / 2) is the slope's of 2 tan(a / 2)
    rows = np.flatnonzero(np.isclose(points[:, 0], 0.06))
    expected = -2 * np.tan(a / 2) * 1e-3 / 0.02 / 0.02 / np.cos(a / 2) ** 2
    np.testing.assert_allclose(force[rows] @ [-np.sin(a), 0, np.cos(a)], expected, rtol=1e-6)
