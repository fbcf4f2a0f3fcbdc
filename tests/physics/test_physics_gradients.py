"""Gradients of roll-outs against central differences in float64, for every input; of terms' parameters: test_terms_conformance.py."""

import gc
import weakref
from functools import cache

import numpy as np
import pytest
import torch
import twinbench.physics.batch as engine
from twinbench.benchmark.conformance.gradients import (
    AIR,
    FRAMES,
    NAMES,
    batch_of,
    check,
    leaves,
    loss,
    some,
)
from twinbench.physics import march
from twinbench.physics.batch import Batch, Inputs
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
    Torsion,
)
from twinbench.physics.terms.grip_slip import GripSlip
from twinbench.physics.terms.plasticity import Plasticity
from twinbench.physics.terms.viscoelastic import Viscoelastic

ROD = (*AIR, Bending, BendingDamping, Torsion)
MEMORIES = (*AIR, Plasticity, SelfCollision, Viscoelastic, GripSlip)
KINDS = {"ground": AIR, "ground and contacts": (*AIR, SelfCollision), "memories too": MEMORIES}
KINDS |= {"ground and hinges": ROD, "all": (*MEMORIES, Bending, BendingDamping, Torsion, PlateDrag, Pressure)}
every_kind = pytest.mark.parametrize("kinds", KINDS.values(), ids=KINDS)
# see test_physics_materials.py, test_physics_points.py and test_physics_fabrics.py
OF_SOLIDS = ("cell_memory", "load", "held", "anchor", "slid", "sheet_memory", "hinge_memory")
HINGED = ("natural", "flexure", "directors")  # inputs that only hinge terms read


@cache
def differentiated(kinds, grip):
    """A batch, and its inputs with their gradients."""
    batch = batch_of(kinds, grip=grip)
    inputs = leaves(batch)
    loss(batch, inputs).backward()
    return batch, inputs


@pytest.mark.parametrize("name", [n for n in NAMES if n != "table"])
@pytest.mark.parametrize("grip", [True, False], ids=["grip", "no grip"])
@every_kind
def test_gradient_of_every_input(kinds, grip, name):
    if (name in HINGED and Bending not in kinds) or name in OF_SOLIDS:
        pytest.skip("nothing reads it")
    batch, inputs = differentiated(kinds, grip)
    gradient = getattr(inputs, name).grad
    assert (gradient.abs().max() > 0) == (name != "memory" or batch.remembering)
    check(batch, inputs, name, some(gradient))


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
        largest = a.abs().max().item() if a.numel() else 0.0
        assert torch.allclose(a, b, rtol=1e-10, atol=1e-12 * largest), n


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


@pytest.mark.long
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

    def spy(self, *args, **named):
        real(self, *args, **named)
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

    def spy(self, *args, **named):
        real(self, *args, **named)
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
