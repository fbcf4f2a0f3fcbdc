"""Layers of sheets and strands of ropes that meet: nearest places, candidates, forces, rest, topology, gradients, batches."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from twinbench.benchmark.conformance.gradients import check, leaves, loss, some, stacked
from twinbench.physics.batch import Batch
from twinbench.physics.kernels import build
from twinbench.physics.layer_items import edges_and_faces
from twinbench.physics.layer_search import seek_layers
from twinbench.physics.layers import CARRIED
from twinbench.physics.penetrations import nearest_edges, nearest_face, penetrations
from twinbench.physics.sheets import Sheet
from twinbench.physics.stability import stable_step
from twinbench.physics.system import System
from twinbench.physics.terms import (
    Bending,
    BendingDamping,
    Dashpot,
    Gravity,
    Ground,
    LayerContact,
    LinearDrag,
    Membrane,
    MembraneDamping,
    PlateBending,
    PlateDamping,
    Springs,
)
from twinbench.physics.topology import rope_hinges

G, AREAL = 9.81, 0.2  # m/s^2, kg/m^2
CLOTH = (
    Membrane({"membrane_stiffness": 40.0}),
    MembraneDamping({"membrane_viscosity": 4e-3}),
    PlateBending({"plate_rigidity": 2e-5}),
    PlateDamping({"plate_viscosity": 2e-7}),
    Gravity({"gravity_z": -G}),
    LinearDrag({"drag_damping": 0.5}),
)
TABLE = Ground({"ground_normal_z": 1.0, "ground_offset": 0.0, "collide_elas": 0.0, "collide_fric": 0.5})


def mesh(long, wide):
    """Triangles of a lattice of long x wide points."""
    corner = (wide * np.arange(long - 1)[:, None] + np.arange(wide - 1)).ravel()
    return np.concatenate([corner[:, None] + [0, wide, wide + 1], corner[:, None] + [0, wide + 1, 1]])


def cloth(points, triangles, *terms, flat=None, held=(), **given):
    held = np.asarray(held, int)
    sheet = Sheet.of(points if flat is None else flat, triangles)
    return System(
        positions=points,
        masses=sheet.masses(AREAL, len(points)),
        springs=np.zeros((0, 2), int),
        stiffness=[],
        controllers=points[None, held],
        grips=held,
        sheet=sheet,
        terms=terms,
        **given,
    )


def rate_for(system):
    """Half of the highest frequency of the mesh, 2 / its stable step."""
    return 1 / stable_step(replace(system, terms=[t for t in system.terms if t.stage != "layer"]))


def touching(system, thickness, **values):
    contact = LayerContact({"layer_thickness": thickness, "layer_rate": rate_for(system), **values})
    return replace(system, terms=[*system.terms, contact])


def frames_of(system, seconds, fps):
    batch = Batch([system], fps=fps, workers=1)
    return batch.rollout(round(seconds * fps) + 1).positions[0].double().numpy()


# ---------------------------------------------------------------- geometry


@pytest.mark.parametrize(("measure", "counts"), [(nearest_face, (1, 3)), (nearest_edges, (2, 2))])
def test_nearest_places_are_the_nearest(measure, counts):
    # of 2,000 random places on either side none is nearer, and the best of them is not much farther
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(200, counts[0], 3)), rng.normal(size=(200, counts[1], 3))
    both = np.concatenate([first, second], 1)
    weights = measure(first, second)
    assert (weights[:, : counts[0]].sum(1) == pytest.approx(1)) and (weights[:, counts[0] :].sum(1) == pytest.approx(-1))
    found = np.linalg.norm(np.einsum("ck,cki->ci", weights, both), axis=1)
    tried = [rng.dirichlet(np.full(n, 0.7), 2000) for n in counts]
    away = [np.einsum("sk,cki->csi", w, x) for w, x in zip(tried, (first, second), strict=True)]
    least = np.linalg.norm(away[0] - away[1], axis=2).min(1)
    assert (found <= least + 1e-12).all() and np.median(least - found) < 0.1


def crumpled(seed, count=9):
    """A sheet in three layers, and two ropes in it, in one system: what meets is both bodies and each with itself."""
    rng = np.random.default_rng(seed)
    flat = 0.02 * np.stack(np.meshgrid(np.arange(count * 3.0), np.arange(4.0), indexing="ij"), -1).reshape(-1, 2)
    layer = np.floor(flat[:, 0] / (0.02 * count))
    along = np.abs((flat[:, 0] / (0.02 * count) - layer) - (layer % 2)) * 0.02 * count
    points = np.column_stack([along, flat[:, 1], 0.004 * layer]) + rng.normal(size=(len(flat), 3)) * 1e-3
    rope = np.cumsum(rng.normal(size=(12, 3)) * 0.02, 0) + points.mean(0)
    sheet = Sheet.of(np.column_stack([flat, 0 * flat[:, 0]]), mesh(count * 3, 4))
    x, chain = np.concatenate([points, rope]), np.arange(len(points), len(points) + 12)
    masses = sheet.masses(AREAL, len(x))
    masses[chain] = 0.002
    return System(
        positions=x,
        velocities=rng.normal(size=x.shape) * 0.3,
        masses=masses,
        springs=np.zeros((0, 2), int),
        stiffness=[],
        controllers=np.zeros((1, 0, 3)),
        sheet=sheet,
        chains=[chain[:5], chain[5:]],
        terms=[LayerContact({"layer_thickness": 0.006, "layer_rate": 300.0})],
    )


def every_pair(system):
    """All (pair (C, 4), of edges (C,)) of a system whose sides share no node."""
    vertices, edges, faces = edges_and_faces(system)
    found = [(np.concatenate([[v], f]), False) for v in vertices for f in faces if v not in f]
    for k, one in enumerate(edges):
        found += [(np.concatenate([one, two]), True) for two in edges[k + 1 :] if not set(one) & set(two)]
    return np.array([p for p, _ in found]), np.array([e for _, e in found])


def named(pair, edges):
    """The same for a pair of edges whichever comes first."""
    return (*sorted((tuple(pair[:2]), tuple(pair[2:]))), True) if edges else (*pair, False)


def test_candidates_are_all_that_are_near():
    # d - u T < 2 h by numpy (a T^2 / 2 is less than h), over all pairs; in a batch of three, each has its own
    systems = [crumpled(seed) for seed in range(3)]
    batch = Batch(systems, fps=60, substeps=10, double=True, workers=1)
    horizon = torch.full((3,), 0.004, dtype=torch.float64)
    found = seek_layers(batch, batch.inputs.x, batch.inputs.v, batch.inputs.table, horizon)
    for b, system in enumerate(systems):
        own = slice(int(found.pair_start[b]), int(found.pair_start[b + 1]))
        mine = {named(p, e) for p, e in zip((found.pair[own] - batch.starts[b]).tolist(), found.pair_edges[own].tolist(), strict=True)}
        pairs, edges = every_pair(system)
        x, v = system.positions[pairs], system.velocities[pairs]
        weights = np.where(edges[:, None], nearest_edges(x[:, :2], x[:, 2:]), nearest_face(x[:, :1], x[:, 1:]))
        far = np.linalg.norm(np.einsum("ck,cki->ci", weights, x), axis=1)
        apart = np.linalg.norm(v[:, :, None] - v[:, None], axis=3)
        fastest = np.where(edges, apart[:, :2, 2:].max((1, 2)), apart[:, 0, 1:].max(1))
        near = far - 0.004 * fastest < 0.012
        wanted = {named(p, e) for p, e in zip(pairs[near].tolist(), edges[near].tolist(), strict=True)}
        assert mine == wanted and len(wanted) > 200


def numpy_forces(system, x, v):
    """Of all pairs, by the term's numpy twin."""
    term = next(t for t in system.terms if t.stage == "layer")
    pairs, edges = every_pair(system)
    at = x[pairs]
    weights = np.where(edges[:, None], nearest_edges(at[:, :2], at[:, 2:]), nearest_face(at[:, :1], at[:, 1:]))
    force = np.zeros_like(x)
    for pair, weight in zip(pairs, weights, strict=True):
        one = term.twin(weight @ x[pair], weight @ v[pair], CARRIED * system.masses[pair].min(), **term.values)
        np.add.at(force, pair, weight[:, None] * one)
    return force


