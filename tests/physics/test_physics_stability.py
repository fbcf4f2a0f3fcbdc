"""How long a substep may be: the bound against the true limit, from eigenvalues and from simulations that do or do not blow up.

Linearised at rest, v <- v - dt M^-1 (K x + C v), x <- x + dt v. A mode u (u* M u = 1) has z^2 - (2 - k dt^2 - c dt) z + (1 - c dt) = 0 with
k = u* K u and c = u* C u, which is stable where k dt^2 + 2 c dt < 4. Gershgorin's largest row sum of Y / (L0 m) bounds k, and c alike.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.physics.batch import Batch
from twinbench.physics.hinges import natural_curvature
from twinbench.physics.stability import stable_step, stable_substeps
from twinbench.physics.system import System
from twinbench.physics.terms import Bending, BendingDamping, ControllerSprings, Dashpot, Gravity, Ground, LinearDrag, Springs, Torsion
from twinbench.physics.topology import rope_hinges

NEUTRAL = dict(drag_damping=0.0, gravity_z=0.0, ground_offset=-10.0)
TINY = 1e-9  # m: small enough for a thousandfold growth to stay linear, large enough for rounding (1e-16 m) to be nothing


def body(positions, springs, stiffness, *, dashpot=0.0, controllers=None, **arrays):
    """A system without weight, drag or ground."""
    terms = [Springs(), Dashpot({"dashpot_damping": dashpot}), Gravity(), LinearDrag(), Ground(), ControllerSprings()]
    hands = np.zeros((1, 0, 3)) if controllers is None else np.asarray(controllers, float)[None]
    given = dict(positions=positions, springs=np.reshape(springs, (-1, 2)), stiffness=stiffness, controllers=hands)
    return System(**given, terms=terms, **arrays).with_values(**NEUTRAL)


def moved(system, offsets):
    """The same system, its particles off their places but its rest lengths as they were."""
    return replace(system, positions=system.positions + offsets)


def growth(system, dt, steps, *, seed=0):
    """How many times larger than a tiny random displacement from rest the displacements become within ``steps`` steps of ``dt``.

    A coordinate of all particles against the length of the displacement; infinite where the simulation ends in numbers that are none.
    """
    offsets = np.random.default_rng(seed).normal(size=system.positions.shape)
    offsets[system.grips[system.grips >= 0]] = 0
    offsets *= TINY / np.linalg.norm(offsets)
    batch = Batch([moved(system, offsets)], fps=1 / dt, substeps=1, dt=dt, double=True, workers=1)
    x = batch.rollout(steps + 1).positions[0].numpy()
    return np.nan_to_num(np.abs(x - system.positions), nan=np.inf).max() / TINY


def matrices(system):
    """(K, C, M) of the free particles at rest, dense: sums of Y / L0 and c times d d' over springs."""
    nodes = np.concatenate([system.positions, system.controllers[0]])
    K, C = np.zeros((2, 3 * len(nodes), 3 * len(nodes)))
    for (a, b), rest, stiffness in zip(system.springs, system.rest, system.stiffness, strict=True):
        d = np.zeros(3 * len(nodes))
        d[3 * a : 3 * a + 3] = (nodes[a] - nodes[b]) / np.linalg.norm(nodes[a] - nodes[b])
        d[3 * b : 3 * b + 3] = -d[3 * a : 3 * a + 3]
        K += stiffness / rest * np.outer(d, d)
        C += system.values["dashpot_damping"] * np.outer(d, d)
    free = np.setdiff1d(np.arange(system.particle_count), system.grips)
    index = (3 * free[:, None] + np.arange(3)).ravel()
    return K[np.ix_(index, index)], C[np.ix_(index, index)], np.repeat(system.masses[free], 3)


def true_limit(system):
    """The longest stable step by bisection of the iteration's spectral radius."""
    K, C, m = matrices(system)
    eye = np.eye(len(m))

    def radius(dt):
        push = np.hstack([-dt * K / m[:, None], eye - dt * C / m[:, None]])
        step = np.vstack([np.hstack([eye, 0 * eye]) + dt * push, push])
        return np.abs(np.linalg.eigvals(step)).max()

    low, high = 0.0, 1.0
    while radius(high) < 1 + 1e-5:  # uniform motion is a double eigenvalue 1, which rounding splits by sqrt(1e-16)
        high *= 2
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if radius(middle) < 1 + 1e-5 else (low, middle)
    return low


