"""What sheets remember: relaxing, rubbing, creep and creases against closed forms; the engine against numpy; gradients."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from twinbench.benchmark.conformance.gradients import draped
from twinbench.physics import batch as engine
from twinbench.physics.batch import Batch, Inputs
from twinbench.physics.fabrics import fabric_twin, size_twin
from twinbench.physics.kernels import build
from twinbench.physics.sheets import Sheet, internal_forces
from twinbench.physics.stability import stable_step
from twinbench.physics.system import System
from twinbench.physics.terms import Membrane, PlateBending, SheetCreep, SheetFriction, SheetRelaxing, SheetYielding

STIFF = 40.0  # N/m
BEND = 1e-3  # N m
KINDS = (SheetCreep, SheetYielding, SheetRelaxing, SheetFriction)
TYPICAL = {
    SheetCreep: {"sheet_creep_rate": 2.0},
    SheetYielding: {"sheet_yielding_rate": 30.0, "sheet_yield_strain": 0.01, "sheet_yield_surface": 1e-3},
    SheetRelaxing: {"sheet_branch_share": 1.5, "sheet_branch_time": 0.05},
    SheetFriction: {"sheet_rub": 0.01, "sheet_rub_strain": 0.005, "sheet_rub_surface": 1e-3},
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
    # a strip is folded over a hand's edge and laid flat again. One that yields springs back less than one that does not
    points = np.stack(np.meshgrid(np.arange(13) * 0.01, np.arange(4) * 0.01, indexing="ij"), -1).reshape(-1, 2)
    corner = (4 * np.arange(12)[:, None] + np.arange(3)).ravel()
    triangles = np.concatenate([corner[:, None] + [0, 4, 5], corner[:, None] + [0, 5, 1]])
    flat = np.column_stack([points, np.zeros(len(points))])
    sheet = Sheet.of(flat, triangles)
    left = np.arange(8)
    tilt = np.concatenate([np.linspace(0, 1, 16), np.ones(10)])[:, None] * np.pi / 2
    right = len(points) - 4 + np.arange(4)
    path = np.repeat(flat[None, np.concatenate([left, right])], 26, 0)
    path[:, 8:, 0] = 0.01 + 0.11 * (1 + np.cos(tilt)) / 2
    path[:, 8:, 2] = 0.11 * np.sin(tilt) / 2
    kept = []
    for terms in (ALONE, [*ALONE, SheetYielding({"sheet_yielding_rate": 100.0, "sheet_yield_strain": 0.005, "sheet_yield_surface": 1e-3})]):
        known = dict(springs=np.zeros((0, 2), int), stiffness=[], grips=np.concatenate([left, right]), sheet=sheet, terms=terms)
        one = System(positions=flat, masses=sheet.masses(0.2, len(flat)), controllers=path, **known)
        *_, carried = Batch([one], fps=30, double=True).march(0, 25, whole=True)
        kept.append(carried.sheet_memory.numpy())
    assert not kept[0].any()
    bends = kept[1].reshape(len(triangles), 2, 3)[:, 1]
    assert np.abs(bends).max() > 5.0 and np.isfinite(bends).all()  # 1/m, of the 12 that a quarter of a turn over 13 cm makes on average


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
