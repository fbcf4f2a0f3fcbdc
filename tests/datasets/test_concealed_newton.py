"""Newton's cloths and stuffed bodies in the concealed set against closed forms of stretch, bending and friction, and finite elements."""

import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from probes import holding, sheet, stretched, watch
from twinbench.datasets.concealed import bodies, finite, laws, motions
from twinbench.datasets.concealed import engine as mujoco_engine
from twinbench.datasets.concealed import newton_bodies as newton_engine
from twinbench.datasets.concealed.bodies import Body, lumped
from twinbench.datasets.concealed.case import build, rms
from twinbench.datasets.concealed.effects import EFFECTS, OUTSIDE
from twinbench.datasets.concealed.engines import able
from twinbench.datasets.concealed.motions import Script
from twinbench.datasets.concealed.newton_bodies import World, march, simulate
from twinbench.datasets.concealed.newton_bodies.material import Elements
from twinbench.datasets.concealed.world import Obstacle, Physics, Unstable
from twinbench.datasets.synthetic.simulate import GRAVITY

pytest.importorskip("newton", reason="Newton is not installed: pip install 'newton>=1.8'")

FREE = Script("free", (), 31)  # a second without hands
NOWHERE = Physics(gravity=(0.0, 0.0, 0.0))
DT = 1 / 960


def bar(*, cells=(10, 2, 2), pitch=0.02, height=0.5, young=3000.0, density=100.0, **more):
    """A bar of foam along x, each cube of it in six tetrahedra."""
    nx, ny, nz = (n + 1 for n in cells)
    grid = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape(nx, ny, nz)
    elements = []
    for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):  # from corner to corner, along the axes in turn
        steps = np.zeros((4, 3), int)
        for k, axis in enumerate(order):
            steps[k + 1] = steps[k] + np.eye(3, dtype=int)[axis]
        corners = [number[s[0] : s[0] + cells[0], s[1] : s[1] + cells[1], s[2] : s[2] + cells[2]].ravel() for s in steps]
        even = np.linalg.det(np.eye(3)[list(order)]) > 0
        elements.append(np.stack(corners if even else [corners[0], corners[2], corners[1], corners[3]], 1))
    elements, vertices = np.concatenate(elements), grid * pitch + [0, 0, height]
    about = {"drag": 0.0, "damping": 0.0} | more
    body = Body("plush", vertices, elements, np.zeros((0, 3), int), np.ones(len(grid)), 1e-3, young, **about)
    return replace(body, mass=lumped(elements, body.measure, density * body.measure.sum(), len(grid)))


def pushing(force, until):
    """A law: ``force`` (3,) [N], shared by all vertices as they weigh, from frame 0 until a time [s]."""

    def start(world):
        share = (world.body.mass / world.body.mass.sum())[:, None]
        return lambda time, x, v: share * force if 0 <= time < until else None

    return start


def ends_pulled(body, stress):
    """(V, 3) forces [N] of a ``stress`` [Pa] on the facets at both ends of a bar."""
    force = np.zeros_like(body.vertices)
    for place, sign in ((body.vertices[:, 0].max(), 1), (body.vertices[:, 0].min(), -1)):
        there = np.isclose(body.vertices[:, 0], place)[body.elements]
        facets = body.elements[there.sum(axis=1) == 3][there[there.sum(axis=1) == 3]].reshape(-1, 3)
        a, b, c = np.moveaxis(body.vertices[facets], 1, 0)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        np.add.at(force[:, 0], facets, (sign * stress * area / 3)[:, None])
    return force


def apart(body, x, axis):
    """By which share two opposite sides of a bar have come apart."""
    place = body.vertices[:, axis]
    low, high = (np.isclose(place, side) for side in (place.min(), place.max()))
    return (x[high, axis].mean() - x[low, axis].mean()) / np.ptp(place) - 1


def drawn(kind, how, seed, frames):
    body = bodies.draw(kind, np.random.default_rng(seed))
    return body, replace(motions.draw(how, body, np.random.default_rng(seed)), frames=frames)


# --- the material ---------------------------------------------------------------------------------------------------------------------


