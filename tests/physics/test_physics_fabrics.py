"""What sheets and ropes remember: relaxing, rubbing, creep and sets against closed forms; the engine against numpy; gradients."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from twinbench.benchmark.conformance.gradients import AIR, draped, make
from twinbench.physics import batch as engine
from twinbench.physics.batch import Batch, Inputs
from twinbench.physics.fabrics import ROPE, fabric_twin, size_twin
from twinbench.physics.kernels import build
from twinbench.physics.sheets import Sheet, internal_forces
from twinbench.physics.stability import stable_step
from twinbench.physics.system import System
from twinbench.physics.terms import (
    Bending,
    BendingDamping,
    Gravity,
    LinearDrag,
    Membrane,
    PlateBending,
    RopeCreep,
    RopeFriction,
    RopeRelaxing,
    RopeYielding,
    SheetCreep,
    SheetFriction,
    SheetRelaxing,
    SheetTension,
    SheetYielding,
    Torsion,
)
from twinbench.physics.topology import rope_hinges

STIFF = 40.0  # N/m
BEND = 1e-3  # N m
KINDS = (SheetCreep, SheetYielding, SheetRelaxing, SheetFriction)
TYPICAL = {
    SheetCreep: {"sheet_creep_rate": 2.0},
    SheetYielding: {"sheet_yielding_rate": 30.0, "sheet_yield_strain": 0.01, "sheet_yield_surface": 1e-3},
    SheetRelaxing: {"sheet_branch_share": 1.5, "sheet_branch_time": 0.05},
    SheetFriction: {"sheet_rub": 0.01, "sheet_rub_strain": 0.005, "sheet_rub_surface": 1e-3},
}
OF_ROPES = {
    RopeCreep: {"rope_creep_rate": 2.0},
    RopeYielding: {"rope_yielding_rate": 30.0, "rope_yield_strain": 0.01, "rope_yield_surface": 5e-3},
    RopeRelaxing: {"rope_branch_share": 1.5, "rope_branch_time": 0.05},
    RopeFriction: {"rope_rub": 0.01, "rope_rub_strain": 0.005, "rope_rub_surface": 5e-3},
}
ALONE = [Membrane({"membrane_stiffness": STIFF}), PlateBending({"plate_rigidity": BEND})]


def fabric(*kinds, seed=0, **values):
    """A wavy sheet that a hand leads by a side, which remembers by terms of ``kinds``."""
    own = [k(TYPICAL[k]) for k in kinds]
    return replace(draped(seed=seed), terms=[*ALONE, *own]).with_values(**values)


def history(terms, strains, dt, *, stage="membrane"):
    """(T, 3) stresses of tensors ``strains`` (T, 3) that follow each other by ``dt`` s, and what is remembered at the end."""
    q = np.zeros((sum(t.stage in ("sheet_flow", "sheet_branch") for t in terms), 3))
    found = []
    for strain in strains:
        stress, q = fabric_twin(terms, strain, q, dt, stage=stage)
        found.append(stress)
    return np.array(found), q


# ---------------------------------------------------------------- laws


def test_the_size_of_a_strips_strain_is_its_strain():
    # von Mises over Young's modulus at Poisson's ratio 1/2: a strip pulled by e, sheared by g has 2 g / sqrt(3), all-round 2 e
    for strain, wanted in (([0.02, -0.01, 0.0], 0.02), ([0.0, 0.0, 0.03], 0.06 / np.sqrt(3)), ([0.01, 0.01, 0.0], 0.02)):
        assert size_twin(strain, 0.0, 1e-3) == pytest.approx(wanted, rel=1e-9)
        assert size_twin(np.array(strain) * 1000, 1.0, 1e-3) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("stage", ["membrane", "plate"])
def test_stress_of_a_held_strain_fades(stage):
    # Maxwell's fluid: S = S_0 exp(-r t); Zener's solid: S = S_0 (1 + a exp(-t / tau)). Exact while the strain is held, whatever the step
    strain, dt, steps = np.array([0.02, 0.005, -0.004]), 0.03, 40
    own = ALONE[stage == "plate"].twin(strain, **ALONE[stage == "plate"].values)
    t = dt * np.arange(1, steps + 1)[:, None]
    creep, _ = history([*ALONE, SheetCreep(TYPICAL[SheetCreep])], [strain] * steps, dt, stage=stage)
    np.testing.assert_allclose(creep, own * np.exp(-2.0 * t), rtol=1e-12)
    relaxing, _ = history([*ALONE, SheetRelaxing(TYPICAL[SheetRelaxing])], [strain] * steps, dt, stage=stage)
    np.testing.assert_allclose(relaxing, own * (1 + 1.5 * np.exp(-t / 0.05)), rtol=1e-12)


@pytest.mark.parametrize("stage", ["membrane", "plate"])
def test_a_sheet_keeps_what_went_beyond_its_yield_strain(stage):
    # pulled or bent to three times the yield strain, held until the overstress is gone (exp(-30)), and let go: e - e_Y is kept, in the
    # direction in which it was strained, and stress is that of the yield strain before
    way = np.array([1.0, -0.5, 0.0]) * (1000.0 if stage == "plate" else 1.0)
    terms, limit = [*ALONE, SheetYielding(TYPICAL[SheetYielding])], 0.01
    stress, q = history(terms, [3 * limit * way] * 100, 0.01, stage=stage)
    own = ALONE[stage == "plate"]
    np.testing.assert_allclose(stress[-1], own.twin(limit * way, **own.values), rtol=1e-9)
    np.testing.assert_allclose(q[0], 2 * limit * way, rtol=1e-9)
    np.testing.assert_allclose(history(terms, [0.99 * limit * way] * 10, 0.01, stage=stage)[1], 0)


@pytest.mark.parametrize("slower", [1, 7])
def test_friction_takes_the_same_work_at_every_speed(slower):
    # a bilinear loop: a cycle between +-A takes 4 a (A - e_h) S(n) : n, n of size 1, a the most it resists with as strain; corners are met
    # by whole steps
    most, limit, reach = 0.01, 0.005, 0.02
    turn = np.concatenate([np.linspace(0, 1, 41), np.linspace(1, -1, 81)[1:], np.linspace(-1, 1, 81)[1:]])
    way = np.array([1.0, -0.5, 0.0])
    strains = np.repeat(reach * turn, slower)[:, None] * way
    stress, _ = history([ALONE[0], SheetFriction(TYPICAL[SheetFriction])], strains, 1e-3)
    cycle = slice(40 * slower, None)
    work = np.trapezoid(stress[cycle] @ way, reach * np.repeat(turn, slower)[cycle])
    assert work == pytest.approx(4 * most * (reach - limit) * (ALONE[0].twin(way, **ALONE[0].values) @ way), rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_no_way_round_gains_work(kind):
    # of a closed way of strain, remembered twice over: sum of S : dE is never below nothing, by midpoints
    rng = np.random.default_rng(1)
    terms = [ALONE[0], kind(TYPICAL[kind])]
    for _ in range(5):
        t = np.linspace(0, 4 * np.pi, 2001)[:, None]
        strains = sum(0.02 * rng.normal(size=3) * np.sin(k * t) + 0.02 * rng.normal(size=3) * (np.cos(k * t) - 1) for k in (1, 2))
        stress, _ = history(terms, strains, 1e-3)
        work = (((stress[1:] + stress[:-1]) / 2 * np.diff(strains, axis=0)) @ [1.0, 1.0, 2.0]).sum()
        assert work > 0


# ---------------------------------------------------------------- in the engine


def test_a_substep_is_that_of_numpy():
    # from a memory of its own: v' = v + dt F / m, and memories; rounding of float64 only
    one, dt = replace(fabric(*KINDS), controllers=np.zeros((1, 0, 3)), grips=None), 1e-4
    batch = Batch([one], fps=1 / dt, substeps=1, double=True)
    count = len(one.sheet.triangles)
    q = np.random.default_rng(1).normal(size=(count, len(KINDS), 2, 3)) * np.array([0.01, 5.0])[:, None]
    given = replace(batch.inputs, sheet_memory=torch.from_numpy(q.reshape(count, -1)))
    _, _, v, carried = batch.march(0, 1, given, whole=True)
    after = {}

    def law(stage, side):
        def resisted(whole):
            stress, after[side] = fabric_twin(one.terms, whole, q[:, :, side], dt, stage=stage)
            return stress

        return resisted

    force = internal_forces(one.sheet, one.positions, law("membrane", 0), law("plate", 1))
    expected = one.velocities + dt * force / one.masses[:, None]
    np.testing.assert_allclose(v.numpy(), expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_allclose(carried.sheet_memory.numpy().reshape(q.shape), np.stack([after[0], after[1]], 2), rtol=0, atol=1e-11)


def test_a_crease_stays():
    # a strip is bent by a quarter of a turn and its far end let go: one that yields comes to rest bent, one that does not straight
    points = np.stack(np.meshgrid(np.arange(13) * 0.01, np.arange(4) * 0.01, indexing="ij"), -1).reshape(-1, 2)
    corner = (4 * np.arange(12)[:, None] + np.arange(3)).ravel()
    triangles = np.concatenate([corner[:, None] + [0, 4, 5], corner[:, None] + [0, 5, 1]])
    flat = np.column_stack([points, np.zeros(len(points))])
    sheet, left = Sheet.of(flat, triangles), np.arange(8)
    angle = np.pi / 2 * np.maximum(points[:, 0] - 0.01, 0) / 0.11
    radius = 0.11 / (np.pi / 2)
    bent = np.column_stack([np.minimum(points[:, 0], 0.01) + radius * np.sin(angle), points[:, 1], radius * (1 - np.cos(angle))])
    crease = SheetYielding({"sheet_yielding_rate": 100.0, "sheet_yield_strain": 0.005, "sheet_yield_surface": 1e-3})
    tips, kept = [], []
    for terms in (ALONE, [*ALONE, crease]):
        known = dict(
            springs=np.zeros((0, 2), int), stiffness=[], grips=left, sheet=sheet, terms=[*terms, LinearDrag({"drag_damping": 20.0})]
        )
        one = System(positions=bent, masses=sheet.masses(0.2, len(flat)), controllers=np.repeat(flat[None, left], 31, 0), **known)
        _, x, _, carried = Batch([one], fps=30, double=True).march(0, 30, whole=True)
        tips.append(x[-4:, 2].mean().item())
        kept.append(carried.sheet_memory.numpy())
    assert abs(tips[0]) < 0.004 and tips[1] > 0.02  # m, of 0.07 before it was let go
    assert not kept[0].any()
    bends = kept[1].reshape(len(triangles), 2, 3)[:, 1]
    assert 3.0 < np.median(np.abs(bends).max(1)) < 1 / radius  # 1/m: part of the bend that it was let go with


@pytest.mark.parametrize("kind", [SheetRelaxing, SheetFriction])
def test_springs_of_no_size_leave_a_tension_as_it_is(kind):
    # a rest shape that pulls by itself is resisted once, however many springs stand beside the elasticity
    pulled = [*ALONE, SheetTension({"tension_first": 1.0, "tension_shear": 0.3})]
    ends = []
    for terms in (pulled, [*pulled, kind({})]):
        _, x, _ = Batch([replace(fabric(), terms=terms)], fps=30, substeps=100, double=True).march(0, 1)
        ends.append(x)
    torch.testing.assert_close(ends[1], ends[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("first", [SheetCreep, SheetYielding])
@pytest.mark.parametrize("second", [SheetRelaxing, SheetFriction])
def test_what_flows_beside_springs_comes_to_rest(first, second):
    # parts that are passive each, side by side: no strain keeps growing, and stress of a held strain only fades
    stress, q = history([ALONE[0], first(TYPICAL[first]), second(TYPICAL[second])], [np.array([0.03, -0.01, 0.0])] * 4000, 0.01)
    late = np.abs(stress[2000:]).max(1)
    assert (np.diff(late) <= 1e-12).all() and np.abs(q).max() <= 0.03 + 1e-12


def test_a_march_goes_on_as_if_there_had_been_no_break():
    batch = Batch([fabric(*KINDS, seed=s) for s in (0, 1)], fps=300, substeps=10, double=True)
    whole = batch.march(0, 3)[0]
    out, x, v, carried = batch.march(0, 1, whole=True)
    rest = batch.march(1, 2, replace(batch.inputs, x=x, v=v, **vars(carried)))[0]
    assert torch.equal(torch.cat([out, rest]), whole)


@pytest.mark.parametrize("double", [True, False])
def test_a_lone_thread_computes_what_a_team_does(double):
    alone, team = (Batch([fabric(*KINDS)], fps=30, substeps=100, double=double) for _ in range(2))
    team.kernels = build(team.laws, double, False, 1, 1, False)
    (x, v, c), (y, u, d) = (batch.march(0, 1, whole=True)[1:] for batch in (alone, team))
    close = 1e-12 if double else 1e-4  # rounding, over a hundred substeps
    assert float((x - y).abs().max()) < close and float((v - u).abs().max()) < 100 * close
    torch.testing.assert_close(c.sheet_memory, d.sheet_memory, rtol=1e-6 if double else 2e-2, atol=close)


def test_gradients_against_differences():
    batch, random = Batch([fabric(*KINDS, seed=s) for s in (0, 1)], fps=300, substeps=30, double=True), np.random.default_rng(6)
    weight = torch.from_numpy(random.normal(size=(2, batch.node_count, 3)))
    recall = torch.from_numpy(random.normal(size=tuple(batch.inputs.sheet_memory.shape)))

    def loss(inputs):
        out, _, _, carried = batch.march(0, 2, inputs, whole=True)
        return (out * weight).sum() + 0.1 * (carried.sheet_memory * recall).sum()

    names = ("x", "v", "mass", "path", "table", "sheet_memory")
    start = replace(batch.inputs, sheet_memory=0.01 * recall)
    given = replace(start, **{n: getattr(start, n).clone().requires_grad_() for n in names})
    loss(given).backward()
    for name in names:
        own = getattr(start, name)
        for _ in range(2):
            way = torch.from_numpy(random.normal(size=tuple(own.shape))) * (own.abs() if name in ("table", "mass") else 1e-3)
            step = 1e-6  # between the kinks of friction and yielding, and the rounding of what counts little
            ahead, behind = (float(loss(replace(start, **{name: own + s * step * way}))) for s in (1, -1))
            assert float((getattr(given, name).grad * way).sum()) == pytest.approx((ahead - behind) / (2 * step), rel=1e-4), name


@pytest.mark.parametrize("room", [1, 7])
def test_checkpointed_gradients_equal_the_whole_history_bit_for_bit(room, monkeypatch):
    # states are recomputed by the same arithmetic from the same start; 20 = 2 * 7 + 6. A path's gradient may be given in two parts
    found = []
    for bytes_ in (engine.HISTORY_BYTES, 0):
        batch = Batch([fabric(*KINDS)], fps=180, substeps=10, double=True)
        monkeypatch.setattr(engine, "HISTORY_BYTES", bytes_ or room * batch.substep_bytes)
        assert bool(bytes_) == (len(batch.stretches(2, history=True)) == 1)
        given = replace(batch.inputs, **{f.name: getattr(batch.inputs, f.name).clone().requires_grad_() for f in fields(Inputs)})
        out, _, _, carried = batch.march(0, 2, given, whole=True)
        ((out**2).sum() + (carried.sheet_memory**2).sum()).backward()
        found.append({n: getattr(given, n).grad for n in ("x", "v", "mass", "table", "sheet_memory")})
    for name, whole in found[0].items():
        assert whole.abs().max() > 0 and torch.equal(whole, found[1][name]), name


@pytest.mark.parametrize("double", [True, False])
def test_gradients_are_finite_at_rest(double):
    # where there is no strain and no motion, sizes have no derivative of their own
    flat = draped()
    flat = replace(flat, positions=np.column_stack([flat.positions[:, :2], np.zeros(len(flat.positions))]), velocities=None)
    flat = replace(flat, sheet=Sheet.of(flat.positions, flat.sheet.triangles), controllers=flat.positions[None, :4], grips=np.arange(4))
    one = replace(flat, terms=[*ALONE, *(k(TYPICAL[k]) for k in KINDS)])
    batch = Batch([one], fps=180, substeps=10, double=double)
    given = replace(batch.inputs, **{n: getattr(batch.inputs, n).clone().requires_grad_() for n in ("x", "v", "table", "sheet_memory")})
    (batch.march(0, 1, given)[0] ** 2).sum().backward()
    for name in ("x", "v", "table", "sheet_memory"):
        assert torch.isfinite(getattr(given, name).grad).all(), name


def test_springs_beside_a_sheet_shorten_its_steps():
    # a branch of a times the stiffness makes the sheet 1 + a times as stiff at once: steps are shorter by the root of it, to the 2 % to
    # which a largest eigenvalue is found; a flow does not stiffen
    plain = stable_step(fabric())
    assert stable_step(fabric(SheetRelaxing)) == pytest.approx(plain / np.sqrt(2.5), rel=0.03)
    assert stable_step(fabric(SheetFriction)) == pytest.approx(plain / np.sqrt(3.0), rel=0.03)
    assert stable_step(fabric(SheetCreep)) == pytest.approx(plain, rel=0.03)


# ---------------------------------------------------------------- ropes

LENGTH, RIGID, DENSITY = 0.5, 0.025, 0.1  # m, N m^2, kg/m


def cantilever(*terms, count=11, **values):
    """A rope along x that is clamped ``LENGTH`` before its tip, hangs little under its weight, and is all but critically damped."""
    x = np.column_stack([np.arange(count) * LENGTH / (count - 1.5), np.zeros((count, 2))])
    g = 8 * RIGID * 1e-3 / (DENSITY * LENGTH**3)  # its tip sinks by a thousandth of its length
    first = 1.8751040687**2 * np.sqrt(RIGID / DENSITY) / LENGTH**2  # rad/s, of its first mode
    given = [Bending({"bending_stiffness": RIGID}), BendingDamping({"bending_damping": 1e-4}), Gravity({"gravity_z": -g})]
    return System(
        positions=x,
        masses=np.full(count, DENSITY * x[1, 0]),
        springs=np.stack([np.arange(count - 1), np.arange(1, count)], 1),
        stiffness=np.full(count - 1, 500.0),
        controllers=np.repeat(x[None, :2], 2, 0),
        grips=[0, 1],
        hinges=rope_hinges(np.arange(count)),
        chains=[np.arange(count)],
        terms=[*given, LinearDrag({"drag_damping": 2 * first}), AIR[0](), *terms],
    ).with_values(**values)


def sinking(*terms, seconds=2.0, frames=20):
    """((frames,) s, how far the tip has sunk over that of the rope that only bends) of a cantilever that is let go level."""
    ends = []
    for given in ((), terms):
        one = cantilever(*given)
        batch = Batch([one], fps=frames / seconds, substeps=int(2000 * seconds / frames), double=True)
        ends.append(-batch.march(0, frames)[0][:, len(one.positions) - 1, 2].numpy())
    return np.arange(1, frames + 1) * seconds / frames, ends[1] / ends[0][-1]


def test_a_rope_that_creeps_sinks_on():
    # Maxwell's fluid under a steady moment: k = M / B (1 + r t), and so the tip sinks. Drag takes 2 w r z of g, a fiftieth of its pace
    t, sunk = sinking(RopeCreep({"rope_creep_rate": 0.05}), seconds=20.0)
    late = t > 2.0
    slope, start = np.polyfit(t[late], sunk[late], 1)
    assert slope == pytest.approx(0.05, rel=0.04) and start == pytest.approx(1.0, abs=0.05)


def test_a_rope_beside_springs_that_fade_sinks_late():
    # Zener's solid: 1 - a / (1 + a) exp(-t / (tau (1 + a))); it follows by the time of its own first mode, 2 / w = 0.3 s, later
    t, sunk = sinking(RopeRelaxing({"rope_branch_share": 1.0, "rope_branch_time": 4.0}), seconds=20.0)
    late = t > 2.0
    np.testing.assert_allclose(sunk[late], 1 - 0.5 * np.exp(-t[late] / 8), atol=0.03)


def test_a_rope_that_rubs_hangs_where_friction_holds_it():
    # friction of a strain that its bends never reach is springs of a / e_h beside it: the tip sinks by 1 / (1 + a / e_h)
    _, sunk = sinking(RopeFriction({"rope_rub": 0.1, "rope_rub_strain": 0.1, "rope_rub_surface": 1e-4}))
    assert sunk[-1] == pytest.approx(0.5, rel=0.01)
    _, sunk = sinking(RopeFriction({"rope_rub": 1e-8, "rope_rub_strain": 5e-4, "rope_rub_surface": 5e-3}))
    assert sunk[-1] == pytest.approx(1.0, rel=0.01)


def test_springs_beside_a_rope_shorten_its_steps():
    # of bending alone: a branch of 3 makes it four times as stiff at once, so that steps are half as long; friction of a / e_h alike
    one = cantilever()
    one = replace(one, stiffness=np.full(len(one.springs), 1e-9), terms=[Bending({"bending_stiffness": RIGID})])
    plain = stable_step(one)
    for beside in (RopeRelaxing({"rope_branch_share": 3.0}), RopeFriction({"rope_rub": 0.03, "rope_rub_strain": 0.01})):
        assert stable_step(replace(one, terms=[*one.terms, beside])) == pytest.approx(plain / 2, rel=1e-6)
    assert stable_step(replace(one, terms=[*one.terms, RopeCreep({"rope_creep_rate": 2.0})])) == pytest.approx(plain, rel=1e-9)


def test_a_ropes_size_is_that_of_its_bend():
    assert size_twin([3.0, 4.0, 0.0], ROPE, 0.01) == pytest.approx(0.05, rel=1e-12)


def crooked(seed=0):
    """A thrown body with a rope in it that twists and remembers in all ways."""
    one = make((*AIR, Bending, Torsion, *OF_ROPES), seed=seed)
    values = {name: value for own in OF_ROPES.values() for name, value in own.items()}
    return one.with_values(bending_stiffness=2e-3, torsion_stiffness=1e-3, **values)


def test_a_rope_marches_on_as_if_there_had_been_no_break():
    batch = Batch([crooked(s) for s in (8, 16)], fps=300, substeps=10, double=True)
    whole = batch.march(0, 3)[0]
    out, x, v, carried = batch.march(0, 1, whole=True)
    assert np.abs(carried.hinge_memory.numpy()).max() > 0
    rest = batch.march(1, 2, replace(batch.inputs, x=x, v=v, **vars(carried)))[0]
    assert torch.equal(torch.cat([out, rest]), whole)


def test_gradients_of_ropes_against_differences():
    batch, random = Batch([crooked(s) for s in (8, 16)], fps=300, substeps=30, double=True), np.random.default_rng(6)
    weight = torch.from_numpy(random.normal(size=(2, batch.node_count, 3)))
    recall = torch.from_numpy(random.normal(size=tuple(batch.inputs.hinge_memory.shape)))

    def loss(inputs):
        out, _, _, carried = batch.march(0, 2, inputs, whole=True)
        return (out * weight).sum() + 1e-3 * (carried.hinge_memory * recall).sum()

    names = ("x", "v", "mass", "path", "table", "natural", "flexure", "hinge_memory")
    start = replace(batch.inputs, hinge_memory=0.3 * recall)
    given = replace(start, **{n: getattr(start, n).clone().requires_grad_() for n in names})
    loss(given).backward()
    for name in names:
        own = getattr(start, name)
        for _ in range(2):
            scale = own.abs() if name in ("table", "mass", "flexure") else 1e-3 if name != "hinge_memory" else 1.0
            way = torch.from_numpy(random.normal(size=tuple(own.shape))) * scale
            step = 1e-6
            ahead, behind = (float(loss(replace(start, **{name: own + s * step * way}))) for s in (1, -1))
            assert float((getattr(given, name).grad * way).sum()) == pytest.approx((ahead - behind) / (2 * step), rel=1e-4), name


def test_what_remembers_needs_an_elasticity():
    with pytest.raises(ValueError, match="sheet_creep remembers what an elasticity bears and needs a term that has one, such as membrane"):
        replace(fabric(), terms=[SheetCreep()])
    with pytest.raises(ValueError, match="rope_friction remembers what an elasticity bears and needs a term that has one, such as bending"):
        replace(cantilever(), terms=[RopeFriction()])
