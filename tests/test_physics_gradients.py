"""Gradients of roll-outs against central differences in float64, for every input and for every parameter of every term there is."""

import gc
import importlib
import pkgutil
import weakref
from dataclasses import fields

import numpy as np
import pytest
import torch
import twinbench.physics.batch as engine
import twinbench.physics.terms as rooms
from twinbench.physics import march
from twinbench.physics.batch import Batch, Inputs
from twinbench.physics.facets import solid_facets
from twinbench.physics.hinges import natural_curvature
from twinbench.physics.system import System
from twinbench.physics.terms import (
    Bending,
    BendingDamping,
    ControllerSprings,
    Dashpot,
    Gravity,
    Ground,
    LinearDrag,
    PlateDrag,
    Pressure,
    SelfCollision,
    Springs,
    Term,
    Torsion,
)
from twinbench.physics.terms.grip_slip import GripSlip
from twinbench.physics.terms.plasticity import Plasticity
from twinbench.physics.terms.viscoelastic import Viscoelastic
from twinbench.physics.topology import controller_springs, object_springs, rope_hinges, sheet_hinges

PARTICLES, FRAMES, SUBSTEPS = 40, 4, 25  # 100 substeps
ROPE = 6  # particles
NAMES = [f.name for f in fields(Inputs)]
AIR = (Springs, Dashpot, Gravity, LinearDrag, Ground, ControllerSprings)
ROD = (*AIR, Bending, BendingDamping, Torsion)
MEMORIES = (*AIR, Plasticity, SelfCollision, Viscoelastic, GripSlip)
KINDS = {"ground": AIR, "ground and contacts": (*AIR, SelfCollision), "memories too": MEMORIES}
KINDS |= {"ground and hinges": ROD, "all": (*MEMORIES, Bending, BendingDamping, Torsion, PlateDrag, Pressure)}
every_kind = pytest.mark.parametrize("kinds", KINDS.values(), ids=KINDS)
HINGED = ("natural", "flexure", "directors")  # inputs that only hinge terms read
VALUES = dict(
    observer_bandwidth=3.0,
    dashpot_damping=5.0,
    gravity_x=1.0,
    collision_dist=0.03,
    controller_velocity=0.7,
    ground_offset=0.003,
    ground_normal_x=0.1,
    far_share=0.7,
    far_reach=0.025,
    brace_share=0.7,
    told_gravity_x=1.0,
    told_gravity_z=-9.8,
)
READ_BY = {"natural_curvature": Bending}  # terms that only change what another one reads
REACH = {"braces": 0.045}  # m, of springs that skip the rope's nodes; of others, 0.035


def found_terms():
    """Every term in the folder, also one that nobody imports."""
    modules = [importlib.import_module(f"{rooms.__name__}.{m.name}") for m in pkgutil.iter_modules(rooms.__path__)]
    found = {v for m in modules for v in vars(m).values() if isinstance(v, type) and issubclass(v, Term) and hasattr(v, "name")}
    return sorted(found, key=lambda term: term.name)


def kinds_with(term):
    """The usual terms and ``term``, in place of its rival at a stage that takes one."""
    rivals = {t for t in AIR if t.stage == term.stage and t.stage in ("move", "contact")}
    readers = [READ_BY[term.name]] if term.name in READ_BY else []
    return AIR if term in AIR else (*(t for t in AIR if t not in rivals), *readers, term)