def net(seed, dashpot, *, count=8):
    """A random body with random masses and stiffness, one particle gripped and two pulled by a still hand."""
    rng = np.random.default_rng(seed)
    x = rng.random((count, 3))
    first, second = np.nonzero(np.triu(np.linalg.norm(x[:, None] - x[None], axis=2) < 0.7, 1))
    springs = np.concatenate([np.stack([first, second], 1), [[0, 1], [count + 1, 2], [count + 1, 3]]])
    stiffness = 10 ** rng.uniform(0, 3, len(springs))
    arrays = dict(masses=10 ** rng.uniform(-1, 1, count), grips=[0, -1])
    return body(x, springs, stiffness, dashpot=dashpot, controllers=[x[0], [0.5, 0.5, 1.5]], **arrays)


# ---------------------------------------------------------------- one spring


MASS, STIFFNESS, REST = 0.4, 30.0, 0.5
K = STIFFNESS / REST / MASS  # 1/s^2


def hanging(dashpot=0.0, stiffness=STIFFNESS):
    """A free particle on a fixed one."""
    return body([[REST, 0, 0]], [[1, 0]], [stiffness], dashpot=dashpot, controllers=[[0, 0, 0]], masses=[MASS])


def held(dashpot=0.0):
    """The same, the fixed one being a gripped particle."""
    at = dict(controllers=[[0, 0, 0]], grips=[1], masses=[MASS, 1e-3])
    return body([[REST, 0, 0], [0, 0, 0]], [[1, 0]], [STIFFNESS], dashpot=dashpot, **at)


@pytest.mark.parametrize("fixed", [hanging, held])
@pytest.mark.parametrize("dashpot", [0.0, 1.0, 20.0])
def test_limit_of_a_spring_to_a_fixed_end(fixed, dashpot):
    # k = Y / (L0 m), c = dashpot / m: k dt^2 + 2 c dt = 4; undamped dt = 2 / w. One row, so Gershgorin's bound is the limit
    c = dashpot / MASS
    limit = (math.sqrt(c * c + 4 * K) - c) / K
    system = fixed(dashpot)
    assert true_limit(system) == pytest.approx(limit, rel=1e-4)
    assert stable_step(system) == pytest.approx(limit, rel=1e-12)
    if dashpot == 0:
        assert limit == pytest.approx(2 / math.sqrt(K))
    assert growth(system, 0.99 * limit, 2000) < 10  # undamped the swing is A / sqrt(1 - 0.99^2) = 7.1 A
    assert growth(system, 1.01 * limit, 1000) > 1e3  # |z| is 1.02 with much damping and 1.15 without: 1.02^1000 = 4e8


@pytest.mark.parametrize("dashpot", [0.0, 1.0, 20.0])
def test_the_bound_is_the_limit_of_two_equal_free_particles(dashpot):
    # against each other: k = 2 Y / (L0 m), c = 2 dashpot / m, which is what Gershgorin gives
    system = body([[0, 0, 0], [REST, 0, 0]], [[0, 1]], [STIFFNESS], dashpot=dashpot, masses=[MASS, MASS])
    k, c = 2 * K, 2 * dashpot / MASS
    limit = (math.sqrt(c * c + 4 * k) - c) / k
    assert stable_step(system) == pytest.approx(limit, rel=1e-12)
    assert growth(system, 0.99 * limit, 2000) < 10
    assert growth(system, 1.01 * limit, 1000) > 1e3


def test_a_dashpot_alone():
    # k = 0: z = 1 - c dt, stable below dt = 2 / c
    system, limit = hanging(20.0, stiffness=0.0), 2 / (20.0 / MASS)
    assert stable_step(system) == pytest.approx(limit, rel=1e-12)
    pushed = replace(system, velocities=[[TINY, 0, 0]])
    for share, low, high in ((0.99, 0.0, 1e-4), (1.01, 1e3, np.inf)):
        dt = share * limit
        _, _, v = Batch([pushed], fps=1 / dt, substeps=1, dt=dt, double=True, workers=1).march(0, 500)
        assert low < abs(v[0, 0].item()) / TINY < high  # (1 - c dt)^500: 0.98^500 = 4e-5, 1.02^500 = 2e4