@pytest.mark.long
def test_a_step_is_that_of_numpy_and_keeps_momentum():
    # v' = v + dt F / m; forces on the four nodes sum to none and turn nothing, weights being those of places on one line of action
    system = crumpled(4)
    batch = Batch([system], fps=1e4, substeps=1, double=True)
    _, _, v = batch.march(0, 1)
    force = numpy_forces(system, system.positions, system.velocities)
    assert (np.abs(force).max(1) > 0).sum() > 50
    # 1e-9 of the largest change: rounding in nearest places of edges that are nearly parallel
    change = 1e-4 * force / system.masses[:, None]
    np.testing.assert_allclose(v.numpy(), system.velocities + change, rtol=0, atol=1e-9 * np.abs(change).max())
    gained = (v.numpy() - system.velocities) * system.masses[:, None]
    scale = np.abs(gained).sum()
    assert np.abs(gained.sum(0)).max() < 1e-12 * scale
    frictionless = system.with_values(layer_friction=0.0)
    push = numpy_forces(frictionless, system.positions, system.velocities)
    assert np.abs(np.cross(system.positions, push).sum(0)).max() < 1e-12 * np.abs(push).sum()


def test_what_lies_side_by_side_never_meets():
    # a straight rope whose segments are shorter than it is thick, and a flat sheet, feel nothing
    rope = np.column_stack([0.004 * np.arange(20.0), np.zeros((20, 2))])
    flat = np.column_stack([0.02 * np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), -1).reshape(-1, 2), np.ones(25)])
    sheet = Sheet.of(np.concatenate([rope, flat]), mesh(5, 5) + 20)
    system = System(
        positions=np.concatenate([rope, flat]),
        springs=np.zeros((0, 2), int),
        stiffness=[],
        controllers=np.zeros((1, 0, 3)),
        sheet=sheet,
        chains=[np.arange(20)],
        terms=[LayerContact({"layer_thickness": 0.01})],
    )
    out = Batch([system], fps=60, substeps=10).rollout(10).positions[0]
    assert torch.equal(out[-1], out[0])
    assert penetrations(system, out.numpy(), 0.01).nearest > 0.01