def make(kinds, *, grip=True, count=PARTICLES, seed=0):
    """A body thrown at the table, held by a grip and pulled by a hand: masses, rest lengths and stiffness all differ; a rope is in it."""
    rng = np.random.default_rng(seed)
    points = rng.random((count, 3)) * 0.08
    points[-ROPE:] = 0.005 + 0.011 * np.arange(ROPE, 0, -1)[:, None] + points[-ROPE:] * 0.05
    points[0] = -0.006 + points[0] * 0.05
    points[:, 2] -= 0.083
    path = points[None, :2] + np.cumsum(rng.normal(size=(FRAMES, 2, 3)) * 0.003, 0)
    path[0] = points[:2]
    path[:, 1] += [0.0, 0.01, -0.01]
    ties = controller_springs(path[0, 1:], points, radius=0.05, max_neighbours=6)
    ties[:, 0] = count + 1
    reach = max([REACH.get(k.name, 0.035) for k in kinds])
    springs = np.concatenate([object_springs(points, radius=reach, max_neighbours=10), ties])
    nodes = np.concatenate([points, path[0]])
    # a rope through the body, held at its end, and hinges that follow no rope
    rope = np.append(np.arange(count - ROPE, count), 0)
    hinges = np.concatenate([rope_hinges(rope), sheet_hinges(points[: count - ROPE], springs, straight=60)])
    rest = np.linalg.norm(nodes[springs[:, 0]] - nodes[springs[:, 1]], axis=1) * rng.uniform(0.9, 1.1, len(springs))
    values = VALUES | {name: value for k in kinds if k.effect for name, value in k.effect.typical.items()}
    terms = [k({p.name: values[p.name] for p in k.parameters if p.name in values}) for k in kinds]
    seen = points + np.cumsum(rng.normal(size=(FRAMES, count, 3)) * 0.003, 0)
    seen[2, ::3] = np.nan
    return System(
        positions=points,
        velocities=rng.normal(size=points.shape) * 0.3 + [0.2, 0.0, 0.3],
        masses=rng.uniform(0.5, 2, count),
        springs=springs,
        rest=rest,
        stiffness=rng.uniform(50, 100, len(springs)),
        controllers=path,
        grips=[0, -1] if grip else None,
        seen=seen,
        hinges=hinges,
        natural=natural_curvature(nodes, hinges, [rope]) * rng.uniform(0.5, 1.5, (len(hinges), 1)),
        flexure=rng.uniform(0.5, 2, len(hinges)),
        chains=[rope],
        facets=solid_facets(points, radius=0.1),
        terms=terms,
    )


def batch_of(kinds, *, grip=True, double=True, seeds=(8, 12)):
    # with other seeds a contact begins or a spring yields within h of the start: a jump, no derivative
    return Batch([make(kinds, grip=grip, seed=s) for s in seeds], fps=30, substeps=SUBSTEPS, double=double, workers=1)


def leaves(batch):
    return Inputs(**{n: getattr(batch.inputs, n).clone().requires_grad_() for n in NAMES})


def loss(batch, inputs, *, frame=0, frames=FRAMES):
    """A weighted sum of the particles' positions at every frame and of the final state: every output counts."""
    generator = torch.Generator().manual_seed(0)
    out, x, v, carried = batch.march(frame, frames, inputs, whole=True)
    total = 0.0
    for values, scale in ((out, 1.0), (x[None], 1.0), (v[None], 0.01)):
        for part in batch.split(values):
            total = total + scale * (part * torch.randn(part.shape, dtype=torch.float64, generator=generator)).sum()
    if batch.hinged:
        weight = torch.randn(carried.directors.shape, dtype=torch.float64, generator=generator)
        total = total + 0.01 * (carried.directors * weight).sum()
    return total


def central_difference(batch, inputs, name, index, **window):
    """(L(u + h) - L(u - h)) / 2h for one number u."""
    values = {n: getattr(inputs, n).detach().clone() for n in NAMES}
    flat = values[name].view(-1)
    u = abs(flat[index].item())
    h = min(1e-7 * max(0.1, u), 1e-6 * u if name == "table" and u else 1.0)  # some parameters are small
    h = {"directors": 1e-6, "memory": 1e-7}.get(name, h)  # which matter little: rounding counts
    sides = []
    with torch.no_grad():
        for sign in (1, -1):
            flat[index] += sign * h
            sides.append(loss(batch, Inputs(**values), **window).item())
            flat[index] -= sign * h
    return (sides[0] - sides[1]) / (2 * h)