def energy(body, x):
    """Stable neo-Hookean energy (Smith, de Goes, Kim 2018, without their logarithm): mu/2 (I_C - d) + lambda/2 (J - 1 - mu/lambda)^2."""
    mu, nu = body.young / 2 / (1 + body.poisson), body.poisson
    lame = mu + body.young * nu / (1 + nu) / ((1 - nu) if body.dim == 2 else (1 - 2 * nu))
    total = 0.0
    for corners, size in zip(body.elements, body.measure * (body.thickness if body.dim == 2 else 1), strict=True):
        rest, now = (np.linalg.qr((y[corners[1:]] - y[corners[0]]).T)[1] for y in (body.vertices, x))
        gradient = now @ np.linalg.inv(rest)
        total += size * (mu / 2 * (gradient**2).sum() + lame / 2 * (abs(np.linalg.det(gradient)) - 1 - mu / lame) ** 2)
    return total


@pytest.mark.parametrize("kind", ["cloth", "plush"])
def test_the_pull_of_elements_is_the_slope_of_their_energy(kind):
    body = sheet(cells=1, poisson=0.3) if kind == "cloth" else bar(cells=(1, 1, 1))
    elements = World(body, FREE, NOWHERE, 32).elements
    x = body.vertices + 0.1 * np.ptp(body.vertices, axis=0).max() * np.random.default_rng(0).uniform(-1, 1, body.vertices.shape)
    force = elements.pull(x, x, DT, np.ones(len(body.elements)))
    step = 1e-6
    for v, axis in np.ndindex(3, 3):
        shift = np.zeros_like(x)
        shift[v, axis] = step
        slope = (energy(body, x + shift) - energy(body, x - shift)) / (2 * step)
        assert force[v, axis] == pytest.approx(-slope, rel=1e-5, abs=1e-6 * np.abs(force).max())  # central differences


def test_newtons_elements_pull_as_they_are_said_to():
    # What ``grip_force`` says is worked out beside Newton: where one vertex is free, its acceleration in one step is Newton's own force.
    for body in (sheet(cells=1, poisson=0.3, bending=5.0), bar(cells=(1, 1, 1))):
        world = World(body, holding(body.vertices[0], reach=0.0), NOWHERE, 32)
        world.held[:] = True
        world.held[3] = False
        world.begin()
        x = world.start + 0.02 * np.ptp(body.vertices, axis=0).max() * np.random.default_rng(1).uniform(-1, 1, world.start.shape)
        world.scene.q[:] = x
        world.x = x
        world.gripped = (np.flatnonzero(world.held),)
        world.step(x[world.held], np.zeros_like(x))
        pulled = world.elements.pull(world.x, world.before, world.dt, world.own)
        pulled += world.bends.pull(world.x, world.before, world.dt, world.intact) if world.bends else 0
        np.testing.assert_allclose(body.mass[3] * world.v[3] / world.dt, pulled[3], rtol=0.01, atol=1e-3 * np.abs(pulled).max())
        np.testing.assert_allclose(world.x[world.held], x[world.held], atol=1e-7)  # what is held goes where it is sent


def test_a_branch_relaxes_exponentially_or_gives_way():
    body, tau, limit = sheet(), 0.2, 0.004
    elements, x = World(body, FREE, NOWHERE, 32).elements, stretched(body, 0.02)
    elements.add(2.5, tau=tau)
    elements.add(1.0, limit=limit)
    for _ in range(round(0.3 / DT)):
        elements.flow(x, DT)
    gradient = elements.gradient(x)
    _, relaxed, slid = (np.log(np.linalg.svd(gradient @ layer.resting, compute_uv=False)).sum(axis=1) for layer in elements.layers)
    # Maxwell: the stretch left after a step of strain is exp(-t / tau) of it, exactly so in the logarithmic strain
    np.testing.assert_allclose(relaxed, np.log(1.02) * np.exp(-0.3 / tau), rtol=1e-6)
    np.testing.assert_allclose(slid, limit / np.sqrt(1.5), rtol=1e-6)  # the size of a strain with one entry e is sqrt(3/2) e


def test_a_plastic_body_keeps_its_strain_and_its_volume():
    body = bar(cells=(2, 1, 1), yields=(0.01, 0.0))
    elements = Elements(body, World(body, FREE, NOWHERE, 32).elements.poses)
    flat = body.vertices * [1.06, 1 / np.sqrt(1.06), 1 / np.sqrt(1.06)]  # of the same volume
    elements.flow(flat, DT)
    resting = elements.layers[0].resting.copy()
    np.testing.assert_allclose(np.linalg.det(resting), 1, rtol=1e-12)
    strain = np.log(np.linalg.svd(elements.gradient(flat) @ resting, compute_uv=False))
    # uniaxial: the size is 3/2 of the axial strain, and what is left is at the limit
    np.testing.assert_allclose(np.sqrt(1.5) * np.linalg.norm(strain, axis=1), 0.01, rtol=1e-9)
    elements.flow(flat, DT)
    np.testing.assert_allclose(elements.layers[0].resting, resting, atol=1e-12)  # holding is no flow