# ---------------------------------------------------------------- rest and topology


def folded(fold, size=13, pitch=0.015, gap=0.004):
    """(points, their flat places, triangles): a square sheet folded over at its middle, the upper half ``gap`` above the lower.

    ``fold`` degrees by which the upper half is turned in its plane: meshes that lie on each other do not match."""
    flat = pitch * np.stack(np.meshgrid(np.arange(2.0 * size), np.arange(1.0 * size), indexing="ij"), -1).reshape(-1, 2)
    middle, radius = pitch * (size - 0.5), gap / 2
    arc = np.pi * radius
    beyond = flat[:, 0] - (middle - arc / 2)
    turned = np.clip(beyond / radius, 0, np.pi)
    x = np.where(beyond <= 0, flat[:, 0], middle - arc / 2 + radius * np.sin(turned) - np.maximum(beyond - arc, 0))
    z = radius * (1 - np.cos(turned))
    shift = 0.37 * pitch * (z / gap) + np.tan(np.radians(fold)) * np.maximum(beyond - arc, 0)
    return np.column_stack([x, flat[:, 1] + shift, z + 0.002]), np.column_stack([flat, 0 * flat[:, 0]]), mesh(2 * size, size)


@pytest.mark.slow
def test_a_folded_cloth_rests_on_itself():
    # one and a quarter seconds, looked at 240 times a second: layers are never half a thickness apart, and stay where they lie; without
    # contact the same cloth falls into itself
    points, flat, triangles = folded(4.0)
    bare = cloth(points, triangles, *CLOTH, TABLE, flat=flat)
    thick = 0.004
    path = frames_of(touching(bare, thick), 1.25, 240)
    found = penetrations(bare, path, thick)
    assert found.nearest > thick / 2 and found.count == found.pierced == 0, found
    assert np.linalg.norm(path[-1] - path[-24], axis=1).max() < 2e-3  # in the last tenth of a second: friction is regularised, and creeps
    lost = penetrations(bare, frames_of(bare, 1.25, 240), thick)
    assert lost.count > 50 and lost.pierced > 10, lost


def rope(points, *terms, rings=1, masses=0.002, path=None, grips=()):
    """``rings`` > 1: points (K, N, 3) are closed ropes; else one open rope (N, 3)."""
    parts = np.reshape(points, (rings, -1, 3))
    count = parts.shape[1]
    walks = [np.arange(count) + k * count for k in range(rings)]
    chains = [np.append(w, w[0]) if rings > 1 else w for w in walks]
    x = parts.reshape(-1, 3)
    springs = np.concatenate([np.stack([c[:-1], c[1:]], 1) for c in chains])
    return System(
        positions=x,
        masses=np.full(len(x), masses),
        springs=springs,
        stiffness=np.full(len(springs), 60.0),
        hinges=np.concatenate([rope_hinges(c) for c in chains]),
        chains=chains,
        controllers=x[None, list(grips)] if path is None else path,
        grips=list(grips),
        terms=[
            *(
                Springs(),
                Dashpot({"dashpot_damping": 0.3}),
                Bending({"bending_stiffness": 1e-4}),
                BendingDamping({"bending_damping": 1e-6}),
            ),
            *(LinearDrag({"drag_damping": 1.0}), *terms),
        ],
    )


