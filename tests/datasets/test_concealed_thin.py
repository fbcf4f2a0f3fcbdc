"""Resolved ropes and cloths of the concealed set: what hands hold of them, and how they bend, on several meshes, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.datasets.concealed import bodies, motions
from twinbench.datasets.concealed.bodies import Body, lumped
from twinbench.datasets.concealed.engines import engine
from twinbench.datasets.concealed.finite import World
from twinbench.datasets.concealed.finite.banded import Banded
from twinbench.datasets.concealed.finite.continuum import Continuum
from twinbench.datasets.concealed.finite.plates import Plates
from twinbench.datasets.concealed.finite.shells import Creases
from twinbench.datasets.concealed.motions import Script
from twinbench.datasets.concealed.sensing import Faults, Tracker, observe
from twinbench.datasets.concealed.thin import triangulated
from twinbench.datasets.concealed.world import Motion, Physics
from twinbench.datasets.synthetic.interactions import Interaction
from twinbench.datasets.synthetic.simulate import GRAVITY, to_world
from twinbench.methods.continuum.hands import bar_of, labels_of

ALOFT = Physics(ground=(-1.0, 0.0, 0.0))


def drawn(kind, seed, **how):
    return bodies.draw(kind, np.random.default_rng(seed), thin="resolved", **how)


@pytest.mark.parametrize("kind", ["rope", "cloth"])
def test_a_refined_body_is_the_same_body(kind):
    for seed in range(4):
        one, fine = drawn(kind, seed), drawn(kind, seed, refine=2)
        assert (fine.young, fine.bending, fine.axial, fine.friction) == (one.young, one.bending, one.axial, one.friction)
        assert np.linalg.norm(one.vertices[:, None] - fine.vertices, axis=2).min(axis=1).max() < 1e-9
        assert fine.mass.sum() == pytest.approx(one.mass.sum())
        assert len(fine.elements) == len(one.elements) * 2**one.dim
        # a rope's segments are chords of its bow: shorter than it by (0.6 / 80)^2 / 24
        assert fine.measure.sum() == pytest.approx(one.measure.sum(), rel=1e-5)


@pytest.mark.parametrize("kind", ["rope", "cloth"])
def test_a_hand_holds_the_same_material_of_every_mesh(kind):
    for seed in range(6):
        one = drawn(kind, seed)
        hand = motions.draw("lift", one, np.random.default_rng(seed)).hands[0]
        whole = []
        for refine in (1, 2, 3):
            body = drawn(kind, seed, refine=refine)
            held = np.isin(np.arange(len(body.vertices)), body.held(hand.grip, hand.grip_radius))
            within = held[body.elements].all(axis=1)
            # elements fill what is held: length or area, and the ends of it
            assert np.array_equal(np.unique(body.elements[within]), np.flatnonzero(held))
            whole.append([body.measure[within].sum(), *body.vertices[held].min(axis=0), *body.vertices[held].max(axis=0)])
        assert np.allclose(whole[1:], whole[0], rtol=1e-5, atol=1e-9)
        assert 0 < whole[0][0] < 0.3 * one.measure.sum()


def test_unknown_meshes_are_refused():
    with pytest.raises(ValueError, match="thin must be one of coarse, resolved, got 'silk'"):
        bodies.draw("rope", np.random.default_rng(0), thin="silk")


# --- ropes ----------------------------------------------------------------------------------------------------------------------------

HELD, FREE, RIGIDITY, LINE = 0.03, 0.12, 5e-3, 0.08  # m, m, N m^2, kg/m


def cantilever(count, degrees, **more):
    """A straight rope of ``count`` segments along a direction in the plane, and a hand that holds its first ``HELD``."""
    s, way = np.linspace(0, HELD + FREE, count + 1), np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0])
    elements = np.stack([np.arange(count), np.arange(1, count + 1)], 1)
    radius = 4e-3
    young, block = RIGIDITY / (np.pi * radius**4 / 4), np.flatnonzero(s < HELD + 1e-9)[None]
    about = {"drag": 0.0, "damping": 0.01, "shear": 1e-3 * young, "resolved": True, "axial": 200.0, "blocks": block} | more
    body = Body("rope", s[:, None] * way, elements, np.zeros((0, 3), int), np.ones(count + 1), radius, young, **about)
    body = replace(body, mass=lumped(elements, body.measure, LINE * (HELD + FREE), count + 1))
    still = Interaction("hand", grip=tuple(body.vertices[0]), grip_radius=0.01, times=(0.0, 1.0), moves=((0.0,) * 3,) * 2)
    return body, Script("still", (still,), 25)


@pytest.mark.parametrize(
    "count, degrees", [(20, 0), (40, 30), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((20, 30), (40, 0)))]
)
@pytest.mark.parametrize("by", ["finite", "mujoco", pytest.param("cosserat", marks=pytest.mark.long)])
def test_a_held_rope_sags_as_a_cantilever(by, count, degrees):
    pytest.importorskip({"finite": "scipy", "mujoco": "mujoco", "cosserat": "elastica"}[by])
    body, script = cantilever(count, degrees)
    # q L^4 / (8 E I) where the hand ends: 4 mm, a thirtieth of L, so that large angles take less than 0.1 % off. It rings at 10 Hz, damped
    # by a third of the critical: after a second it rests. A hinge at each vertex is right to 1 / 16^2, measured 0.4 to 1.0 percent
    end = engine(by).simulate(body, script, ALOFT).vertices[-1]
    sag = LINE * GRAVITY * FREE**4 / (8 * RIGIDITY)
    assert body.radius - end[-1, 2] == pytest.approx(sag, rel=0.015)


def test_a_rope_is_drawn_over_the_table_alike_in_mujoco_and_finite():
    # Coulomb friction on vertices, in two engines that share no line of it: by 2 cm, apart by 0.3 mm in frame 3 and 0.8 in frame 6. With
    # rolling friction, which resists every turn of a segment, it was 3.0 and 4.2 mm
    pytest.importorskip("mujoco")
    body = drawn("rope", [1, 0])
    script = replace(motions.draw("drag", body, np.random.default_rng([1, 1])), frames=7)
    one, other = (engine(by).simulate(body, script).vertices for by in ("mujoco", "finite"))
    assert np.linalg.norm(other[-1, 0] - other[0, 0]) > 0.02
    assert np.sqrt(np.mean(np.sum((one - other) ** 2, -1), 1)).max() < 1.0e-3


def test_without_the_clamp_the_sag_would_depend_on_the_mesh():
    sags = []
    for count in (20, 40):
        body, script = cantilever(count, 0, resolved=False)
        sags.append(body.radius - engine("finite").simulate(body, script, ALOFT).vertices[-1][-1, 2])
    # held half a segment farther in: 4 x half of 7.5 mm / 120 mm longer
    assert sags[0] / sags[1] > 1.04


# --- cloths ---------------------------------------------------------------------------------------------------------------------------

SIZE = (0.16, 0.2)


def sheet(times, *, size=SIZE, pitch=0.0135, rigidity=2e-4, tension=100.0, areal=0.25, **more):
    vertices, faces, blocks = triangulated(np.array(size), pitch, times)
    thickness, poisson = 1e-3, more.get("poisson", 0.0)
    size, bending = np.ptp(vertices, axis=0)[:2], rigidity * 12 * (1 - poisson**2) / (tension * thickness**2)
    about = {"poisson": poisson, "drag": 0.3, "damping": 0.0, "bending": bending, "blocks": blocks, "resolved": True} | more
    body = Body("cloth", vertices, faces, faces, np.ones(len(vertices)), 1e-3, tension / thickness, **about)
    return replace(body, mass=lumped(faces, body.measure, areal * np.prod(size), len(vertices)))


def rolled(body, degrees, radius=0.2):
    along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0])
    across = np.cross([0, 0, 1.0], along)
    p, q = body.vertices @ along / radius, body.vertices @ across
    return radius * np.sin(p)[:, None] * along + q[:, None] * across + radius * (1 - np.cos(p))[:, None] * [0, 0, 1.0]


@pytest.mark.parametrize("degrees", [0, 20, 45, 90])
@pytest.mark.parametrize("times", [1, 2])
def test_a_rolled_cloth_stores_the_energy_of_a_plate_in_every_direction(times, degrees):
    body, radius = sheet(times), 0.2
    # D / 2 k^2 for every square metre; the last row at a straight rim tells no curvature of its own, and borrows what chords of an arc have
    plate = 2e-4 / 2 / radius**2 * body.measure.sum()
    assert Plates(body).energy(rolled(body, degrees, radius)) == pytest.approx(plate, rel=0.03 / times)


@pytest.mark.parametrize("other, share", [(1, 1 + 0.3), (-1, 1 - 0.3), (0, 0.5)])
def test_a_cloth_that_curves_two_ways_stores_the_energy_of_a_plate(other, share):
    body, curvature = sheet(1, poisson=0.3), 0.05
    x = body.vertices.copy()
    x[:, 2] = curvature * (x[:, 0] ** 2 + other * x[:, 1] ** 2) / 2
    # Kirchhoff: D / 2 (k1^2 + k2^2 + 2 nu k1 k2), so D k^2 (1 + nu) of a cap, (1 - nu) of a saddle; slopes are below 0.005, so that their
    # squares do not count; exact but for triangles of the rim that know two angles and take the least energy that these allow
    assert Plates(body).energy(x) == pytest.approx(2e-4 * curvature**2 * share * body.measure.sum(), rel=0.05)


def test_forces_of_a_bent_cloth_are_minus_the_slope_of_its_energy():
    body, rng = sheet(1, size=(0.08, 0.07)), np.random.default_rng(0)
    plates, x = Plates(body), rolled(body, 30, 0.05)
    held = body.vertices[:, 0] < -0.025
    plates.clamp(held)
    x = x + rng.normal(0, 5e-4, x.shape)
    force, blocks = np.zeros_like(x), plates.evaluate(x, 1e9)[1]
    np.add.at(force, plates.nodes, plates.pull(x, 1e9))
    assert np.allclose(plates.evaluate(x, 1e9)[0], plates.pull(x, 1e9), atol=1e-15)
    way = rng.normal(0, 1, x.shape)
    slope = (plates.energy(x + 1e-7 * way) - plates.energy(x - 1e-7 * way)) / 2e-7  # rounding 1e-16 x 1e-5 J / 1e-7, truncation below
    assert -(force * way).sum() == pytest.approx(slope, rel=1e-6)
    assert np.linalg.eigvalsh(blocks).min() > -1e-12 * np.abs(blocks).max()
    assert not force[held & ~np.isin(np.arange(len(held)), plates.nodes[plates.weights > 0])].any()


@pytest.mark.parametrize("degrees", [0, 20, 45, 90])
def test_a_rolled_cloth_bends_on_as_if_it_could_not_stretch(degrees):
    # a bending moment M all over a rolled sheet rolls it up by M / D and stretches nothing, however its triangles lie: the work of M is
    # M^2 area / D. A membrane that locks would hold it back; quadratic triangles let 0.6 through on this mesh
    body = sheet(1)
    x, plates, membrane = rolled(body, degrees, 0.1), Plates(body), Continuum(body)
    way = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    across = plates.weights[:, None] * np.einsum("c,fci->fi", [way[0] ** 2, way[1] ** 2, 2 * way[0] * way[1]], plates.curving)
    load = np.zeros_like(x)
    np.add.at(load, plates.nodes, np.einsum("fi,fina->fna", across, plates._spread(plates.angle(x)[1])))
    dofs = [(3 * part.nodes[..., None] + np.arange(3)).reshape(len(part.nodes), -1) for part in (membrane, plates)]
    blocks = [part.evaluate(x, 1e9, firm=True)[1] for part in (membrane, plates)]
    moved = Banded(dofs, np.ones(x.size, bool)).solve(blocks, np.full(x.size, 1e-6), load.ravel())
    assert moved @ load.ravel() * 2e-4 / body.measure.sum() == pytest.approx(1, rel=0.04)


def test_mujocos_cloth_bends_as_stiffly():
    mujoco = pytest.importorskip("mujoco")
    assert mujoco
    from twinbench.datasets.concealed import engine as theirs

    body = sheet(1)
    model = theirs.World(body, Script("free", (), 2), Physics(), 32).model
    ends = np.concatenate([model.flex_edge, model.flex_edgeflap], axis=1)
    inner = (ends >= 0).all(axis=1)
    matrix = model.flex_bending.reshape(-1, theirs.BEND)[inner, :16].reshape(-1, 4, 4)
    creases = Creases(body)
    for degrees in (0, 45, 90):
        x = rolled(body, degrees)
        energy = np.einsum("kid,kij,kjd->", x[ends[inner]], matrix, x[ends[inner]]) / 2
        # quadratic in places where ours is in angles: those of an edge are below 0.07 rad, and differ by its square over 12
        assert energy == pytest.approx((creases.stiffness * creases.angle(x)[0] ** 2).sum() / 2, rel=2e-3)


def hung(times, turned):
    """Sag of a strip that is held by the same coarse triangles on every mesh, by the linear stiffness at rest, over that of a beam."""
    size, axis = ((0.08, 0.2), 1) if turned else ((0.2, 0.08), 0)
    whole, body = sheet(1, size=size), sheet(times, size=size)
    begin = np.unique(np.round(whole.vertices[:, axis], 9))[5 if turned else 4]
    within = (whole.vertices[whole.faces][:, :, axis] < begin + 1e-9).all(axis=1)
    held = np.unique(body.faces.reshape(len(within), -1)[within])
    return sag(body, held, axis)


def sag(body, held, axis):
    """Of a sheet whose vertices ``held`` are clamped, by the linear stiffness at rest, over q L^4 / (8 D)."""
    body = replace(body, blocks=held[None])
    still = Interaction("hand", grip=tuple(body.vertices[held[0]]), grip_radius=0.01, times=(0.0, 1.0), moves=((0.0,) * 3,) * 2)
    world = World(body, Script("still", (still,), 2), ALOFT, 8)
    weight = np.zeros((len(body.vertices), 3))
    weight[:, 2] = -GRAVITY * body.mass
    blocks = world._forces(world.x, world.frames, world.x)[2]
    moved = world.system.solve(blocks, np.zeros(weight.size), weight.ravel()).reshape(-1, 3)
    along = body.vertices[:, axis]
    tip = along > along.max() - 1e-9
    return -moved[tip, 2].mean() / (0.25 * GRAVITY * (along.max() - along[held].max()) ** 4 / (8 * 2e-4))


def test_a_clamped_strip_sags_as_a_plate_on_every_mesh():
    # q L^4 / (8 D), with Poisson's ratio 0 also of a strip whose sides are free; seven triangles across, of which those outside borrow
    coarse, fine = hung(1, False), hung(2, False)
    assert fine == pytest.approx(1, rel=0.025) and coarse == pytest.approx(fine, rel=0.03)
    # across the rows what is held ends in a zigzag, so that a beam's length is known to half a triangle only: the mesh must not matter
    assert hung(1, True) == pytest.approx(hung(2, True), rel=0.03)


def test_a_cloth_on_its_bar_sags_as_a_plate_on_every_mesh():
    # q L^4 / (8 D) from the bar's edge on, with Poisson's ratio 0: the whole width is clamped, so that nothing bends in a neck
    one, fine = (sag(body, body.blocks[1], 0) for body in (sheet(1), sheet(2)))
    assert one == pytest.approx(1, rel=0.01) and fine == pytest.approx(1, rel=0.005)


def test_points_are_tracked_along_the_bar_that_holds_a_cloth():
    body, frames = drawn("cloth", 0), 20
    script = motions.draw("two_hands", body, np.random.default_rng(0))
    held = tuple(body.held(hand.grip, hand.grip_radius) for hand in script.hands)
    grips = np.array([hand.grip for hand in script.hands]) + [0, 0, body.radius]
    vertices = np.repeat(body.vertices[None] + [0, 0, body.radius], frames, axis=0)
    motion = Motion(vertices, np.repeat(grips[:, None], frames, axis=1), np.tile(np.eye(3), (2, frames, 1, 1)), held)
    quiet = Tracker(noise=0, drift=0, lost=0, hidden=0, tracks=80, hand=10)
    found = observe(body, script, motion, quiet, Faults(), np.random.default_rng(0), name="bars")
    label = labels_of(found.controllers)
    assert len(set(label)) == 2  # one hand each, though its points are up to 3 cm apart
    for k in set(label):
        at = found.controllers[0, label == k]
        strip = to_world(vertices[0, min(held, key=lambda h: np.linalg.norm(to_world(vertices[0, h]).mean(0) - at.mean(0)))])
        # the width of what is clamped, and in its middle, to the spacing of its points
        assert np.ptp(at, axis=0) == pytest.approx([np.ptp(strip[:, 0]), np.ptp(strip[:, 1]), 0.012], abs=0.02)
        assert (at.min(0) + at.max(0)) / 2 == pytest.approx(strip.mean(0), abs=0.006)
        assert bar_of(at) is not None


def test_without_the_clamp_the_sag_of_a_strip_would_depend_on_the_mesh(monkeypatch):
    monkeypatch.setattr(Plates, "clamp", lambda plates, held: None)
    assert hung(1, False) > 1.05 * hung(2, False)