# --- statics --------------------------------------------------------------------------------------------------------------------------


def test_a_hanging_strip_is_as_long_as_its_weight_makes_it():
    length, width, tension, mass = 0.2, 0.025, 30.0, 0.001
    body = sheet(size=length, width=width, cells=8, tension=tension, mass=mass, drag=15.0)
    hang = np.stack([0 * body.vertices[:, 0], body.vertices[:, 1] - width / 2, 0.6 - body.vertices[:, 0]], 1)
    body = replace(body, vertices=hang)
    motion = simulate(body, holding((0, 0, 0.6), frames=45, reach=0.013), settle=0.0)
    assert motion.gripped[0].tolist() == [0, 1]
    # m g L / (2 E t w), 0.7 %; the next order in the strain is 0.4 % of that.
    longer = mass * GRAVITY * length / (2 * tension * width)
    ends = motion.vertices[-1, [0, 1], 2].mean() - motion.vertices[-1, [-2, -1], 2].mean()  # halved squares weigh unevenly on both sides
    assert ends - length == pytest.approx(longer, rel=0.02)


@pytest.mark.parametrize("fibre", [0.0, 3.0])
def test_a_pulled_bar_of_foam_stretches_and_narrows(fibre):
    young, nu, stress = 3000.0, 0.3, 30.0
    body = bar(cells=(5, 2, 2), young=young, poisson=nu, damping=0.02, drag=10.0, fibre=(fibre * young, 0, 0))
    force = ends_pulled(body, stress)
    x = simulate(body, FREE, replace(NOWHERE, laws=(lambda world: lambda time, x, v: force,))).vertices[-1]
    # Hooke: e = sigma / (E + modulus of the fibres), and -nu e across; of the second order in the strain some per cent of these
    strain = stress / young / (1 + fibre)
    assert apart(body, x, 0) == pytest.approx(strain, rel=0.03)
    assert apart(body, x, 1) == pytest.approx(-nu * strain, rel=0.05)


def test_a_strip_of_cloth_bends_as_a_plate():
    size, width, mass, tension = 0.12, 0.04, 0.0015, 60.0
    body = sheet(size=size, width=width, cells=6, height=0.5, tension=tension, mass=mass, bending=1200.0, drag=20.0)
    motion = simulate(body, holding((-0.02, 0.02, 0.5), frames=45, reach=0.0471), settle=0.0)
    held = np.unique(body.vertices[motion.gripped[0], 0])
    rigidity = 1200.0 * tension * 1e-3**2 / 12 * width
    free = size - held.max() + 0.01  # an edge bends with half a cell on either side
    sag = motion.vertices[-1, 0, 2] - motion.vertices[-1, -1, 2]
    assert len(held) >= 2
    # Clamped plate under its own weight, small deflections: w L^4 / (8 D b), on a mesh of five free cells to a tenth
    assert sag == pytest.approx(mass / size * GRAVITY * free**4 / (8 * rigidity), rel=0.1)
    other = finite.simulate(body, holding((-0.02, 0.02, 0.5), frames=45, reach=0.0471), settle=0.0).vertices[-1]
    assert sag == pytest.approx(other[0, 2] - other[-1, 2], rel=2e-3)  # the same shells, solved otherwise


# --- dynamics -------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", newton_engine.BODIES)
def test_free_fall(kind):
    body = replace(bodies.draw(kind, np.random.default_rng(0)), drag=0.0, damping=0.002)  # not so viscous that steps are halved
    body = replace(body, vertices=body.vertices + [0, 0, 0.3])
    motion = simulate(body, Script("fall", (), 7), settle=0.0)
    fallen = motion.vertices[0] - motion.vertices[-1]
    # g t^2 / 2, and g t dt / 2 more in implicit Euler steps; single precision rounds places of 0.3 m by 1.5e-8 m in a step: accelerations
    # that err by 0.014 m/s^2 at most, over 0.2 s
    np.testing.assert_allclose(fallen[:, 2], GRAVITY * 0.2 * (0.2 + DT) / 2, atol=0.014 * 0.2**2 / 2)
    np.testing.assert_allclose(fallen[:, :2], 0, atol=0.014 * 0.2**2 / 2)