def linking(one, other):
    """Gauss' linking number of closed polygons (N, 3): exact, by solid angles of pairs of edges (Klenin and Langowski 2000)."""
    a, b = one[:, None], np.roll(one, -1, 0)[:, None]
    c, d = other[None], np.roll(other, -1, 0)[None]
    r = [c - a, d - a, d - b, c - b]
    n = [np.cross(r[k], r[(k + 1) % 4]) for k in range(4)]
    n = [v / np.maximum(np.linalg.norm(v, axis=2, keepdims=True), 1e-15) for v in n]
    angle = sum(np.arcsin(np.clip((n[k] * n[(k + 1) % 4]).sum(2), -1, 1)) for k in range(4))
    sign = np.sign((np.cross(d - c, b - a) * (a - c)).sum(2))
    return float((angle * sign).sum() / (4 * np.pi))


def test_linked_rings_stay_linked():
    # two rings of rope through each other, one held at a node, the other pulled off by a node at 0.5 m/s: the linking number is kept, and
    # is lost without contact
    angle = 2 * np.pi * np.arange(30) / 30
    one = 0.06 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    other = 0.06 * np.column_stack([np.cos(angle) + 1.0, 0 * angle, np.sin(angle)])
    x = np.concatenate([one, other])
    path = np.repeat(x[None, [15, 30]], 241, 0)
    path[:, 1, 0] += 0.5 * np.minimum(np.arange(241) / 480, 0.3)
    bare = rope(np.stack([one, other]), rings=2, path=path, grips=[15, 30])
    kept = frames_of(touching(bare, 0.01), 0.5, 480)
    start = round(linking(one, other))
    assert abs(start) == 1
    assert [round(linking(*np.split(frame, 2))) for frame in kept[::24]] == [start] * 11
    assert penetrations(bare, kept, 0.01).count == 0
    assert round(linking(*np.split(frames_of(bare, 0.5, 480)[-1], 2))) == 0


@pytest.mark.slow
def test_a_coil_is_pulled_open():
    # three turns of 6 cm lying on each other on a table, drawn up by an end at 0.6 m/s until they hang: between two looks nothing moves
    # as far as what is near is away, so that nothing has passed through anything
    turns = np.linspace(0, 6 * np.pi, 90)
    radius = 0.03 + 0.002 * turns / (2 * np.pi)
    coil = np.column_stack([radius * np.cos(turns), radius * np.sin(turns), 0.009 * turns / (2 * np.pi) + 0.001])[::-1]
    path = np.repeat(coil[None, [0]], 721, 0)
    path[:, 0, 2] += 0.6 * np.arange(721) / 480
    bare = rope(coil, Gravity({"gravity_z": -G}), TABLE, path=path, grips=[0])
    thick = 0.008
    system = touching(bare, thick)
    kept = frames_of(system, 1.5, 480)
    found = penetrations(bare, kept, thick)
    assert found.nearest > 0.3 * thick, found
    moved = np.linalg.norm(np.diff(kept, axis=0), axis=2).max()
    assert 2 * moved < 2 * found.nearest  # both sides of a pair, and the distance before and after
    length = np.linalg.norm(np.diff(coil, axis=0), axis=1).sum()
    assert np.ptp(kept[-1][:, 2]) == pytest.approx(length, rel=0.05)  # it hangs straight, longer by 1.5 % (1.8 N / 60 N / 2)


@pytest.mark.long
def test_the_step_does_not_shrink():
    # with contact at half of the mesh's highest frequency, a cloth on itself takes the substeps that it takes alone: half of the stable
    points, flat, triangles = folded(4.0)
    bare = cloth(points, triangles, *CLOTH[:5], TABLE, flat=flat)
    alone = Batch([bare], fps=30)
    both = Batch([touching(bare, 0.004)], fps=30, substeps=int(alone.substeps[0]))
    path = both.rollout(16).positions[0].numpy()
    assert np.isfinite(path).all() and penetrations(bare, path, 0.004).count == 0


