"""The engine on CUDA against the same engine on the CPU. Run on a machine with a GPU: python -m pytest tests/physics/test_gpu.py"""

from dataclasses import fields, replace

import numpy as np
import pytest

pytestmark = pytest.mark.gpu


@pytest.fixture(scope="module")
def cuda():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    return torch


def systems(count, collide, remember=False):
    from twinbench.benchmark.performance import block
    from twinbench.physics.terms import SelfCollision
    from twinbench.physics.terms.grip_slip import GripSlip
    from twinbench.physics.terms.plasticity import Plasticity
    from twinbench.physics.terms.viscoelastic import Viscoelastic

    made = [skinned(hinged(block(150 + 40 * k, 10, frames=4, seed=k))) for k in range(count)]
    if collide:
        made = [replace(s, terms=(*s.terms, SelfCollision({"collision_dist": 0.006}))) for s in made]
    if remember:
        flow = Plasticity({"plastic_rate": 100.0, "yield_strain": 0.001})
        memories = (flow, Viscoelastic({"branch_stiffness": 2.0}), GripSlip({"slip_rate": 100.0, "slip_force": 1.0}))
        made = [replace(s, terms=(*s.terms, *memories)) for s in made]
    return made


def hinged(body):
    """``body`` with a rope through it, and hinges that follow no rope."""
    from twinbench.physics.terms import Bending, BendingDamping, Torsion
    from twinbench.physics.topology import rope_hinges, sheet_hinges

    chain = np.lexsort(np.round(body.positions, 3).T)[:6]
    hinges = np.concatenate([rope_hinges(chain), sheet_hinges(body.positions, body.springs)])
    hinges = hinges[np.sort(np.unique(np.sort(hinges, axis=1), axis=0, return_index=True)[1])]
    laws = (Bending({"bending_stiffness": 1e-4}), BendingDamping({"bending_damping": 1e-7}), Torsion({"torsion_stiffness": 1e-4}))
    # bent by nature, so that there is one way in which the rope rests: a straight one rolls about itself by what rounding says
    natural = np.random.default_rng(0).uniform(-0.3, 0.3, (len(hinges), 2))
    own: dict = dict(natural=natural, span=None, flexure=None)  # of these hinges, not of the body's none
    return replace(body, hinges=hinges, chains=[chain], terms=(*body.terms, *laws), **own)


def skinned(body):
    """``body`` with a closed skin, which air resists, and what is inside as well."""
    from twinbench.physics.facets import solid_facets
    from twinbench.physics.terms import PlateDrag, Pressure

    facets = solid_facets(body.positions, radius=2 * np.linalg.norm(np.ptp(body.positions, axis=0)) / len(body.positions) ** (1 / 3))
    return replace(
        body, facets=facets, terms=(*body.terms, PlateDrag({"plate_drag": 1e6}), Pressure({"pressure": 1e7, "pressure_fill": 1.2}))
    )


def march(made, device, *, double, team=None):
    from twinbench.physics.batch import Batch, Inputs

    batch = Batch(made, fps=100, substeps=40, dt=5e-5, device=device, double=double, team=team)
    inputs = Inputs(**{f.name: getattr(batch.inputs, f.name).clone().requires_grad_() for f in fields(Inputs)})
    out, x, v, carried = batch.march(0, 3, inputs, whole=True)
    memory = carried.memory
    weight = np.random.default_rng(0).normal(size=tuple(out.shape))
    loss = (out * out.new_tensor(weight)).sum() + (x**2).sum() + (v**2).sum() + memory.sum()
    loss.backward()
    grads = {f.name: getattr(inputs, f.name).grad for f in fields(Inputs)}
    return out.detach().cpu(), {name: grad.cpu() for name, grad in grads.items() if grad.numel()}  # what bodies have none of is empty


def loss_of(made, team):
    """The scalar that ``march`` takes the gradient of."""
    from twinbench.physics.batch import Batch

    batch = Batch(made, fps=100, substeps=40, dt=5e-5, device="cuda", double=True, team=team)
    out, x, v = batch.march(0, 3)
    weight = np.random.default_rng(0).normal(size=tuple(out.shape))
    return float((out * out.new_tensor(weight)).sum() + (x**2).sum() + (v**2).sum())