def test_drag_limits_the_speed():
    body = sheet(height=3.0, drag=20.0)
    motion = simulate(body, FREE, settle=0.0)
    speed = np.diff(motion.vertices[-2:], axis=0)[0, :, 2] * 30
    np.testing.assert_allclose(speed, -GRAVITY / 20.0, rtol=5e-3)  # m g = m c v, after 20 times 1 / c


@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_a_stretched_sheet_rings_and_dies_out_as_it_should(damping):
    length, tension, mass = 0.3, 4.0, 0.05
    body = sheet(size=length, width=0.06, cells=10, height=0.5, tension=tension, mass=mass, damping=damping)
    areal = mass / (length * 0.06)
    world = World(body, holding((-0.1, 0.03, 0.5), frames=60, reach=0.105), NOWHERE, 32)
    clamp = body.vertices[world.gripped[0], 0].max()
    free = length - clamp
    world.begin()
    world.x = world.start + 0.004 * np.sin(np.pi / 2 * np.maximum(body.vertices[:, 0] - clamp, 0) / free)[:, None] * [1, 0, 0]
    world.scene.q[:] = world.x
    end, far = int(np.argmax(body.vertices[:, 0])), []
    for _ in range(1400):
        far.append(world.x[end, 0] - world.start[end, 0])
        world.step(world.start[np.concatenate(world.gripped)], np.zeros_like(world.x))
    far = np.array(far)
    cross = np.flatnonzero(np.diff(np.sign(far)))
    frequency = np.pi / (np.diff(cross).mean() * DT)
    peaks = np.array([np.abs(far[a:b]).max() for a, b in pairwise(cross)])
    decay = -np.polyfit((cross[1:] + cross[:-1]) / 2 * DT, np.log(peaks), 1)[0]
    # Fixed-free bar: w = pi / (2 L) sqrt(E t / areal); Kelvin-Voigt: decay w^2 tau / 2, and w^2 dt / 2 more by implicit Euler steps.
    expected = np.pi / 2 / free * np.sqrt(tension / areal)
    assert frequency == pytest.approx(expected, rel=0.02)
    assert decay == pytest.approx(expected**2 * (damping + DT) / 2, rel=0.06, abs=0.02)  # single precision gives and takes 0.01 / s


@pytest.mark.long
def test_finer_steps_and_more_iterations_change_little(monkeypatch):
    body, script = drawn("plush", "circle", 3, 20)
    coarse, fine = (simulate(body, script, substeps=per).vertices for per in (32, 64))
    monkeypatch.setattr(march, "ITERATIONS", 2 * march.ITERATIONS)
    more = simulate(body, script).vertices
    travelled = rms(coarse[-1] - coarse[0])
    assert travelled > 0.1
    assert rms(more - coarse) < 2e-3 * travelled
    # implicit Euler steps lag by a step or so, 1 ms of a motion of less than a metre a second
    assert rms(fine - coarse) < 1.5e-3


@pytest.mark.long
@pytest.mark.parametrize("kind, most", [pytest.param("cloth", 3e-3, marks=pytest.mark.slow), ("plush", 1e-3)])
def test_both_kinds_of_elements_agree(kind, most):
    # Two discretisations in time and two materials (Smith's and the logarithmic one) that agree to the first order of the strain
    body, script = drawn(kind, "drag", 1, 30)
    one, other = simulate(body, script).vertices, finite.simulate(body, script).vertices
    assert rms(one[-1] - one[0]) > 0.05
    assert rms(one - other) < most


@pytest.mark.slow
def test_mujocos_stuffed_bodies_move_alike():
    # A third material, St. Venant-Kirchhoff's, and a third scheme in time; a bar in free air, where it bends but nothing buckles
    pytest.importorskip("mujoco")
    body, script = drawn("plush", "circle", 4, 30)
    one, other = simulate(body, script).vertices, mujoco_engine.simulate(body, script).vertices
    assert rms(one[-1] - one[0]) > 0.1
    assert rms(one - other) < 2e-3


@pytest.mark.long
def test_one_seed_one_motion_bit_for_bit():
    body, script = drawn("cloth", "lift_shake", 0, 6)
    np.testing.assert_array_equal(*(simulate(body, script).vertices for _ in range(2)))


def test_a_step_too_far_is_reported():
    with pytest.raises(Unstable, match="free of cloth after"):
        simulate(sheet(), FREE, Physics(laws=(lambda world: lambda time, x, v: 1e4 * v + 10.0,)))