def check(batch, inputs, name, indices, **window):
    """Relative error below 1e-4, relative to the number itself or to a thousandth of the largest of its kind.

    h = 1e-7 of a number of order 0.1 to 100: truncation h^2 and rounding 1e-15 |L| / h = 1e-8 |L| are both far below.
    """
    gradient = getattr(inputs, name).grad.flatten()
    for i in indices:
        expected = central_difference(batch, inputs, name, int(i), **window)
        scale = max(abs(expected), 1e-3 * gradient.abs().max().item(), 1e-6)
        which = batch.columns[i % len(batch.columns)] if name == "table" else int(i)
        assert abs(gradient[i].item() - expected) < 1e-4 * scale, f"{name} {which}"


def some(gradient, count=6):
    """Indices of the ``count`` largest and of ``count`` others."""
    order = torch.argsort(-gradient.abs().flatten())
    rest = order[count:][torch.randperm(max(0, len(order) - count), generator=torch.Generator().manual_seed(1))]
    return torch.cat([order[:count], rest[:count]]).tolist()


@pytest.mark.parametrize("name", [n for n in NAMES if n != "table"])
@pytest.mark.parametrize("grip", [True, False], ids=["grip", "no grip"])
@every_kind
def test_gradient_of_every_input(kinds, grip, name):
    if name in HINGED and Bending not in kinds:
        pytest.skip("nothing reads it")
    batch = batch_of(kinds, grip=grip)
    inputs = leaves(batch)
    loss(batch, inputs).backward()
    gradient = getattr(inputs, name).grad
    assert (gradient.abs().max() > 0) == (name != "memory" or batch.remembering)
    check(batch, inputs, name, some(gradient))


@pytest.mark.parametrize("term", found_terms(), ids=lambda t: t.name)
def test_gradient_of_every_parameter_of_every_term(term):
    batch = batch_of(kinds_with(term), seeds=(0, 1))  # with (8, 12) a contact hangs on collision_dist to within h
    inputs = leaves(batch)
    loss(batch, inputs).backward()
    columns = [batch.column(p.name) for p in term.parameters]
    width = len(batch.columns)
    check(batch, inputs, "table", [row * width + c for row in range(2) for c in columns])
    if columns:  # the roll-out feels the term, or the comparison would be one of zeros
        assert inputs.table.grad[:, columns].abs().max() > 1e-6


def test_a_window_that_starts_late_and_outlasts_the_path():
    # from frame 2 on, two frames beyond the last of the path, which holds its end
    batch = batch_of((*AIR, SelfCollision))
    inputs, window = leaves(batch), dict(frame=2, frames=4)
    loss(batch, inputs, **window).backward()
    assert (inputs.path.grad[:2] == 0).all() and inputs.path.grad[-1].abs().max() > 0
    check(batch, inputs, "path", some(inputs.path.grad), **window)
    check(batch, inputs, "x", some(inputs.x.grad, 3), **window)


@pytest.mark.parametrize("room", [1, 2, 3, 8, 25, 99])  # 100 = 33 * 3 + 1 = 99 + 1: also a last stretch of a single substep
@every_kind
def test_checkpointed_gradients_equal_the_whole_history_bit_for_bit(kinds, room, monkeypatch):
    # states are recomputed by the same arithmetic from the same start, so nothing may differ; only the path's gradient is summed in another
    # order, because that of a frame's end may be given in two parts
    batch = batch_of(kinds)
    whole, parts = leaves(batch), leaves(batch)
    loss(batch, whole).backward()
    numbers = batch.node_count * (18 if batch.colliding else 14)
    if batch.hinged:
        numbers += 3 * len(batch.inputs.directors)
    if batch.remembering:
        numbers += 2 * batch.inputs.memory.numel()  # at both ends of a spring
    monkeypatch.setattr(engine, "HISTORY_BYTES", room * numbers * 8)
    assert len(batch.stretches(FRAMES, history=True)) >= 100 / room
    loss(batch, parts).backward()
    for n in NAMES:
        a, b = getattr(whole, n).grad, getattr(parts, n).grad
        assert torch.allclose(a, b, rtol=1e-13, atol=0) if n == "path" else torch.equal(a, b), n