def on_cpu(made):
    import warp

    if not warp.is_cpu_available():
        pytest.skip("this Warp comes without its compiler for the CPU")
    return march(made, "cpu", double=True)


@pytest.mark.parametrize("remember", [False, True])
@pytest.mark.parametrize("collide", [False, True])
@pytest.mark.parametrize("team", [(1, 256, 1), (1, 128, 4), (6, 64, 8)])
def test_cuda_agrees_with_cpu(cuda, collide, remember, team):
    # the same sums in another order: float64 rounding, grown over 120 substeps
    made = systems(3, collide, remember)
    there, grads_there = march(made, "cuda", double=True, team=team)
    here, grads_here = on_cpu(made)
    assert (here - there).abs().max() < 1e-11
    for name, grad in grads_here.items():
        assert (grad - grads_there[name]).abs().max() <= 1e-8 * grad.abs().max().clamp(min=1e-12), name


@pytest.mark.parametrize("team", [(1, 128, 4), (6, 64, 8), (1, 256, 32)])
def test_teams_agree_on_contacts(cuda, team):
    # lanes share a particle's contacts; the same sums in another order: float64 rounding, grown over 120 substeps
    alone, grads_alone = march(systems(3, True), "cuda", double=True, team=(1, 256, 1))
    shared, grads_shared = march(systems(3, True), "cuda", double=True, team=team)
    assert (alone - shared).abs().max() < 1e-11
    for name, grad in grads_alone.items():
        assert (grad - grads_shared[name]).abs().max() <= 1e-8 * grad.abs().max().clamp(min=1e-12), name


@pytest.mark.parametrize("remember", [False, True])
@pytest.mark.parametrize("collide", [False, True])
def test_cuda_repeats_to_the_last_bit(cuda, collide, remember):
    made = systems(3, collide, remember)
    first, grads_first = march(made, "cuda", double=False)
    again, grads_again = march(made, "cuda", double=False)
    assert (first == again).all()
    for name, grad in grads_first.items():
        assert (grad == grads_again[name]).all(), name


def test_batched_equals_single_on_cuda(cuda):
    made = systems(3, False)
    batched, _ = march(made, "cuda", double=False, team=(1, 128, 4))
    single, _ = march(made[:1], "cuda", double=False, team=(1, 128, 4))
    assert (batched[:, : single.shape[1]] == single).all()


@pytest.mark.parametrize("team", [(1, 128, 4), (6, 64, 8)])
def test_gradients_on_cuda_against_central_differences(cuda, team):
    # (L(u + h) - L(u - h)) / 2h in float64: truncation h^2 and rounding 1e-16 |L| / h are far below the tolerance
    made = systems(1, False)
    _, grads = march(made, "cuda", double=True, team=team)
    for name in ("stiffness", "rest"):
        index = int(grads[name].abs().argmax())
        value, h = getattr(made[0], name)[index], 1e-6 * getattr(made[0], name)[index]
        sides = []
        for changed in (value + h, value - h):
            array = getattr(made[0], name).copy()
            array[index] = changed
            sides.append(loss_of([replace(made[0], **{name: array})], team))
        expected = (sides[0] - sides[1]) / (2 * h)
        assert abs(float(grads[name][index]) - expected) < 1e-4 * abs(expected), name


@pytest.mark.parametrize("particles, systems_count", [(500, 1), (5000, 1), (300, 70), (300, 300)])
def test_teams_chosen_by_default_run(cuda, particles, systems_count):
    # every size of team that the chooser can name, against the free fall of a body without springs: z = z0 + g dt^2 n (n + 1) / 2
    from twinbench.benchmark.performance import block
    from twinbench.physics.batch import Batch
    from twinbench.physics.terms import Gravity

    one = block(particles, 8, frames=2)
    one = replace(one, terms=(Gravity(),), springs=np.zeros((0, 2), int), rest=np.zeros(0), stiffness=np.zeros(0))
    batch = Batch([one] * systems_count, fps=1000, substeps=20, device="cuda", double=True)
    n, dt = 20, batch.dt[0]
    for positions in batch.rollout(2).positions:
        fallen = positions[1].cpu().numpy() - one.positions
        assert np.abs(fallen - [0, 0, 9.8 * dt**2 * n * (n + 1) / 2]).max() < 1e-12


# ---------------------------------------------------------------- bodies that stay in shared memory