def test_stretch_does_not_stiffen():
    # the force is linear in length, and across the spring tension / length is below Y / L0: hung at three times its rest length by
    # Y (l / L0 - 1) = m g, the limit is still 2 / w
    stiffness, stretch = 3.0, 3.0
    system = body([[stretch * REST, 0, 0]], [[1, 0]], [stiffness], controllers=[[0, 0, 0]], masses=[MASS], rest=[REST])
    system = system.with_values(gravity_x=stiffness * (stretch - 1) / MASS)
    limit = 2 / math.sqrt(stiffness / REST / MASS)
    assert growth(system, 0.99 * limit, 2000) < 10
    assert growth(system, 1.01 * limit, 1000) > 1e3


# ---------------------------------------------------------------- random bodies


@given(seed=st.integers(0, 10**6), dashpot=st.one_of(st.just(0.0), st.floats(1e-3, 200)), count=st.integers(4, 10))
@settings(deadline=None, max_examples=60)
def test_the_bound_never_overestimates(seed, dashpot, count):
    system = net(seed, dashpot, count=count)
    limit = true_limit(system)
    assert stable_step(system) < limit * (1 + 1e-4)
    if dashpot == 0:  # nor is it useless: the largest eigenvalue is at least a third of the trace of any particle's block
        assert stable_step(system) >= limit / math.sqrt(6)


@pytest.mark.parametrize("dashpot", [0.0, 0.5, 30.0])
@pytest.mark.parametrize("seed", range(3))
def test_simulations_below_the_bound_stay_bounded_and_beyond_the_limit_blow_up(seed, dashpot):
    system = net(seed, dashpot)
    # no mode swings wider than 1 / sqrt(1 - 0.99^2) = 7.1 times its start; masses from 0.1 to 10 kg mix modes by at most sqrt(10 / 0.1)
    assert growth(system, 0.99 * stable_step(system), 3000) < 71
    assert growth(system, 1.02 * true_limit(system), 600) > 1e3


@pytest.mark.parametrize("drag", [1.0, 20.0])
def test_drag_only_helps(drag):
    # q = exp(-drag dt) on the new velocity: stable where k dt^2 + 2 c dt < 2 + 2 / q, which is more than 4
    system = hanging().with_values(drag_damping=drag)
    assert stable_step(system) == stable_step(hanging())
    assert growth(system, 2 / math.sqrt(K), 1000) < 2


# ---------------------------------------------------------------- substeps


def test_bodies_that_cannot_be_unstable():
    alone = body(np.zeros((3, 3)), [], [])
    gripped = body([[0, 0, 0], [1, 0, 0]], [[0, 1]], [1e9], controllers=[[0, 0, 0], [1, 0, 0]], grips=[0, 1])
    slack = body([[0, 0, 0], [1, 0, 0]], [[0, 1]], [0.0])
    for system in (alone, gripped, slack):
        assert stable_step(system) == math.inf
        assert stable_substeps([system], 1 / 30) == 10
        assert stable_substeps([system], 1 / 30, least=3) == 3


@given(seed=st.integers(0, 1000), frame=st.floats(1e-3, 1.0), safety=st.floats(0.1, 1.0), least=st.integers(1, 20))
@settings(deadline=None, max_examples=100)
def test_substeps_are_the_fewest_that_are_safe(seed, frame, safety, least):
    system = net(seed, dashpot=seed / 10)
    count, longest = stable_substeps([system], frame, safety=safety, least=least), safety * stable_step(system)
    assert count >= least
    assert frame / count <= longest * (1 + 1e-12)
    assert count == least or frame / (count - 1) > longest * (1 - 1e-12)


def test_substeps_serve_the_stiffest_of_several_systems():
    soft, stiff = hanging(stiffness=1.0), hanging(stiffness=1e6)
    assert stable_substeps([soft, stiff], 1 / 30) == stable_substeps([stiff], 1 / 30) > stable_substeps([soft], 1 / 30)


def test_a_batch_chooses_substeps_for_each_of_its_systems():
    systems = [hanging(stiffness=y) for y in (1.0, 1e6, 1e8)]
    batch = Batch(systems, fps=30, substeps="auto", double=True, workers=1)
    assert batch.substeps.tolist() == [stable_substeps([s], 1 / 30) for s in systems]
    assert batch.substeps[0] == 10 and (np.diff(batch.substeps) > 0).all()
    np.testing.assert_allclose(batch.dt * batch.substeps, 1 / 30, rtol=1e-15)
    assert (batch.rollout(30).diverged == -1).all()
    assert Batch(systems, fps=30, double=True).substeps.tolist() == batch.substeps.tolist()  # the default


