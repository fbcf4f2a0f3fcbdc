"""What a rope is by nature: its curvature in modes along it, and the springs that hold its bends."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from twinbench.physics.batch import Batch
from twinbench.physics.hinges import natural_curvature
from twinbench.physics.system import System
from twinbench.physics.terms import Dashpot, LinearDrag, Springs
from twinbench.physics.terms.bending import Bending
from twinbench.physics.terms.bending_damping import BendingDamping
from twinbench.physics.terms.braces import Braces
from twinbench.physics.terms.natural_curvature import NaturalCurvature
from twinbench.physics.terms.torsion import Torsion
from twinbench.physics.topology import rope_hinges

LINK = 0.1  # m
TERMS = (Springs(), Dashpot({"dashpot_damping": 1.0}), LinearDrag({"drag_damping": 4.0}))


def rope(positions, *, natural=None, chains=None, springs=None, terms=TERMS):
    """Links of 1 kN between nodes of 10 g, bending about ``natural`` with B = 0.05 N m^2, no gravity, nobody holds it."""
    count = len(positions)
    chains = chains or (np.arange(count),)
    links = np.concatenate([np.stack([c[:-1], c[1:]], 1) for c in chains]) if springs is None else springs
    return System(
        positions=positions,
        springs=links,
        stiffness=np.full(len(links), 1e3),
        masses=np.full(count, 0.01),
        controllers=np.zeros((2, 0, 3)),
        hinges=np.concatenate([rope_hinges(c) for c in chains]),
        chains=chains,
        natural=natural,
        terms=terms,
    )


def bending(**shape):
    stiff = (Bending({"bending_stiffness": 0.05}), BendingDamping({"bending_damping": 5e-4}), Torsion({"torsion_stiffness": 0.05}))
    return (*TERMS, *stiff, NaturalCurvature(shape))


def straight(count=9):
    return np.stack([LINK * np.arange(count), np.zeros(count), np.zeros(count)], 1)


def arc(count, angle, normal):
    """(count, 3) m: links of ``LINK`` that turn by ``angle`` from one to the next, all about ``normal``."""
    a = np.asarray(normal, float) / np.linalg.norm(normal)
    first = np.cross(a, [0.3, 0.5, 0.8])
    first /= np.linalg.norm(first)
    turn = angle * np.arange(count - 1)[:, None]
    steps = np.cos(turn) * first + np.sin(turn) * np.cross(a, first)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(LINK * steps, axis=0)])


def test_a_straight_rope_curls_up_to_its_natural_curvature():
    # at rest every hinge has 2 tan(angle / 2) = a l; drag and dashpots leave less than 1e-3 of the motion after 3 s
    system = rope(straight() + 1e-4 * np.sin(np.arange(9))[:, None] * [0, 0, 1.0], terms=bending(natural_a0=4.0))
    end = Batch([system], fps=30, double=True).rollout(91).positions[0][-1].numpy()
    found = np.linalg.norm(natural_curvature(end, system.hinges, system.chains), axis=1)
    np.testing.assert_allclose(found, 4.0 * LINK, rtol=5e-3)


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 2, -0.5), (-1, 0.2, 0.3)])
def test_a_rope_in_its_natural_shape_rests_whichever_way_it_is_turned(normal):
    angle = 0.3
    shape = {"natural_a0": 2 * np.tan(angle / 2) / LINK}
    system = rope(arc(9, angle, normal), terms=bending(**shape))
    frames = Batch([system], fps=30, double=True).rollout(16).positions[0].numpy()
    assert np.abs(frames - frames[0]).max() < 1e-7


def test_modes_are_legendre_polynomials_of_the_arc():
    # the natural shape is that of the modes, rolled by one angle: amounts and products of neighbours do not change
    values = {"natural_a0": 1.0, "natural_a2": 0.7, "natural_b1": -0.4, "natural_b_last": 0.2}
    system = rope(arc(9, 0.2, (1, 1, 0)), terms=bending(**values))
    batch = Batch([system], fps=30, double=True)
    found = batch.prepare(batch.inputs).natural.numpy() @ [1, 1j]
    u = 2 * np.arange(1, 8) / 8 - 1  # of the hinges
    wanted = LINK * (1.0 + 0.7 * (3 * u**2 - 1) / 2 - 0.4j * u)
    wanted[-1] += 0.2j
    np.testing.assert_allclose(found / found[0], wanted / wanted[0], atol=1e-12)
    np.testing.assert_allclose(abs(found), abs(wanted), atol=1e-12)


def test_the_roll_is_the_one_with_the_least_distance_from_the_start():
    # against a search over 3600 rolls; the minimum is flat, so the nearest of them is within its grid
    rng = np.random.default_rng(3)
    start = arc(9, 0.2, (1, 1, 0)) + rng.normal(0, 0.01, (9, 3))
    values = {"natural_a0": 1.0, "natural_a1": 1.5, "natural_b1": -2.0}
    system = rope(start, terms=bending(**values))
    batch = Batch([system], fps=30, double=True)
    found = batch.prepare(batch.inputs).natural.numpy()
    kappa = natural_curvature(start, system.hinges, system.chains)
    weight = 1 / system.span
    angle = np.radians(np.arange(0, 360, 0.1))
    rolled = (found @ [1, 1j])[:, None] * np.exp(1j * angle)
    cost = (weight[:, None] * abs(rolled - (kappa @ [1, 1j])[:, None]) ** 2).sum(0)
    own = (weight * ((found - kappa) ** 2).sum(1)).sum()
    assert own <= cost.min() + 1e-12


def test_without_modes_the_given_natural_shape_stays():
    start = arc(9, 0.25, (0, 1, 1))
    hinges = rope_hinges(np.arange(9))
    given = natural_curvature(start, hinges, (np.arange(9),))
    for kept in (1.0, 0.3, 0.0):
        batch = Batch([rope(start, natural=given, terms=bending(natural_kept=kept))], fps=30, double=True)
        np.testing.assert_allclose(batch.prepare(batch.inputs).natural.numpy(), kept * given, atol=1e-12)


def test_systems_and_chains_do_not_disturb_each_other():
    start = arc(9, 0.2, (1, 1, 0))
    both = np.concatenate([start, arc(9, 0.3, (0, 1, 0)) + [0, 0, 1]])
    two = rope(both, chains=(np.arange(9), 9 + np.arange(9)), terms=bending(natural_a0=1.0, natural_b1=0.5))
    alone = rope(start, terms=bending(natural_a0=1.0, natural_b1=0.5))
    other = rope(start, terms=bending(natural_a0=-2.0, natural_b2=0.5))
    batch = Batch([other, two, alone], fps=30, double=True)
    found = batch.prepare(batch.inputs).natural.numpy()
    np.testing.assert_allclose(found[7:14], found[21:28], atol=1e-12)


@pytest.mark.parametrize("name", ["natural_a0", "natural_b1", "natural_a_first", "natural_kept"])
def test_gradients_are_those_of_finite_differences(name):
    start = arc(7, 0.2, (1, 1, 0))
    given = natural_curvature(start, rope_hinges(np.arange(7)), (np.arange(7),))
    terms = bending(natural_a0=1.0, natural_b1=0.5, natural_kept=0.4)
    batch = Batch([rope(start, natural=given, terms=terms)], fps=30, substeps=60, double=True)

    def loss(table):
        x = batch.march(0, 3, replace(batch.inputs, table=table))[1]
        return (x * torch.linspace(-1, 1, x.numel(), dtype=x.dtype).reshape(x.shape)).sum()

    table = batch.inputs.table.clone().requires_grad_()
    (slope,) = torch.autograd.grad(loss(table), table)
    k, step = batch.column(name), 1e-7  # in its plane the rope rests unstably, so that third derivatives are large
    up, down = batch.inputs.table.clone(), batch.inputs.table.clone()
    up[0, k] += step
    down[0, k] -= step
    assert slope[0, k].item() == pytest.approx((loss(up) - loss(down)).item() / (2 * step), rel=1e-5)  # error of order step^2


def test_braces_are_the_springs_that_skip_nodes_of_a_rope():
    springs = np.array([[0, 1], [1, 2], [2, 0], [2, 3], [1, 3], [4, 3], [4, 5]])  # 5 is no node of the rope
    positions = np.concatenate([arc(5, 0.4, (0, 0, 1)), [[1.0, 0, 0]]])
    system = rope(positions, chains=(np.arange(5),), springs=springs, terms=(*TERMS, Braces({"brace_share": 0.25})))
    batch = Batch([system], fps=30, substeps=4, double=True)
    found = batch.prepare(batch.inputs).stiffness.numpy() / 1e3
    assert found.tolist() == [1, 1, 0.25, 1, 0.25, 1, 1]


def test_a_body_without_chains_has_no_braces():
    system = replace(
        rope(straight(5)), chains=(), hinges=None, natural=None, span=None, flexure=None, terms=(*TERMS, Braces({"brace_share": 0.0}))
    )
    batch = Batch([system], fps=30, substeps=4, double=True)
    assert (batch.prepare(batch.inputs).stiffness.numpy() == 1e3).all()