def plain(sizes, frames=4):
    """PhysTwin's terms alone: blocks that hit the ground, with hands that pull on springs and a marker that carries a particle."""
    from twinbench.benchmark.performance import block

    made = []
    for k, size in enumerate(sizes):
        one, rng = block(size, 10, frames=frames, seed=k), np.random.default_rng(k)
        marker = one.positions[[5]] + 0.001 * np.arange(frames)[:, None, None]
        controllers = np.concatenate([one.controllers, marker], 1)
        v = 0.3 * rng.normal(size=(size, 3)) + [0, 0, 4.0]
        made.append(replace(one, velocities=v, masses=rng.uniform(0.5, 2, size), controllers=controllers, grips=np.array([-1, -1, 5])))
    return made


def both_ways(batch, frames=3):
    """Positions at the frames and all gradients of a loss, by the engine that the batch has."""
    inputs = replace(batch.inputs, **{f: getattr(batch.inputs, f).clone().requires_grad_() for f in RESIDENT})
    out, x, v = batch.march(0, frames, inputs)
    weight = np.random.default_rng(0).normal(size=tuple(out.shape))
    ((out * out.new_tensor(weight)).sum() + (x**2).sum() + (v**2).sum()).backward()
    return [out.detach(), x.detach(), v.detach()], {f: getattr(inputs, f).grad for f in RESIDENT}


RESIDENT = ("x", "v", "mass", "rest", "stiffness", "path", "table")
SHAPES = [(1, 256, 1), (1, 256, 8), (2, 256, 2), (4, 512, 4), (8, 256, 32), (16, 512, 16)]


def shaped(sizes, shape, *, double, substeps=40):
    """A batch that an engine of ``shape`` steps."""
    from twinbench.physics.batch import Batch
    from twinbench.physics.packing import Shape
    from twinbench.physics.resident import Engine

    batch = Batch(plain(sizes), fps=100, substeps=substeps, dt=5e-5, device="cuda", double=double)
    batch.resident = Engine(batch, Shape(*shape)) if shape else None
    return batch


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("sizes", [(60, 133, 97), (701,), (8,)])
def test_resident_engine_agrees_with_the_general_one(cuda, shape, sizes):
    # the same sums in another order: float64 rounding, grown over 120 substeps and bounces
    found, grads = both_ways(shaped(sizes, shape, double=True))
    expected, grads_expected = both_ways(shaped(sizes, None, double=True))
    for one, other in zip(found, expected, strict=True):
        assert (one - other).abs().max() < 1e-11
    for name, grad in grads_expected.items():
        assert (grads[name] - grad).abs().max() <= 1e-8 * grad.abs().max().clamp(min=1e-12), name


@pytest.mark.parametrize("sizes", [(60, 133, 97), (2000,)])
def test_resident_engine_in_float32(cuda, sizes):
    # float32 rounding, 6e-8, over 120 substeps; gradients lose more where a bounce is a matter of one substep or another
    from twinbench.physics.batch import Batch

    batch = Batch(plain(sizes), fps=100, substeps=40, dt=5e-5, device="cuda")
    assert batch.resident is not None
    found, grads = both_ways(batch)
    expected, grads_expected = both_ways(shaped(sizes, None, double=True))
    assert (found[0] - expected[0]).abs().max() < 1e-5
    for name, grad in grads_expected.items():
        assert (grads[name] - grad).abs().max() <= 1e-3 * grad.abs().max().clamp(min=1e-12), name


def test_float32_gradients_of_a_published_frame(cuda):
    # over 667 substeps float32 itself is off by some 1e-4; this engine may be no farther from float64 than thrice the general one
    from twinbench.benchmark.performance import block
    from twinbench.physics.batch import Batch

    def gradients(double, resident):
        batch = Batch([block(500, 10)], fps=30, substeps=667, dt=5e-5, device="cuda", double=double)
        batch.resident = batch.resident if resident else None
        return both_ways(batch, frames=1)[1]

    exact, general, found = gradients(True, False), gradients(False, False), gradients(False, True)
    for name in ("x", "v", "mass", "rest", "stiffness", "path"):
        scale = exact[name].abs().max()
        allowed = 3 * (general[name] - exact[name]).abs().max() + 1e-5 * scale
        assert (found[name] - exact[name]).abs().max() <= allowed, (name, float(allowed / scale))