# ---------------------------------------------------------------- in the engine


@pytest.mark.long
def test_gradients():
    # in float64 against central differences, below 1e-4 of the largest (``check``), layers and strands touching
    batch = Batch([stacked(LayerContact, seed=seed) for seed in (0, 1)], fps=30, substeps=50, double=True, workers=1)
    out = batch.march(0, 4)[0]
    for system, path in zip(batch.systems, batch.split(out), strict=True):
        assert penetrations(system, path.numpy(), 0.008).depth > 2e-4  # they do touch
    inputs = leaves(batch)
    loss(batch, inputs).backward()
    for name in ("x", "path", "table"):
        check(batch, inputs, name, some(getattr(inputs, name).grad))
    check(batch, inputs, "v", some(inputs.v.grad)[:6])


def test_a_batch_is_its_systems():
    systems = [crumpled(0), crumpled(1), replace(crumpled(2), sheet=None), crumpled(3, count=5)]
    substeps = [20, 30, 20, 41]
    together = Batch(systems, fps=30, substeps=substeps).rollout(10).positions
    for one, steps, both in zip(systems, substeps, together, strict=True):
        assert torch.equal(Batch([one], fps=30, substeps=steps).rollout(10).positions[0], both)


def test_going_on_is_as_without_a_break():
    # candidates are looked up at the same substeps, with or without a history
    batch = Batch([crumpled(0)], fps=30, substeps=20)
    whole, x, v = batch.march(0, 4)
    _, x1, v1 = batch.march(0, 2)
    part, x2, v2 = batch.march(2, 2, replace(batch.inputs, x=x1, v=v1))
    assert torch.equal(x, x2) and torch.equal(v, v2) and torch.equal(whole[2:], part)
    again = batch.march(0, 4, replace(batch.inputs, x=batch.inputs.x.clone().requires_grad_()))[0]
    assert torch.equal(whole, again.detach())


def test_a_rotated_scene_is_the_same():
    # frames do not matter: float64, a hundred substeps of smooth forces, 1e-9 m for what rounding grows to in contact
    system, turn = crumpled(5), Rotation.random(random_state=1).as_matrix()
    other = replace(system, positions=system.positions @ turn.T, velocities=system.velocities @ turn.T)
    one, two = (Batch([s], fps=60, substeps=20, double=True).rollout(6).positions[0].numpy() for s in (system, other))
    np.testing.assert_allclose(one @ turn.T, two, rtol=0, atol=1e-9)


def test_two_terms_of_layers_are_refused():
    class Other(LayerContact):
        name, parameters, hardness = "other", (), staticmethod(lambda: (0.0, 0.0))

    with pytest.raises(ValueError, match="a system can have one term of layers that meet, got layer_contact, other"):
        Batch([replace(crumpled(0), terms=[LayerContact(), Other()])], fps=30)


def test_gathered_forces_are_those_that_are_handed_out():
    # the way of a GPU's threads, nodes gathering, taken by a lone thread: the same sums in another order, 20 substeps of float64
    one, two = (Batch([crumpled(0), crumpled(1)], fps=60, substeps=10, double=True, workers=1) for _ in range(2))
    two.alone, two.kernels = False, build(two.laws, True, False, 1, 1, False)
    x = [b.rollout(3).positions for b in (one, two)]
    for here, there in zip(*x, strict=True):
        assert (here - here[0]).abs().max() > 0 and (here - there).abs().max() < 1e-12


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_is_the_cpu():
    # float64: the same candidates, the same sums in another order; gradients too
    found = []
    for device in ("cpu", "cuda"):
        batch = Batch([stacked(LayerContact, seed=s) for s in (0, 1)], fps=30, substeps=100, double=True, device=device)
        inputs = leaves(batch)
        out = batch.march(0, 4, inputs)[0]
        out.pow(2).sum().backward()
        found.append((out.detach().cpu(), inputs.x.grad.cpu(), inputs.table.grad.cpu()))
    for here, there, size in zip(*found, (1e-9, 1e-6, 1e-6), strict=True):
        assert (here - there).abs().max() <= size * here.abs().max()


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_repeats_to_the_last_bit():
    systems = [crumpled(0), crumpled(1)]
    one, two = (Batch(systems, fps=30, substeps=20, device="cuda").rollout(10).positions for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