# --- contact --------------------------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(  # viscosities of 4,570, 50, 1,140 and 890 Pa s
    "seed, damping", [(0, 4.0), (4, 1.0), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((0, 1.0), (2, 1.0)))]
)
def test_a_resting_body_is_carried(seed, damping):
    body = bodies.draw("plush", np.random.default_rng(seed))
    body = replace(body, damping=damping * body.damping)
    law, kept = watch(lambda world: world.table_force().sum())
    motion = simulate(body, FREE, Physics(laws=(law,)))
    carried = np.mean([force for time, force in kept if time > 0.5])
    # a few sweeps over the vertices a step leave some of a viscous body's force on its way
    assert carried == pytest.approx(body.mass.sum() * GRAVITY, rel=5e-3)
    assert motion.vertices[-1, :, 2].min() > body.radius - 1e-3


def test_sliding_stops_where_friction_says():
    mu = 0.3
    body = sheet(friction=mu, mass=0.02, drag=0.0)
    force = np.array([0.02 * (GRAVITY * mu + 6.0), 0, 0])  # 6 m/s^2 for 0.1 s
    physics = Physics(laws=(pushing(force, 0.1),))
    motion = simulate(body, FREE, physics)
    way = (motion.vertices[-1] - motion.vertices[0]).mean(axis=0)
    # v^2 / (2 a) while it is pushed, v^2 / (2 mu g) until it stops; first order in dt, v dt at most in each part
    assert way[0] == pytest.approx(0.6**2 / 2 / 6.0 + 0.6**2 / (2 * mu * GRAVITY), abs=2 * 0.6 * DT)
    assert np.abs(np.diff(motion.vertices[-3:], axis=0)).max() < 1e-5


@pytest.mark.parametrize("rise, mu", [(0.5, 0.25), (0.2, 0.25)])
def test_a_tilted_table_holds_up_to_the_angle_of_friction(rise, mu):
    body = sheet(friction=mu)
    ground = (0.0, rise, 0.0)
    body = replace(body, vertices=body.vertices + np.stack([0 * (h := rise * body.vertices[:, 0]), 0 * h, h + 1e-4], 1))
    motion = simulate(body, FREE, Physics(ground=ground), settle=0.0)
    cosine = 1 / np.hypot(1, rise)
    way = -(motion.vertices[-1] - motion.vertices[0]).mean(axis=0) @ [cosine, 0, cosine * rise]
    if rise > mu:
        assert way == pytest.approx(GRAVITY * cosine * (rise - mu) / 2, rel=0.02)  # a t^2 / 2 for a second
    else:
        assert 0 <= way < 1.5e-3  # friction grows with the speed up to 1 mm/s, and here needs most of that


def test_a_moving_table_carries_along():
    motion = simulate(sheet(friction=0.5), FREE, Physics(belt=(0.1, -0.05)))
    speed = (motion.vertices[-1] - motion.vertices[-2]).mean(axis=0) * 30
    np.testing.assert_allclose(speed, [0.1, -0.05, 0], atol=1e-3)


@pytest.mark.parametrize("shape", ["sphere", "cylinder", "box"])
def test_an_obstacle_holds_a_cloth_up(shape):
    body = sheet(size=0.06, cells=6, height=0.11, tension=200.0, drag=5.0, friction=1.0)
    x = simulate(body, FREE, Physics(obstacles=(Obstacle(shape, (0.03, 0.03, 0.05), 0.05),))).vertices[-1]
    middle = x[np.linalg.norm(body.vertices[:, :2] - 0.03, axis=1) < 0.001]
    np.testing.assert_allclose(middle[0, 2], 0.1 + body.radius, atol=5e-4)


# --- laws -----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_grip_carries_the_weight_and_slips_by_what_it_may():
    body, most = sheet(height=0.5, drag=5.0), 0.03
    weight = body.mass.sum() * GRAVITY
    law, kept = watch(lambda world: world.grip_force(0))
    script = holding(body.vertices[0], frames=48)
    held = simulate(body, script, Physics(laws=(law,)), settle=0.0)
    np.testing.assert_allclose(np.mean([f for t, f in kept if t > 1.2], axis=0), [0, 0, -weight], atol=0.03 * weight)
    slipped = simulate(body, script, Physics(laws=(laws.slip(0.5 * weight, 1.0 / weight, most),)), settle=0.0)
    down = [m.vertices[-1, m.gripped[0]].mean(axis=0) - m.position[0, -1] for m in (slipped, held)]
    assert np.linalg.norm(down[0] - down[1]) == pytest.approx(most, rel=0.15) and "slip" in slipped.events