@pytest.mark.parametrize("shape", SHAPES)
def test_resident_engine_repeats_to_the_last_bit(cuda, shape):
    batch = shaped((60, 133, 97), shape, double=False)
    (found, grads), (again, grads_again) = both_ways(batch), both_ways(batch)
    assert all((one == other).all() for one, other in zip(found, again, strict=True))
    for name, grad in grads.items():
        assert (grad == grads_again[name]).all(), name
    with cuda.no_grad():  # nor does it matter whether the way is recorded
        assert (batch.march(0, 3)[0] == found[0]).all()


def test_resident_batch_is_its_systems(cuda):
    together = shaped((60, 133, 97), (2, 256, 4), double=False)
    alone = shaped((60,), (2, 256, 4), double=False)
    with cuda.no_grad():
        out, single = together.march(0, 3)[0], alone.march(0, 3)[0]
    assert (out[:, : single.shape[1]] == single).all()


def test_resident_gradients_through_several_stretches(cuda, monkeypatch):
    from twinbench.physics import batch as module

    whole = both_ways(shaped((133,), (4, 256, 2), double=True))[1]
    monkeypatch.setattr(module, "HISTORY_BYTES", 400_000)  # 25 substeps
    cut = shaped((133,), (4, 256, 2), double=True)
    assert len(cut.stretches(3, history=True)) > 3
    for name, grad in both_ways(cut)[1].items():
        assert (grad - whole[name]).abs().max() <= 1e-10 * whole[name].abs().max().clamp(min=1e-12), name


def test_resident_gradients_against_central_differences(cuda):
    # (L(u + h) - L(u - h)) / 2h in float64: truncation h^2 and rounding 1e-16 |L| / h are far below the tolerance
    batch = shaped((60,), (4, 256, 2), double=True)
    weight = np.random.default_rng(0).normal(size=(3, batch.node_count, 3))

    def loss(inputs):
        out, x, v = batch.march(0, 3, inputs)
        return (out * out.new_tensor(weight)).sum() + (x**2).sum() + (v**2).sum()

    _, grads = both_ways(batch)
    for name in RESIDENT:
        flat = getattr(batch.inputs, name)
        index = int(grads[name].flatten().abs().argmax())
        h, sides = 1e-6 * max(1.0, abs(float(flat.flatten()[index]))), []
        for step in (h, -h):
            changed = flat.clone()
            changed.view(-1)[index] += step
            with cuda.no_grad():
                sides.append(float(loss(replace(batch.inputs, **{name: changed}))))
        expected = (sides[0] - sides[1]) / (2 * h)
        assert abs(float(grads[name].flatten()[index]) - expected) < 1e-4 * abs(expected), name


@pytest.mark.parametrize("particles, systems_count", [(500, 1), (2000, 1), (6000, 1), (300, 70), (300, 300)])
def test_shapes_chosen_by_default_step_alike(cuda, particles, systems_count):
    # every body falls and swings as its copy in the general engine does: float32 rounding over 40 substeps
    from twinbench.benchmark.performance import block
    from twinbench.physics.batch import Batch

    one = block(particles, 8, frames=2)
    batch = Batch([one] * systems_count, fps=1000, substeps=40, dt=2e-5, device="cuda")
    assert batch.resident is not None
    found = batch.rollout(2).positions
    batch.resident = None
    for positions, expected in zip(found, batch.rollout(2).positions, strict=True):
        assert (positions - expected).abs().max() < 1e-6


def test_the_reference_style_engine_simulates_the_same(cuda):
    # the published order of float32 sums against this engine's, over 667 substeps; hands have no velocity there
    from twinbench.benchmark.performance import block
    from twinbench.benchmark.reference_engine import ReferenceEngine
    from twinbench.physics.batch import Batch

    one = block(500, 10)
    still = tuple(t.with_values(controller_velocity=0.0) if t.name == "controller_springs" else t for t in one.terms)
    one = replace(one, terms=still)
    reference = ReferenceEngine(one, substeps=667, dt=5e-5)
    reference.frame()
    found = Batch([one], fps=30, substeps=667, dt=5e-5, device="cuda").rollout(2).positions[0][1].cpu().numpy()
    assert np.abs(found - reference.positions()).max() < 1e-5