@every_kind
def test_frame_by_frame_equals_one_march(kinds):
    # the state carried from frame to frame, with what springs remember, is the whole memory of the engine, so positions are equal bit for
    # bit; gradients are summed over frames in another order, which rounds differently
    batch = batch_of(kinds)
    once, frames = leaves(batch), leaves(batch)
    out, x, v, last = batch.march(0, FRAMES, once, whole=True)
    state, found, carried = (frames.x, frames.v), [], {n: getattr(frames, n) for n in vars(last)}
    for f in range(FRAMES):
        own = Inputs(**{**{n: getattr(frames, n) for n in NAMES}, "x": state[0], "v": state[1], **carried})
        end, *state, rest = batch.march(f, 1, own, whole=True)
        carried = vars(rest)
        found.append(end)
    found = torch.cat(found)
    assert torch.equal(out, found) and torch.equal(x, state[0]) and torch.equal(v, state[1])
    assert all(torch.equal(t, carried[n]) for n, t in vars(last).items())
    weight = torch.randn(out.shape, dtype=out.dtype, generator=torch.Generator().manual_seed(2))
    (out * weight).sum().backward()
    (found * weight).sum().backward()
    for n in NAMES:
        a, b = getattr(once, n).grad, getattr(frames, n).grad
        assert torch.allclose(a, b, rtol=1e-10, atol=1e-12 * a.abs().max().item()), n


def test_truncated_at_frames_as_published():
    # with the carried state detached, the gradient of a frame's loss is that of the frame alone
    batch = batch_of(AIR)
    inputs = leaves(batch)
    with torch.no_grad():
        _, x, v = batch.march(0, 2, inputs)
    window = Inputs(**{**{n: getattr(inputs, n) for n in NAMES}, "x": x.clone().requires_grad_(), "v": v.clone().requires_grad_()})
    loss(batch, window, frame=2, frames=1).backward()
    assert inputs.x.grad is None and window.x.grad.abs().max() > 0
    check(batch, window, "stiffness", some(inputs.stiffness.grad, 3), frame=2, frames=1)


def test_only_what_is_asked_for_gets_a_gradient():
    batch = batch_of(AIR)
    inputs = Inputs(**{n: getattr(batch.inputs, n).clone().requires_grad_(n == "stiffness") for n in NAMES})
    loss(batch, inputs).backward()
    assert inputs.stiffness.grad is not None and inputs.x.grad is None
    assert not batch.rollout(3, inputs).positions[0].requires_grad


def test_systems_of_a_batch_do_not_mix():
    # d(loss of system 0) / d(inputs of system 1) is exactly 0, and system 0's gradients are those it has alone, bit for bit
    both, alone = batch_of((*AIR, SelfCollision)), batch_of((*AIR, SelfCollision), seeds=(8,))
    grads = []
    for batch in (both, alone):
        inputs = leaves(batch)
        out, _, _ = batch.march(0, FRAMES, inputs)
        batch.split(out)[0].square().sum().backward()
        grads.append(inputs)
    springs, nodes = len(alone.inputs.rest), alone.node_count
    for n, own in dict(x=nodes, v=nodes, mass=nodes, rest=springs, stiffness=springs, table=1).items():
        g = getattr(grads[0], n).grad
        assert torch.equal(g[:own], getattr(grads[1], n).grad), n
        assert (g[own:] == 0).all(), n


def test_single_precision_gradients_follow_double():
    # smooth case (no contacts): 100 substeps of float32, each rounding by 6e-8
    grads = []
    for double in (True, False):
        batch = batch_of((Springs, Dashpot, Gravity, LinearDrag, Ground, ControllerSprings), double=double)
        inputs = leaves(batch)
        inputs.table.data[:, batch.column("ground_offset")] = -1.0
        loss(batch, inputs).backward()
        grads.append(inputs)
    for n in [n for n in NAMES if n not in HINGED]:
        a, b = (getattr(g, n).grad.double() for g in grads)
        assert (a - b).norm() <= 1e-4 * a.norm(), n