def test_automatic_substeps_keep_a_thrown_body_bounded():
    # far from rest: thrown particles, swinging hand; half the bound is the default
    system = net(0, 1.0)
    rng = np.random.default_rng(0)
    kicked = moved(system, rng.normal(size=system.positions.shape) * 0.2 * (np.arange(8) > 0)[:, None])
    x = Batch([kicked], fps=30, substeps="auto", double=True, workers=1).rollout(60).positions[0].numpy()
    assert np.abs(x).max() < 5


def test_nearly_slack_springs_with_dashpots():
    # k -> 0 tends to the dashpot alone, dt = 2 / c, without cancellation
    for stiffness in (1e-6, 1e-9, 1e-12):
        assert stable_step(hanging(20.0, stiffness)) == pytest.approx(2 * MASS / 20.0, rel=1e-6)


# ---------------------------------------------------------------- hinges


def held_rope(seed, damping, *, count=8, wavy=0.0):
    """A rope whose first segment is held, in its natural shape; springs so weak that bending decides."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.uniform(0.02, 0.08, (count, 1)), 0) * [1.0, 0, 0]
    points[:, 1:] += wavy * rng.normal(size=(count, 2)) * 0.02
    chain = np.arange(count)
    terms = [
        Springs(),
        Bending({"bending_stiffness": 0.01}),
        BendingDamping({"bending_damping": damping}),
        Torsion({"torsion_stiffness": 0.01}),
    ]
    return System(
        positions=points,
        springs=np.stack([chain[:-1], chain[1:]], 1),
        stiffness=np.full(count - 1, 1.0),
        masses=10 ** rng.uniform(-2.5, -1.5, count),
        controllers=points[None, :2],
        grips=[0, 1],
        hinges=rope_hinges(chain),
        natural=natural_curvature(points, rope_hinges(chain), [chain]),
        flexure=10 ** rng.uniform(-0.5, 0.5, count - 2),
        chains=[chain],
        terms=terms,
    )


def bending_limit(system):
    """The longest stable step of a straight rope across its length: kappa_i = (w_c - w_b) / l_bc - (w_b - w_a) / l_ab, by its matrices."""
    count, x = len(system.positions), system.positions[:, 0]
    g = np.zeros((count - 2, count))
    for h, (a, b, c) in enumerate(system.hinges):
        before, after = 1 / (x[b] - x[a]), 1 / (x[c] - x[b])
        g[h, [a, b, c]] = before, -before - after, after
    S = (g.T * (system.flexure / system.span)) @ g
    K, C = ((S * system.values[name])[2:, 2:] for name in ("bending_stiffness", "bending_damping"))
    M = np.diag(1 / np.sqrt(system.masses[2:]))
    # both are one matrix times a number: in its modes k dt^2 + 2 c dt = 4
    k, c = (np.linalg.eigvalsh(M @ A @ M).max() for A in (K, C))
    return 4 / (c + math.sqrt(c * c + 4 * k))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("damping", [0.0, 1e-5, 1e-3])
def test_the_bound_of_a_straight_rope_is_below_its_limit(seed, damping):
    # Gershgorin: never above, and not far below, as its rows are those of an alternating mode; a row of a heavy node between light ones is
    # never met with by all of them, which costs up to the root of their ratio in mass, 10
    system = held_rope(seed, damping)
    assert 0.3 * bending_limit(system) < stable_step(system) <= bending_limit(system)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("damping", [0.0, 1e-5])
def test_bent_ropes_below_the_bound_stay_bounded(seed, damping):
    # in a natural shape with angles of about 0.5 rad, twist included. A millionth of a metre's hundredth stays what it is
    system = held_rope(seed, damping, wavy=1.0)
    assert growth(system, 0.95 * stable_step(system), 3000) < 100


def test_a_straight_rope_beyond_its_limit_blows_up():
    system = held_rope(0, 1e-5)
    assert growth(system, 1.05 * bending_limit(system), 1000) > 1e3
    assert growth(system, 0.95 * bending_limit(system), 1000) < 100
