"""Facets: which triangles make a skin, what plates feel in air, and what is enclosed."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from twinbench.physics.batch import Batch
from twinbench.physics.facets import enclosed, sheet_facets, solid_facets
from twinbench.physics.stability import stable_step
from twinbench.physics.system import System
from twinbench.physics.terms import Gravity, LinearDrag, PlateDrag, Pressure, Springs
from twinbench.physics.topology import object_springs

G = 9.81
PITCH = 0.02  # m
NOBODY = np.zeros((1, 0, 3))
TRIANGLE = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.1, 0.0]])  # m, 0.01 m^2, normal z


def areas(points, facets):
    """(F, 3) area vectors [m^2]."""
    a, b, c = np.moveaxis(points[facets], 1, 0)
    return np.cross(b - a, c - a) / 2


def sheet(count, bend=0.0):
    """(count^2, 3) a square sheet, rolled up by ``bend`` [1/m] along x, and its springs."""
    flat = np.stack(np.meshgrid(*[PITCH * np.arange(count)] * 2, indexing="ij"), -1).reshape(-1, 2)
    x, z = (np.sin(bend * flat[:, 0]) / bend, (1 - np.cos(bend * flat[:, 0])) / bend) if bend else (flat[:, 0], 0 * flat[:, 0])
    points = np.stack([x, flat[:, 1], z], 1)
    return points, object_springs(points, radius=2.3 * PITCH, max_neighbours=26)


def box(cells, pitch=PITCH):
    return pitch * np.stack(np.meshgrid(*[np.arange(n + 1.0) for n in cells], indexing="ij"), -1).reshape(-1, 3)


# ---------------------------------------------------------------- which triangles


@pytest.mark.parametrize("bend", [0.0, 8.0])
def test_a_sheet_is_covered_once(bend):
    # a square of n x n particles has 2 (n - 1)^2 facets and (n - 1)^2 pitches of area; chords of a roll are shorter than its arcs by the
    # (bend pitch)^2 / 24 = 0.1 %
    points, springs = sheet(7, bend)
    facets = sheet_facets(points, springs)
    assert len(facets) == 2 * 36
    sides = np.sort(np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [0, 2]]]), axis=1)
    assert np.unique(sides, axis=0, return_counts=True)[1].max() == 2  # no three facets meet at a side
    assert np.linalg.norm(areas(points, facets), axis=1).sum() == pytest.approx(36 * PITCH**2, rel=2e-3)


def test_a_sheet_of_uneven_particles_has_nearly_all_its_area():
    # drawn as a diagnosis draws them: the Delaunay triangulation has the hull's area, less what lies along the edge in triangles so flat
    # that the circle around them is larger than springs reach, here 5 %; as seen from above, curved or not
    rng = np.random.default_rng(0)
    flat = rng.uniform(0, 0.2, (900, 2))
    chosen = [0]
    while len(chosen) < 80:  # each the farthest from those before it
        chosen.append(int(np.min([np.linalg.norm(flat - flat[c], axis=1) for c in chosen], axis=0).argmax()))
    flat = flat[chosen]
    points = np.stack([flat[:, 0], flat[:, 1], 0.02 * np.sin(20 * flat[:, 0])], 1)
    facets = sheet_facets(points, object_springs(points, radius=0.055, max_neighbours=26))
    shadow = np.abs(areas(points, facets)[:, 2]).sum()
    assert 0.94 < shadow / ConvexHull(flat).volume <= 1 + 1e-9  # of a plane figure, ``volume`` is the area


def test_two_layers_of_a_folded_sheet_are_not_joined():
    points, springs = sheet(6)
    layers = np.concatenate([points, points + [0.003, 0.004, 0.3 * PITCH]])  # 6 mm apart
    both = np.concatenate([springs, springs + len(points)])
    facets = sheet_facets(layers, both)
    assert len(facets) == 2 * 2 * 25 and (np.ptp(facets // len(points), axis=1) == 0).all()


@pytest.mark.parametrize("cells", [(4, 3, 2), (6, 2, 1)])
def test_the_skin_of_a_block(cells):
    points = box(cells)
    facets = solid_facets(points, radius=PITCH)
    a, b, c = np.array(cells) * PITCH
    assert enclosed(points, facets) == pytest.approx(a * b * c, rel=1e-12)
    assert np.linalg.norm(areas(points, facets), axis=1).sum() == pytest.approx(2 * (a * b + b * c + c * a), rel=1e-12)
    outward = points[facets].mean(1) - points.mean(0)
    assert ((areas(points, facets) * outward).sum(1) > 0).all()


def test_the_skin_follows_a_body_that_is_not_convex():
    # an L of three blocks: the convex hull has half a block more, the skin a prism of half a cell's section in the notch, whose corners are
    # as near as those of a cell
    points = np.unique(np.round(np.concatenate([box((4, 4, 4)), box((4, 4, 4)) + [0.08, 0, 0], box((4, 4, 4)) + [0, 0.08, 0]]), 9), axis=0)
    inside = enclosed(points, solid_facets(points, radius=PITCH))
    assert inside == pytest.approx(3 * 0.08**3 + 0.08 * PITCH**2 / 2, rel=1e-9)
    assert ConvexHull(points).volume == pytest.approx(3.5 * 0.08**3, rel=1e-9)


def test_a_skin_with_a_hole_encloses_nothing():
    points = box((2, 2, 2))
    facets = solid_facets(points, radius=PITCH)
    assert enclosed(points, facets[1:]) == enclosed(points, facets[:0]) == enclosed(points, facets[:, ::-1]) == 0


def test_points_without_a_skin():
    assert solid_facets(sheet(4)[0], radius=0.1).shape == solid_facets(np.zeros((2, 3)), radius=0.1).shape == (0, 3)
    assert solid_facets(box((2, 2, 2)), radius=0.3 * PITCH).shape == (0, 3)  # a cube of cells has circumspheres of 0.87 pitches
    row = np.arange(5)[:, None] * [PITCH, 0, 0]
    assert sheet_facets(row, [[k, k + 1] for k in range(4)]).shape == sheet_facets(row, np.zeros((0, 2))).shape == (0, 3)


@pytest.mark.parametrize(
    ("text", "call"),
    [
        ("points must have shape (M, 3), got (4, 2)", lambda: solid_facets(np.zeros((4, 2)), radius=1.0)),
        ("radius must be > 0 [m], got 0.0", lambda: solid_facets(np.zeros((4, 3)), radius=0.0)),
        ("facets must join particles 0 to 2, got [0, 1, 3] at facet 1", lambda: plate(0.5, facets=[[0, 1, 2], [0, 1, 3]])),
        ("facets must have three different corners, got [0, 2, 2] at facet 0", lambda: plate(0.5, facets=[[0, 2, 2]])),
        ("facets must have shape (F, 3), got (3,)", lambda: plate(0.5, facets=[0, 1, 2])),
    ],
)
def test_wrong_facets_are_refused(text, call):
    with pytest.raises(ValueError, match=re.escape(text)):
        call()


# ---------------------------------------------------------------- plates in air


def plate(c, *, turn=(0, 0, 0), velocity=(0, 0, 0), gravity=0.0, facets=((0, 1, 2),), mass=1e-3):
    """A triangle of 0.01 m^2 that weighs three times ``mass`` [kg]; nothing holds its corners together, and nothing parts them."""
    turned = Rotation.from_rotvec(turn).apply(TRIANGLE)
    return System(
        positions=turned,
        velocities=np.tile(velocity, (3, 1)),
        masses=np.full(3, mass),
        springs=np.zeros((0, 2), int),
        stiffness=[],
        controllers=NOBODY,
        facets=facets,
        terms=[PlateDrag({"plate_drag": c}), Gravity({"gravity_z": -gravity})],
    )


def moved(system, seconds, *, substeps=2000):
    """(x, v) (M, 3) of one system after ``seconds``."""
    _, x, v = Batch([system], fps=1 / seconds, substeps=substeps, double=True).march(0, 1)
    return x.numpy(), v.numpy()


def test_a_plate_that_falls_face_on():
    # m v' = m g - c A v^2: v = u tanh(g t / u), u^2 = m g / (c A), here 1.40 m/s reached to 1e-6; first order in dt = 0.5 ms: g dt = 5 mm/s
    # over a fall, and nothing in its end, where all is steady but for 1 + c A v dt / m = 1.0035 on the drag, half of it on the speed
    terminal = np.sqrt(3e-3 * G / (1.5 * 0.01))
    for seconds, close in ((0.1, G * 5e-5), (1.0, 2e-3 * terminal)):
        _, v = moved(plate(1.5, gravity=G), seconds)
        assert v[:, 2] == pytest.approx(-terminal * np.tanh(G * seconds / terminal), abs=close)
        assert np.abs(v[:, :2]).max() == 0


def test_a_plate_that_moves_edge_on_feels_no_air():
    _, v = moved(plate(1.5, velocity=(1.2, -0.7, 0)), 1.0)
    np.testing.assert_allclose(v, np.tile([1.2, -0.7, 0], (3, 1)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("angle", [0.3, 0.8, 1.2])
def test_a_plate_at_an_angle(angle):
    # only the part along n is slowed: dv_n/dt = -(c A / m) v_n^2, v_n(t) = v_n / (1 + c A v_n t / m); what is across stays
    # c A / m = 5 1/m, v_n < 2 m/s: an error of c A v_n dt / m / 2 = 0.1 % at dt = 0.2 ms
    v0 = 2.0
    n, along = np.array([0, -np.sin(angle), np.cos(angle)]), np.array([0, np.cos(angle), np.sin(angle)])
    _, v = moved(plate(1.5, turn=(angle, 0, 0), velocity=(0, 0, v0)), 0.4)
    through = v0 * np.cos(angle)
    assert v @ n == pytest.approx(through / (1 + 5 * through * 0.4), rel=2e-3)
    np.testing.assert_allclose(v @ along, v0 * np.sin(angle), rtol=1e-9)


def test_both_sides_of_a_plate_are_alike():
    for facets in ([[0, 1, 2]], [[0, 2, 1]]):
        _, v = moved(plate(1.5, velocity=(0, 0, 1.0), facets=facets), 0.1)
        assert v[0, 2] == pytest.approx(1 / 1.5, rel=1e-3)  # 1 / (1 + c A v t / m), c A v t / m = 1/2


def test_air_never_turns_a_plate_around():
    # dt c A v / m = 1e4: as a force, the first substep would throw it back
    _, v = moved(plate(1e6, velocity=(0, 0, 1.0)), 0.1, substeps=20)
    assert (v[:, 2] >= 0).all() and v[0, 2] < 1e-3


# ---------------------------------------------------------------- what is enclosed


def ball(scale=1.0, speed=None, **values):
    """Random particles under a convex skin, pressed but otherwise free; the volume of frame 0 is that at scale 1."""
    points = np.random.default_rng(3).normal(size=(40, 3))
    points = 0.1 * points / np.linalg.norm(points, axis=1, keepdims=True)
    facets = solid_facets(points, radius=0.2)
    given = dict(springs=np.zeros((0, 2), int), stiffness=[], controllers=NOBODY, facets=facets, velocities=speed)
    return System(positions=points, masses=np.full(40, 0.01), terms=[Pressure(values)], **given), scale * points


def pushes(system, x, dt=1e-6):
    """(M, 3) forces [N] at ``x``: what a substep adds to momenta."""
    batch = Batch([system], fps=1 / dt, substeps=1, dt=dt, double=True)
    _, _, v = batch.march(0, 1, replace(batch.inputs, x=torch.tensor(x)))
    return v.numpy() * system.masses[:, None] / dt


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.1])
def test_pressure_by_volume(scale):
    # p = k (V0 / V - 1), V / V0 = scale^3; p A n on each facet, a third of it on each corner
    system, x = ball(scale, pressure=3000.0)
    force = np.zeros_like(x)
    np.add.at(force, system.facets, (3000.0 * (scale**-3 - 1) * areas(x, system.facets) / 3)[:, None])
    np.testing.assert_allclose(pushes(system, x), force, rtol=0, atol=1e-9)
    assert np.abs(force).max() > 0.5 or scale == 1


def test_pressure_neither_pushes_nor_turns_the_whole():
    # what is inside is at rest: no net force and no net moment, whatever the shape
    system, x = ball(pressure=3000.0)
    x = x @ np.diag([1.2, 0.8, 0.9]) + 0.02 * np.sin(40 * x)[:, [1, 2, 0]]
    force = pushes(system, x)
    assert np.abs(force).max() > 0.3
    np.testing.assert_allclose(force.sum(0), 0, atol=1e-9)
    np.testing.assert_allclose(np.cross(x, force).sum(0), 0, atol=1e-9)


def test_pressure_is_the_gradient_of_its_work():
    # W = k (V - V0 log V), the work of compression up to a constant: F = -dW/dx = k (V0 / V - 1) dV/dx; central differences of h = 1e-5 m
    # are off by h^2 and by 1e-16 W / h
    system, x = ball(pressure=3000.0)
    x = x @ np.diag([1.1, 0.8, 0.9])
    start = enclosed(system.positions, system.facets)

    def work(at):
        volume = enclosed(at, system.facets)
        return -3000.0 * (start * np.log(volume / start) - volume)

    force = pushes(system, x)
    for particle, axis in ((0, 0), (7, 2), (21, 1)):
        step = np.zeros_like(x)
        step[particle, axis] = 1e-5
        assert force[particle, axis] == pytest.approx(-(work(x + step) - work(x - step)) / 2e-5, rel=1e-6, abs=1e-7)


def test_a_body_that_is_filled_swells_to_its_filling():
    # nothing else acts: it is at rest where V = fill V0; damped by air
    system, _ = ball(pressure=3000.0, pressure_fill=1.3)
    damped = replace(system, terms=[*system.terms, LinearDrag({"drag_damping": 20.0})])
    x, v = moved(damped, 3.0, substeps=6000)
    assert enclosed(x, system.facets) == pytest.approx(1.3 * enclosed(system.positions, system.facets), rel=1e-6)
    assert np.abs(v).max() < 1e-6


def test_a_gas_keeps_its_energy():
    # no damping: kinetic energy and the work of compression sum to a constant; a semi-implicit step oscillates about it by the order of dt
    system, x = ball(pressure=3000.0, speed=None)
    swing = -0.8 * x / 0.1  # m/s inward: 0.13 J, which squeezes it by a tenth
    system = replace(system, velocities=swing)
    start = enclosed(system.positions, system.facets)

    def energy(at, v):
        volume = enclosed(at, system.facets)
        return 0.005 * (v**2).sum() - 3000.0 * (start * np.log(volume / start) - (volume - start))

    first = energy(system.positions, swing)
    for seconds, share in ((0.01, 0.3), (0.019, 1.0)):  # a quarter and half a period
        at, v = moved(system, seconds)
        assert energy(at, v) == pytest.approx(first, rel=2e-3)
        assert (v**2).sum() / (swing**2).sum() == pytest.approx(share, abs=0.3)


def test_the_stable_step_of_what_is_enclosed():
    # a breathing ball: just below the limit of the linear analysis it stays, far above it does not; the bound is never above that limit
    system, _ = ball(pressure=3000.0)
    a = np.zeros((40, 3))
    np.add.at(a, system.facets, (areas(system.positions, system.facets) / 3)[:, None])
    lam = 3000.0 / enclosed(system.positions, system.facets) * (a**2).sum() / 0.01  # the one eigenvalue of K / m
    assert stable_step(system) == pytest.approx(2 / np.sqrt(lam), rel=0.3) and stable_step(system) <= 2 / np.sqrt(lam)
    aside = 1e-4 * a / np.linalg.norm(a)
    for times, holds in ((0.95, True), (1.1, False)):
        dt = times * 2 / np.sqrt(lam)
        batch = Batch([system], fps=1 / dt, substeps=1, dt=dt, double=True)
        out, _, _ = batch.march(0, 60, replace(batch.inputs, x=torch.tensor(system.positions + aside)))
        assert (np.abs(out.numpy() - system.positions).max() < 1e-3) == holds


def test_an_open_skin_is_not_pressed():
    points, springs = sheet(4)
    system = System(
        positions=points,
        springs=springs,
        stiffness=np.full(len(springs), 10.0),
        controllers=NOBODY,
        facets=sheet_facets(points, springs),
        terms=[Springs(), Pressure({"pressure": 1e4})],
    )
    x, _ = moved(system, 0.1, substeps=50)
    np.testing.assert_array_equal(x, points)


def test_systems_of_a_batch_are_pressed_by_their_own_volumes():
    systems = [ball(pressure=k, pressure_fill=fill)[0] for k, fill in ((1000.0, 1.2), (3000.0, 0.9))]
    together = Batch(systems, fps=30, substeps=100, double=True, workers=1).rollout(3).positions
    for one, both in zip(systems, together, strict=True):
        alone = Batch([one], fps=30, substeps=100, double=True).rollout(3).positions[0]
        assert (alone == both).all() and (both[-1] - both[0]).abs().max() > 1e-3