def test_gradcheck_of_torch():
    # torch's own comparison with finite differences, through functions before and after the march
    system = System(
        positions=[[0.0, 0, -0.3], [0.1, 0, -0.3]],
        velocities=[[0.1, 0, 0], [0, 0.2, 0]],
        springs=[[0, 1], [2, 0]],
        stiffness=[20.0, 30.0],
        controllers=[[[0.0, 0.1, -0.35]], [[0.0, 0.12, -0.4]]],
        terms=[k() for k in AIR],
    )
    batch = Batch([system], fps=10, substeps=20, double=True)

    def f(log_stiffness, x, path):
        given = {n: getattr(batch.inputs, n) for n in NAMES}
        out, x, v = batch.march(0, 1, Inputs(**{**given, "stiffness": log_stiffness.exp(), "x": x, "path": path}))
        return out.square(), x, v.sin()

    start = [t.clone().requires_grad_() for t in (batch.inputs.stiffness.log(), batch.inputs.x, batch.inputs.path)]
    assert torch.autograd.gradcheck(f, start, eps=1e-6, atol=1e-7, rtol=1e-4)


def test_a_fit_through_torch_recovers_the_stiffness():
    # a hanging weight's fall is observed; Adam on log Y through the engine finds the Y that made it
    def hanging(stiffness):
        hand = np.zeros((1, 1, 3))
        system = System(positions=[[0, 0, 0.1]], springs=[[1, 0]], stiffness=[stiffness], controllers=hand, terms=[k() for k in AIR])
        return Batch([system.with_values(dashpot_damping=1.0, ground_offset=-9)], fps=30, substeps=40, double=True)

    batch = hanging(10.0)
    observed = hanging(25.0).rollout(11).positions[0][1:]
    log_y = torch.tensor([np.log(10.0)], dtype=torch.float64, requires_grad=True)
    adam = torch.optim.Adam([log_y], lr=0.05)
    given = {n: getattr(batch.inputs, n) for n in NAMES}
    for _ in range(200):
        adam.zero_grad()
        out, _, _ = batch.march(0, 10, Inputs(**{**given, "stiffness": log_y.exp()}))
        (batch.split(out)[0] - observed).square().sum().backward()
        adam.step()
    assert log_y.exp().item() == pytest.approx(25.0, rel=1e-3)


@pytest.mark.parametrize("room", [None, 8])
def test_a_way_back_is_freed_with_its_result(room, monkeypatch):
    # histories are large: nothing may keep one alive once the result is gone
    kept = []
    real = march.World.__init__

    def spy(self, *args):
        real(self, *args)
        kept.append(weakref.ref(self))

    monkeypatch.setattr(march.World, "__init__", spy)
    batch = batch_of(AIR)
    if room:
        monkeypatch.setattr("twinbench.physics.batch.HISTORY_BYTES", room * batch.node_count * 8 * 14)
    inputs = leaves(batch)
    total = loss(batch, inputs)
    total.backward()
    del total
    gc.collect()
    assert kept and all(reference() is None for reference in kept)


def test_a_history_is_freed_on_the_way_back_and_made_again_for_another(monkeypatch):
    # the result's context lives as long as the result; a fit holds that of the last window while it steps the next one
    kept, real = [], march.World.__init__

    def spy(self, *args):
        real(self, *args)
        kept.append(weakref.ref(self))

    monkeypatch.setattr(march.World, "__init__", spy)
    batch = batch_of(AIR)  # in one stretch, whose history is kept from the way there
    inputs = leaves(batch)
    total = loss(batch, inputs)
    first = torch.autograd.grad(total, [inputs.x, inputs.stiffness, inputs.table], retain_graph=True)
    gc.collect()
    assert kept and all(reference() is None for reference in kept)
    again = torch.autograd.grad(total, [inputs.x, inputs.stiffness, inputs.table])
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
