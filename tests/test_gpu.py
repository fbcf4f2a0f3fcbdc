"""The engine on CUDA against the same engine on the CPU. Run on a machine with a GPU: python -m pytest tests/test_gpu.py"""

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

    made = [hinged(block(150 + 40 * k, 10, frames=4, seed=k)) for k in range(count)]
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
    return replace(body, hinges=hinges, chains=[chain], terms=(*body.terms, *laws))


def march(made, device, *, double, team=None):
    from twinbench.physics.batch import Batch, Inputs

    batch = Batch(made, fps=100, substeps=40, dt=5e-5, device=device, double=double, team=team)
    inputs = Inputs(**{f.name: getattr(batch.inputs, f.name).clone().requires_grad_() for f in fields(Inputs)})
    out, x, v, carried = batch.march(0, 3, inputs, whole=True)
    memory = carried.memory
    weight = np.random.default_rng(0).normal(size=tuple(out.shape))
    loss = (out * out.new_tensor(weight)).sum() + (x**2).sum() + (v**2).sum() + memory.sum()
    loss.backward()
    return out.detach().cpu(), {f.name: getattr(inputs, f.name).grad.cpu() for f in fields(Inputs)}


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
