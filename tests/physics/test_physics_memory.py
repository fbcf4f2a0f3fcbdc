"""Springs with a memory against closed forms, in float64: one spring whose length is prescribed, its tension read from a heavy free end.

Memories are integrated exactly while the strain holds still, so a step in strain is followed to rounding; where the strain moves, to first
order in dt.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.physics.batch import Batch
from twinbench.physics.kernels import build
from twinbench.physics.parameters import Parameter
from twinbench.physics.stability import stable_step
from twinbench.physics.system import System
from twinbench.physics.terms import ControllerSprings, Dashpot, Gravity, Springs
from twinbench.physics.terms.creep import Creep
from twinbench.physics.terms.grip_slip import GripSlip
from twinbench.physics.terms.internal_friction import InternalFriction
from twinbench.physics.terms.plasticity import Plasticity
from twinbench.physics.terms.stages import StrandTerm
from twinbench.physics.terms.tearing import Tearing
from twinbench.physics.terms.viscoelastic import Viscoelastic

Y, HEAVY = 100.0, 1e9  # N; kg, which a tension of some 100 N moves by less than 1e-7 m in a second
ROUNDING = 1e-5  # N: tensions are HEAVY dv / dt with speeds of 1e-7 m/s, rounded by 1e-23 m/s, and strains are off by the heavy end's 1e-7


def stretched(terms, strains, dt, *, link=False):
    """(tension [N] at every strain but the last, memory (T - 1, terms) after each) of a spring of 1 m that goes through ``strains``.

    One end is a heavy particle, the other a particle that a controller carries along, or with ``link`` the controller itself, which forces
    see at the end of the substep: such a spring never feels ``strains[0]``.
    """
    path = np.zeros((len(strains), 1, 3))
    path[:, 0, 0] = 1 + np.asarray(strains, float)
    positions = np.concatenate([np.zeros((1, 3)), path[0]])[: 1 if link else 2]
    system = System(
        positions=positions,
        masses=[HEAVY] * len(positions),
        springs=[[1, 0]],
        rest=[1.0],
        stiffness=[Y],
        controllers=path,
        grips=None if link else [1],
        terms=[Springs(), ControllerSprings(), *terms],
    )
    batch = Batch([system], fps=1 / dt, substeps=1, dt=dt, double=True)
    inputs, tensions, memories = batch.inputs, [], []
    for k in range(len(path) - 1):
        _, x, v, carried = batch.march(k, 1, inputs, whole=True)
        memory = carried.memory
        tensions.append(HEAVY * float(v[0, 0] - inputs.v[0, 0]) / dt)
        memories.append(memory[0].numpy())
        inputs = replace(inputs, x=x, v=v, memory=memory)
    return np.array(tensions), np.array(memories)


# ---------------------------------------------------------------- plasticity


def test_plastic_strain_after_loading_holding_and_unloading():
    # q' = r (e - q - e_Y) above yield: held at e from rest, q(t) = (e - e_Y)(1 - exp(-r t)), which tends to e - e_Y; unloaded to that
    # strain nothing pulls and nothing flows, so it stays: the permanent set
    e, yields, rate, dt, held = 0.08, 0.05, 50.0, 2e-3, 300
    strains = [e] * held + [e - yields] * 50
    tension, (q,) = (a.T for a in stretched([Plasticity({"plastic_rate": rate, "yield_strain": yields})], strains, dt))
    t = dt * np.arange(1, held + 1)
    np.testing.assert_allclose(q[:held], (e - yields) * (1 - np.exp(-rate * t)), rtol=0, atol=1e-7)
    np.testing.assert_allclose(tension[:held], Y * (e - (e - yields) * (1 - np.exp(-rate * (t - dt)))), rtol=0, atol=ROUNDING)
    # exp(-50 0.6) = 1e-13 of the way is left
    np.testing.assert_allclose(q[held:], e - yields, rtol=0, atol=1e-7)
    np.testing.assert_allclose(tension[held:], 0.0, rtol=0, atol=ROUNDING)


def test_flow_is_odd_and_knows_a_yield_strain():
    term = Plasticity({"plastic_rate": 100.0, "yield_strain": 0.05})
    back_and_forth = 0.049 * np.sin(np.arange(60) / 5)
    _, below = stretched([term], back_and_forth, 1e-3)
    assert (below == 0).all()
    _, pulled = stretched([term], 2 * back_and_forth, 1e-3)
    _, pushed = stretched([term], -2 * back_and_forth, 1e-3)
    assert np.abs(pulled).max() > 0.01
    np.testing.assert_allclose(pushed, -pulled, rtol=0, atol=1e-7)


# ---------------------------------------------------------------- viscoelasticity


def test_stress_relaxation():
    # a step in strain: F(t) = Y e (1 + a exp(-t / tau)), Zener's standard linear solid
    e, a, tau, dt = 0.07, 3.0, 0.05, 1e-3
    tension, _ = stretched([Viscoelastic({"branch_stiffness": a, "relaxation_time": tau})], [e] * 300, dt)
    t = dt * np.arange(len(tension))
    np.testing.assert_allclose(tension, Y * e * (1 + a * np.exp(-t / tau)), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("ratio", [1.0, *(pytest.param(r, marks=pytest.mark.slow) for r in (0.3, 4.0))])  # omega tau
def test_loss_and_storage_modulus(ratio):
    # e = e0 sin(w t), and after the transient F = e0 (E' sin + E'' cos) with E' = Y (1 + a (w tau)^2 / (1 + (w tau)^2)) and
    # E'' = Y a w tau / (1 + (w tau)^2). The memory sees a strain of half a substep ago: first order in w dt, at most w dt of Y a
    a, tau = 2.0, 0.05
    storage, loss = Y * (1 + a * ratio**2 / (1 + ratio**2)), Y * a * ratio / (1 + ratio**2)
    errors = []
    for count in (50, 100):  # substeps in a period
        cycles = int(np.ceil(9 * ratio / (2 * np.pi))) + 1  # a transient of exp(-9) = 1e-4 before the last period
        angle = 2 * np.pi / count * np.arange((cycles + 1) * count + 1)
        dt = 2 * np.pi / count * tau / ratio
        tension, _ = stretched([Viscoelastic({"branch_stiffness": a, "relaxation_time": tau})], 0.05 * np.sin(angle), dt)
        last = slice(cycles * count, (cycles + 1) * count)
        found = [2 / count * tension[last] @ wave(angle[last]) / 0.05 for wave in (np.sin, np.cos)]
        errors.append(np.hypot(found[0] - storage, found[1] - loss))
        assert errors[-1] < Y * a * 2 * np.pi / count
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.15)  # first order


# ---------------------------------------------------------------- creep


def test_what_creeps_forgets_its_load_and_keeps_its_length():
    # Maxwell's fluid: held at e, F = Y e exp(-r t) and q = e (1 - exp(-r t)); let go, it is longer by q and flows no further than to e = 0
    e, rate, dt, held = 0.07, 8.0, 2e-3, 200
    tension, (q,) = (a.T for a in stretched([Creep({"creep_rate": rate})], [e] * held + [0.0] * 2, dt))
    t = dt * np.arange(held)
    np.testing.assert_allclose(tension[:held], Y * e * np.exp(-rate * t), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(q[:held], e * (1 - np.exp(-rate * (t + dt))), rtol=0, atol=1e-7)
    assert tension[held] == pytest.approx(-Y * e * (1 - np.exp(-rate * held * dt)), abs=ROUNDING)


def test_a_load_that_hangs_on_sinks_steadily():
    # m x'' = m g - Y (e - q) - c x': once it hangs, q' = r (e - q) is the pace at which the spring grows: r (m g - c x') / Y
    rate, mass, length, damping = 0.5, 0.2, 1.0, 3.0
    system = System(
        positions=[[0, 0, 0], [0, 0, -length]],
        masses=[1.0, mass],
        springs=[[0, 1]],
        stiffness=[Y],
        controllers=np.zeros((121, 1, 3)),
        grips=[0],
        terms=[
            Springs(),
            Dashpot({"dashpot_damping": damping}),
            Gravity({"gravity_z": -9.8}),
            ControllerSprings(),
            Creep({"creep_rate": rate}),
        ],
    )
    z = Batch([system], fps=30, substeps=100, double=True).rollout(121).positions[0][:, 1, 2].numpy()
    # from 2 s on, when the bounce has died out as exp(-c t / (2 m)) = exp(-15)
    assert np.diff(z[60:]).mean() * 30 == pytest.approx(-rate * mass * 9.8 / (Y + rate * damping) * length, rel=1e-4)


# ---------------------------------------------------------------- internal friction


@pytest.mark.parametrize("dt", [1e-2, 1e-3])
def test_friction_of_the_material_goes_to_its_limit_over_its_strain(dt):
    # Dahl: under a growing strain z = 1 - exp(-e / e_h), back from there z = -1 + (1 + z0) exp(-(e0 - e) / e_h); the pace does not matter
    limit, width = 0.03, 0.01
    up = np.linspace(0, 0.02, 201)
    strains = [*up, *up[::-1][1:]]
    term = InternalFriction({"internal_friction": limit, "friction_strain": width})
    _, (z,) = (a.T for a in stretched([term], strains, dt))
    top = 1 - np.exp(-0.02 / width)
    # the memory after a substep has seen the strain go as fast as at its start until its end
    np.testing.assert_allclose(z[1:200], 1 - np.exp(-up[2:] / width), rtol=0, atol=1e-6)
    np.testing.assert_allclose(z[-1], -1 + (1 + top) * np.exp(-0.02 / width), rtol=0, atol=0.01)  # one of 200 strains late


@pytest.mark.long
def test_a_cycle_takes_the_same_work_at_every_speed():
    # tension a Y z around e0 sin: for e0 >> e_h the loop is the rectangle 2 a Y x 2 e0 less rounded corners of 2 a Y e_h (1 - ...) each
    limit, width, e0, work = 0.03, 0.004, 0.04, []
    for dt in (1e-3, 1e-2):
        strains = e0 * np.sin(2 * np.pi * np.arange(801) / 400)
        term = InternalFriction({"internal_friction": limit, "friction_strain": width})
        tension, _ = stretched([term], strains, dt)
        last = slice(400, 800)
        work.append(np.sum(tension[last] * np.diff(strains)[last]))
    assert work[0] == pytest.approx(work[1], rel=1e-6)
    # each way: integral of a Y (1 - 2 exp(-s / e_h)) ds over 2 e0; elastic work closes. A substep's lag of the strain is 2 pi / 400 of e0
    expected = 2 * limit * Y * (2 * e0 - 2 * width * (1 - np.exp(-2 * e0 / width)))
    assert work[0] == pytest.approx(expected, rel=0.03)


# ---------------------------------------------------------------- tearing


@pytest.mark.parametrize("away", [0.0, 0.06, 0.12])
def test_damage_grows_beyond_the_tear_strain_and_stays(away):
    # held at e: q(t) = 1 - exp(-r w t (e - e_c) / e_c), w = exp(-d^2 / (2 R^2)), and the spring pulls with (1 - q) Y e
    e, tears, rate, radius, dt, held = 0.05, 0.02, 100.0, 0.06, 2e-3, 400
    middle = dict(tear_x=0.5 - away, tear_y=0.0, tear_z=0.0)
    term = Tearing({"tear_rate": rate, "tear_strain": tears, "tear_radius": radius, **middle})
    strains = [0.0] + [0.019] * 50 + [e] * held + [0.0] * 10 + [0.015] * 10
    tension, (q,) = (a.T for a in stretched([term], strains, dt))
    tension, q = tension[1:], q[1:]  # the unstrained start, from which the spring's middle is 0.5 m
    assert (q[:50] == 0).all()
    np.testing.assert_allclose(tension[:50], Y * 0.019, rtol=0, atol=ROUNDING)
    w = np.exp(-(away**2) / (2 * radius**2))
    t = dt * np.arange(1, held + 1)
    # the heavy end has moved by 1e-6 m in its 0.9 s, which counts 1e-6 / e_c = 5e-5 in the exponent, and x exp(-x) < 0.4
    np.testing.assert_allclose(q[50 : 50 + held], 1 - np.exp(-rate * w * t * (e - tears) / tears), rtol=0, atol=3e-5)
    assert tension[49 + held] < 2e-4 * Y * e if away == 0.12 else tension[49 + held] < 1e-9 * Y * e
    assert (np.diff(q[49 + held :]) == 0).all()  # what is torn does not heal
    np.testing.assert_allclose(tension[-9:], (1 - q[-1]) * Y * 0.015, rtol=0, atol=ROUNDING)


def test_nothing_tears_far_away():
    # ten radii away w = exp(-50) = 2e-22
    term = Tearing({"tear_rate": 1000.0, "tear_strain": 0.02, "tear_radius": 0.05, "tear_x": 0.0})
    assert np.abs(stretched([term], [0.0] + [0.2] * 50, 2e-3)[1]).max() < 1e-18


# ---------------------------------------------------------------- grip slip


def test_a_grip_slips_until_its_tension_is_the_threshold():
    # above F_s the tension is an exponential: F(t) = F_s + (Y e - F_s) exp(-r t); what slipped does not return
    e, force, rate, dt, held = 0.08, 3.0, 40.0, 2e-3, 300
    term = GripSlip({"slip_rate": rate, "slip_force": force})
    strains = [0.0] + [0.0299] * 20 + [e] * held + [0.0] * 20
    tension, (q,) = (a.T for a in stretched([term], strains, dt, link=True))
    assert (q[:20] == 0).all()  # Y 0.0299 = 2.99 N is below the threshold
    np.testing.assert_allclose(tension[:20], Y * 0.0299, rtol=0, atol=ROUNDING)
    t = dt * np.arange(held)
    np.testing.assert_allclose(tension[20 : 20 + held], force + (Y * e - force) * np.exp(-rate * t), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(q[-20:], e - force / Y, rtol=0, atol=1e-7)
    np.testing.assert_allclose(tension[-19:], force - Y * e, rtol=0, atol=ROUNDING)  # it is too long now, and pushes


def test_springs_of_the_body_and_squeezed_ones_do_not_slip():
    term = GripSlip({"slip_rate": 100.0, "slip_force": 1.0})
    assert (stretched([term], [0.2] * 20, 1e-3)[1] == 0).all()
    assert (stretched([term], [-0.2] * 20, 1e-3, link=True)[1] == 0).all()


# ---------------------------------------------------------------- whatever the substep


@given(
    e=st.floats(-0.9, 3),
    q=st.floats(-1, 1),
    step=st.floats(0, 1e6),
    limit=st.floats(0.001, 1),
)
@settings(max_examples=50, deadline=None)
def test_no_memory_overshoots(e, q, step, limit):
    # what each tends to is approached from its own side, be dt times the rate nothing or a million; twins are laws (test_physics_terms)
    spring, fuzz = (1 + e, 0.0, 1.0, Y, 1.0, np.zeros(3), 0.0), 1e-12
    after = Plasticity.twin_evolve(*spring, q, step / 10, 10.0, limit)
    target = min(max(q, e - limit), e + limit)
    assert min(q, target) - fuzz <= after <= max(q, target) + fuzz
    after = Viscoelastic.twin_evolve(*spring, q, step / 10, 1.0, 0.1)
    assert min(q, e) - fuzz <= after <= max(q, e) + fuzz
    after = Tearing.twin_evolve(*spring, abs(q), step / 10, 10.0, limit, 0.0, 0.0, 0.0, 1.0)
    assert abs(q) - fuzz <= after <= 1 + fuzz
    after = GripSlip.twin_evolve(*spring, q, step / 10, 10.0, limit * Y)
    assert q <= after <= max(q, e - limit) + fuzz


@pytest.mark.parametrize("double", [False, True], ids=["float32", "float64"])
def test_relaxation_keeps_its_digits(double):
    # 1 - exp(-x) for x from 1e-12 to 1e6, from numpy's expm1 in float64: a few units in the last place
    x = np.concatenate([10.0 ** np.linspace(-12, 6, 200), [0.0]])
    real = wp.float64 if double else wp.float32
    out = wp.zeros(len(x), dtype=real, device="cpu")
    wp.launch(settling(real), dim=len(x), inputs=[wp.array(x, dtype=real, device="cpu"), out], device="cpu")
    np.testing.assert_allclose(out.numpy(), -np.expm1(-x), rtol=8 * np.finfo(np.float64 if double else np.float32).eps, atol=0)


def settling(real):
    from twinbench.physics.relaxation import settled

    def each(x: wp.array(dtype=real), out: wp.array(dtype=real)):
        out[wp.tid()] = settled(x[wp.tid()])

    return wp.kernel(each, module="unique", enable_backward=False)


# ---------------------------------------------------------------- memories in the engine


@wp.func
def hour(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any, o: int):
    return p[o] * t


@wp.func
def keep(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any, o: int):
    return t


class Clock(StrandTerm):
    """A tension that grows with time; the memory is the time of the last substep."""

    name = "clock"
    parameters = (Parameter("clock", 1.0, 0.0, 10.0, "N/s", "growth"),)
    law = hour
    evolve = keep

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, clock):
        return clock * t

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, clock):
        return t


def test_time_is_that_since_frame_0():
    # a march from frame 5 on, 4 substeps a frame at 10 frames a second: the last substep of its third frame starts at 0.7 + 3 / 40 s
    system = System(
        positions=[[0, 0, 0], [1, 0, 0]], springs=[[0, 1]], stiffness=[0.0], controllers=np.zeros((9, 0, 3)), terms=[Clock({"clock": 2.0})]
    )
    batch = Batch([system], fps=10, substeps=4, double=True)
    _, _, v, carried = batch.march(5, 3, whole=True)
    memory = carried.memory
    assert memory.item() == pytest.approx(0.775, abs=1e-15)
    # m dv/dt = 2 t in steps of 1/40 s: the sum of t over twelve of them
    assert v[0, 0].item() == pytest.approx(2.0 * sum(0.5 + k / 40 for k in range(12)) / 40, rel=1e-14)


REMEMBERING = (Springs, Dashpot, Gravity, ControllerSprings, Plasticity, Viscoelastic, Tearing, GripSlip)
TYPICAL = {k: v for term in REMEMBERING if term.effect for k, v in term.effect.typical.items()} | dict(
    dashpot_damping=2.0, tear_x=0.4, tear_radius=0.4, slip_force=0.2
)


def net(seed, *, count=25, kinds=REMEMBERING):
    """A random body that moves, one particle gripped and two more pulled by hands."""
    rng = np.random.default_rng(seed)
    x = rng.random((count, 3))
    first, second = np.nonzero(np.triu(np.linalg.norm(x[:, None] - x[None], axis=2) < 0.5, 1))
    springs = np.concatenate([np.stack([first, second], 1), [[count + 1, 3], [count + 1, 4], [count + 2, 5]]])
    path = x[None, [0, 3, 5]] + np.cumsum(rng.normal(size=(5, 3, 3)) * 0.05, 0)
    return System(
        positions=x,
        velocities=rng.normal(size=x.shape),
        masses=rng.uniform(0.5, 2, count),
        springs=springs,
        rest=rng.uniform(0.3, 0.5, len(springs)),
        stiffness=rng.uniform(20, 60, len(springs)),
        controllers=path,
        grips=[0, -1, -1],
        terms=[k({p.name: TYPICAL[p.name] for p in k.parameters if p.name in TYPICAL}) for k in kinds],
    )


def test_a_batch_remembers_as_its_systems_do_bit_for_bit():
    systems = [net(seed, count=20 + seed) for seed in range(4)]
    together = Batch(systems, fps=30, substeps=40, workers=2).march(0, 4, whole=True)[3].memory
    for system, memory in zip(systems, together.split([len(s.springs) for s in systems]), strict=True):
        alone = Batch([system], fps=30, substeps=40).march(0, 4, whole=True)[3].memory
        assert torch.equal(memory, alone)
        assert (alone.abs().max(0).values > 1e-3).all()  # every kind has something to remember


def test_each_spring_once_or_from_both_ends():
    # the reaction that a lone thread leaves, and the force that a gather computes again, are the same sums in float64 with at most another
    # rounding (1e-16, over 160 substeps of a body that does not amplify it by more than 1e4); gradients add spring by spring or end by end
    def found(half):
        batch = Batch([net(0), net(1)], fps=30, substeps=40, double=True, workers=1)
        batch.kernels = build(batch.laws, True, half, 1, 1)
        inputs = replace(batch.inputs, **{k: t.clone().requires_grad_() for k, t in vars(batch.inputs).items()})
        out, x, v, carried = batch.march(0, 4, inputs, whole=True)
        memory = carried.memory
        weight = torch.linspace(-1, 1, memory.numel(), dtype=memory.dtype).view(memory.shape)
        (out.square().sum() + v.square().sum() + (memory * weight).sum()).backward()
        return [t.detach() for t in (out, x, v, memory)], {k: t.grad for k, t in vars(inputs).items()}

    (once, grads_once), (twice, grads_twice) = found(True), found(False)
    for a, b in zip(once, twice, strict=True):
        assert (a - b).abs().max() < 1e-12
    for name, a in ((n, g) for n, g in grads_once.items() if g.numel()):  # no hinges here
        assert a.abs().max() > 0
        assert (a - grads_twice[name]).abs().max() < 1e-10 * a.abs().max(), name


def test_what_is_not_handed_on_is_forgotten():
    batch = Batch([net(0)], fps=30, substeps=40, double=True)
    _, x, v, carried = batch.march(0, 2, whole=True)
    memory = carried.memory
    later = replace(batch.inputs, x=x, v=v)
    remembers, forgets = batch.march(2, 2, replace(later, memory=memory))[0], batch.march(2, 2, later)[0]
    assert torch.equal(remembers, batch.march(0, 4)[0][2:])
    assert (remembers - forgets).abs().max() > 1e-3
    assert torch.equal(batch.march(2, 0, replace(later, memory=memory), whole=True)[3].memory, memory)


def test_without_memories_there_is_one_empty_column():
    batch = Batch([net(0, kinds=(Springs, Dashpot, ControllerSprings))], fps=30, substeps=40, double=True)
    memory = torch.randn(batch.inputs.memory.shape, dtype=torch.float64)
    assert memory.shape == (len(batch.inputs.rest), 1)
    out, *_, carried = batch.march(0, 2, replace(batch.inputs, memory=memory), whole=True)
    after = carried.memory
    assert torch.equal(after, memory) and torch.equal(out, batch.march(0, 2)[0])


def test_springs_that_are_left_out_keep_what_they_were_given():
    # without their term, springs to controllers are not there: nothing changes their memory, and its gradient passes through
    batch = Batch([net(0, kinds=(Springs, Dashpot, Plasticity))], fps=30, substeps=40, double=True)
    memory = torch.full(batch.inputs.memory.shape, 0.01, dtype=torch.float64, requires_grad=True)
    after = batch.march(0, 2, replace(batch.inputs, memory=memory), whole=True)[3].memory
    assert (after[-3:] == 0.01).all() and (after[:-3] != 0.01).any()
    after.sum().backward()
    assert (memory.grad[-3:] == 1).all()


# ---------------------------------------------------------------- how long a substep may be


@pytest.mark.parametrize("tau", [0.01, 0.1, 10.0])
@pytest.mark.parametrize("share", [0.5, 20.0])
def test_a_maxwell_branch_shortens_the_stable_step(share, tau):
    # one weight on a spring, w = Y dt^2 / (L0 m), s = 1 - exp(-dt / tau): x'' = -w ((1 + a) x - a q) becomes unstable where z = -1 solves
    # its characteristic polynomial: w (1 + a + a s / (2 - s)) = 4, and s / (2 - s) = tanh(dt / (2 tau))
    system = System(
        positions=[[0, 0, 1 + 1e-9]],
        springs=[[1, 0]],
        rest=[1.0],
        stiffness=[Y],
        controllers=[[[0, 0, 0]]],
        terms=[Springs(), ControllerSprings(), Viscoelastic({"branch_stiffness": share, "relaxation_time": tau})],
    )
    dt = stable_step(system)
    assert (1 + share * (1 + np.tanh(dt / (2 * tau)))) * Y * dt**2 <= 4

    def largest(step):
        moved = Batch([system], fps=1 / step, substeps=1, dt=step, double=True).rollout(400).positions[0].numpy()
        return np.abs(np.nan_to_num(moved - [0, 0, 1], nan=np.inf, posinf=np.inf)).max()

    assert largest(0.99 * dt) < 1e-7 < 1e-4 < largest(1.25 * dt)