def test_a_soft_grip_gives_by_weight_over_stiffness():
    body = sheet(height=0.5, drag=5.0, damping=0.005)
    weight = body.mass.sum() * GRAVITY
    stiffness = weight / 0.02
    law, kept = watch(lambda world: world.grip_force(0))
    physics = Physics(laws=(laws.soft_grip(stiffness, 2 * np.sqrt(stiffness * body.mass.sum())), law))
    motion = simulate(body, holding(body.vertices[0], frames=60), physics, settle=0.0)
    down = motion.vertices[:, motion.gripped[0], 2].mean(axis=1)
    assert down[0] - down[-1] == pytest.approx(0.02, rel=0.03)  # m g / k, after it has come to rest
    np.testing.assert_allclose(np.mean([f for t, f in kept if t > 1.5], axis=0), [0, 0, -weight], atol=0.02 * weight)


def test_a_torn_seam_carries_nothing():
    body = sheet(height=0.5, cells=5, tension=200.0)
    middle = np.abs(body.vertices[body.elements].mean(axis=1)[:, 0] - 0.05) < 0.01
    physics = Physics(laws=(laws.tear(np.flatnonzero(middle), 0.3),))
    motion = simulate(body, holding((0.0, 0.05, 0.5), frames=20, reach=0.055), physics, settle=0.0)
    part = body.vertices[:, 0] > 0.055
    loose = motion.vertices[:, part, 2] @ body.mass[part] / body.mass[part].sum()
    assert motion.events["tear"] == 9
    assert np.diff(loose[10:18], 2).mean() * 900 == pytest.approx(-GRAVITY, rel=0.005)  # its centre of mass falls freely


@pytest.mark.parametrize("law, ratio", [(laws.timed_stiffness(0.5, 0.0, 0.1), 2.0), (laws.maxwell(1.0, 0.05), 1.0)])
def test_a_bar_gives_by_what_is_left_of_its_stiffness(law, ratio):
    # Half as stiff it stretches twice as far; beside a branch that has relaxed, as far as without, and until then half of it
    body, stress = bar(cells=(5, 2, 2), damping=0.02, drag=10.0), 30.0
    force = ends_pulled(body, stress)
    physics = replace(NOWHERE, laws=(law, lambda world: lambda time, x, v: force))
    x = simulate(body, FREE, physics, settle=0.0).vertices[-1]
    assert apart(body, x, 0) == pytest.approx(ratio * stress / 3000.0, rel=0.03)


def test_a_sheet_that_would_be_shorter_shrinks():
    body, strain = sheet(poisson=0.3, height=1.0, damping=0.01, drag=5.0), -0.05
    motion = simulate(body, FREE, replace(NOWHERE, laws=(laws.shrinks(strain),)))
    np.testing.assert_allclose(np.ptp(motion.vertices[-1], axis=0)[:2], 0.1 * (1 + strain), rtol=1e-3)


# --- the module -----------------------------------------------------------------------------------------------------------------------


def test_what_it_simulates():
    assert able("newton", "cloth", ["bending"]) and able("newton", "plush", ["tearing"])
    assert not able("newton", "rope", []) and not able("newton", "cloth", ["self_contact"])
    assert set(newton_engine.UNABLE) < set(EFFECTS) | set(OUTSIDE)
    assert newton_engine.about()["newton"]
    with pytest.raises(ValueError, match="simulates cloth and plush, got a rope"):
        simulate(bodies.draw("rope", np.random.default_rng(0)), FREE)
    with pytest.raises(ValueError, match="moving table must be without obstacles"):
        simulate(sheet(), FREE, Physics(belt=(0.1, 0), obstacles=(Obstacle("sphere", (1, 1, 1), 0.1),)))


def test_without_newton_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "newton", None)
    with pytest.raises(ValueError, match="pip install 'newton"):
        newton_engine.about()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, body",
    [("gravity_tilt", "plush"), ("viscoelastic", "plush"), ("bending", "cloth"), ("grip_slip", "cloth"), ("anisotropy", "cloth")],
)
def test_a_case_of_the_named_engine(name, body):
    case = build("effect", name, body, seed=3, engine="newton")
    assert "newton" in case.label["engine"]
    assert 0.010 <= case.label["displacement"] <= 0.060 * EFFECTS[name].most and case.label["chaos"] < 0.015
