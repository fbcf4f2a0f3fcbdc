"""Effects in the material of solids against closed forms, at a material point; the engine against the numpy twin; gradients, batches.

A point's stress is P(F); a bar under tension has the stretch l along its axis and t across, with no stress there.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation
from twinbench.physics.batch import Batch
from twinbench.physics.catalogue import terms
from twinbench.physics.cells import point_sites
from twinbench.physics.grids import embed
from twinbench.physics.materials import point_twin
from twinbench.physics.solids import internal_forces
from twinbench.physics.stability import stable_step
from twinbench.physics.system import System
from twinbench.physics.terms import (
    Fibres,
    Fung,
    Gravity,
    GrownShape,
    Inflation,
    KelvinVoigt,
    Maxwell,
    NeoHookean,
    StiffnessPatch,
    TensionCompression,
)

YOUNG, POISSON, DENSITY = 5e3, 0.3, 100.0
MU, LAME = NeoHookean.twin_moduli(YOUNG, POISSON)
HERE = np.zeros(3)
ALTERING = ("growth", "flow", "material", "branch")


def at_point(*extra, deformed, rate=None, q=None, dt=1e-3, home=HERE, at=HERE, poisson=POISSON):
    """(P (..., 3, 3) Pa, memory) of elasticity and ``extra`` terms."""
    known = [NeoHookean({"youngs_modulus": YOUNG, "poisson": poisson}), *extra]
    memories = sum(t.stage in ("flow", "branch") for t in extra)
    q = np.zeros((*np.shape(deformed)[:-2], memories, 3, 3)) if q is None else q
    return point_twin(known, deformed, np.zeros(3) if rate is None else rate, home, at, q, dt)


def tension(*extra, stretch, **options):
    """P_11 [Pa] of a bar that is free across, of the ``stretch`` along the first axis."""
    across = fsolve(lambda t: at_point(*extra, deformed=np.diag([stretch, t[0], t[0]]), **options)[0][1, 1] / YOUNG, 1.0, xtol=1e-12)[0]
    return at_point(*extra, deformed=np.diag([stretch, across, across]), **options)[0][0, 0]


# ---------------------------------------------------------------- without memory


def test_fungs_curve():
    # nu = 0: a stretched bar stays as wide as it is, E = (l^2 - 1) / 2, and the share's own part is P = a Y l E (exp(b E^2) - 1)
    stretch = np.array([0.8, 0.95, 1.0, 1.1, 1.3])
    deformed = stretch[:, None, None] * np.diag([1.0, 0, 0]) + np.diag([0, 1.0, 1.0])
    term = Fung({"fung_share": 2.0, "fung_exponent": 15.0})
    added = at_point(term, deformed=deformed, poisson=0.0)[0] - at_point(deformed=deformed, poisson=0.0)[0]
    e = (stretch**2 - 1) / 2
    np.testing.assert_allclose(added[:, 0, 0], 2 * YOUNG * stretch * e * (np.exp(15 * e**2) - 1), rtol=1e-9, atol=1e-9 * YOUNG)
    # at small strains it vanishes with their cube: Y a b e^3
    small = tension(Fung({"fung_share": 2.0, "fung_exponent": 15.0}), stretch=1.001) - tension(stretch=1.001)
    assert small == pytest.approx(YOUNG * 2 * 15 * 1e-9, rel=0.02)


def test_fungs_law_overflows_nowhere():
    assert np.isfinite(at_point(Fung({"fung_share": 1.0, "fung_exponent": 200.0}), deformed=np.diag([9.0, 1, 1]))[0]).all()


@pytest.mark.parametrize("compression", [0.0, 1.0])
def test_fibres_stiffen_along_their_axis_and_nothing_across(compression):
    # Y (1 + a) e along the fibres at small strains, and in compression Y (1 + c a) e; x = 0.04 in I_4 is 4 times the smooth part's width:
    # sqrt(x^2 + w^2) - w = 0.78 x there
    along = Fibres({"fibre_share": 3.0, "fibre_compression": compression})
    pulled = (tension(along, stretch=1.02) - tension(stretch=1.02)) / YOUNG / 0.02 / 3
    pushed = (tension(along, stretch=0.98) - tension(stretch=0.98)) / YOUNG / -0.02 / 3
    gap = 1 - (np.sqrt(0.04**2 + 0.01**2) - 0.01) / 0.04
    assert pulled == pytest.approx(1 - (1 - compression) / 2 * gap, rel=0.06)
    assert pushed == pytest.approx(compression + (1 - compression) / 2 * gap, rel=0.06, abs=1e-6)
    sheared = np.eye(3) + 0.2 * np.outer([0, 1.0, 0], [0, 0, 1.0])
    np.testing.assert_array_equal(at_point(along, deformed=sheared)[0], at_point(deformed=sheared)[0])


def test_fibres_lie_where_their_angles_say():
    turned = Fibres({"fibre_share": 3.0, "fibre_azimuth": 0.7, "fibre_elevation": 0.4, "fibre_compression": 1.0})
    n = np.array([np.cos(0.4) * np.cos(0.7), np.cos(0.4) * np.sin(0.7), np.sin(0.4)])
    added = at_point(turned, deformed=1.1 * np.eye(3))[0] - at_point(deformed=1.1 * np.eye(3))[0]
    np.testing.assert_allclose(added, 3 * YOUNG / 2 * 0.21 * 1.1 * np.outer(n, n), rtol=1e-9, atol=1e-9)


def test_tension_and_compression_part_beyond_small_strains():
    # nu = 0, E along: P = l (Y E +- (2 / 3) a Y E) for |E| >> w, as E^2 / r - E^4 / 3 r^3 tends to 2 |E| / 3
    term, width = TensionCompression({"tension_share": 0.6, "tension_width": 1e-3}), 1e-3
    for stretch in (0.9, 1.1):
        e = (stretch**2 - 1) / 2
        deformed = np.diag([stretch, 1, 1])
        added = (at_point(term, deformed=deformed, poisson=0.0)[0] - at_point(deformed=deformed, poisson=0.0)[0])[0, 0]
        assert added == pytest.approx(stretch * 0.6 * YOUNG * 2 / 3 * abs(e), rel=2 * (width / e) ** 2)
    # and below w they do not: a e^2 / w of Y
    small = (tension(term, stretch=1 + 1e-5) - tension(stretch=1 + 1e-5)) / (YOUNG * 1e-5)
    assert abs(small) < 2 * 0.6 * 1e-5 / width


@pytest.mark.parametrize("term", [Fung({"fung_share": 2.0}), TensionCompression({"tension_share": -0.7}), Inflation({"inflation": 2.0}),
                                  Fibres({"fibre_share": 3.0, "fibre_azimuth": 0.4})], ids=lambda t: t.name)  # fmt: skip
def test_what_has_no_memory_takes_no_work_around_a_loop(term):
    # hyperelastic: the integral of P : dF around a closed path is 0; the trapezium rule of a smooth periodic integrand is exact to rounding
    s = 2 * np.pi * np.arange(8000)[:, None, None] / 8000
    a, b = np.random.default_rng(0).normal(0, 0.1, (2, 3, 3))
    deformed, slope = np.eye(3) + a * np.cos(s) + b * np.sin(s), -a * np.sin(s) + b * np.cos(s)
    work = (at_point(term, deformed=deformed)[0] * slope).sum((1, 2))
    assert abs(work.mean()) < 1e-12 * np.abs(work).max()


def test_a_filling_presses_as_a_gas():
    # P = -p J F^-T, p = k (f / J - 1); a free body of bulk modulus K fills to J with lambda ln J + mu (J^(2/3) - 1) = k (f - J)
    deformed = np.diag([1.1, 0.9, 1.2])
    swell = np.prod([1.1, 0.9, 1.2])
    added = at_point(Inflation({"inflation": 2.0, "inflation_fill": 1.3}), deformed=deformed)[0] - at_point(deformed=deformed)[0]
    np.testing.assert_allclose(added, -2 * YOUNG * (1.3 / swell - 1) * swell * np.linalg.inv(deformed).T, atol=1e-9)


def test_a_patch_is_stiffer_by_its_share_and_fades():
    deformed, term = np.diag([1.1, 0.9, 1.2]), StiffnessPatch({"patch_share": 2.0, "patch_x": 0.1, "patch_radius": 0.05})
    plain = at_point(deformed=deformed)[0]
    for away, share in ((0.0, 3.0), (0.05, 1 + 2 * np.exp(-0.5)), (1.0, 1.0)):
        found = at_point(term, deformed=deformed, home=np.array([0.1, away, 0.0]))[0]
        np.testing.assert_allclose(found, share * plain, rtol=1e-12, atol=1e-9)


def test_what_grew_is_at_rest_there_and_stiff_as_its_new_volume():
    # at F = G no stress; P = det(G) P_0(F G^-1) G^-T
    term = GrownShape({"growth": 0.1, "growth_b": 0.2})
    at = np.array([3.0, -0.5, 0.0])
    size = np.exp(0.1 - 0.1)
    np.testing.assert_allclose(at_point(term, deformed=size * np.eye(3), at=at)[0], 0, atol=1e-9)
    term, size = GrownShape({"growth": 0.1}), np.exp(0.1)
    np.testing.assert_allclose(at_point(term, deformed=size * np.eye(3))[0], 0, atol=1e-9)
    deformed = np.diag([1.1, 0.9, 1.2])
    np.testing.assert_allclose(at_point(term, deformed=deformed)[0], size**2 * at_point(deformed=deformed / size)[0], rtol=1e-12, atol=1e-9)


# ---------------------------------------------------------------- Maxwell


def test_stress_relaxation():
    # a step in strain: S - S_0 = a C : E exp(-t / tau), to rounding, as the memory is integrated exactly while E holds still
    term, deformed, dt = Maxwell({"maxwell_share": 3.0, "maxwell_time": 0.05}), np.diag([1.1, 0.95, 1.0]) @ (np.eye(3) + 0.1), 1e-3
    strain = (deformed.T @ deformed - np.eye(3)) / 2
    branch = 3 * deformed @ (LAME * np.trace(strain) * np.eye(3) + 2 * MU * strain)
    plain, q = at_point(deformed=deformed)[0], None
    for k in range(1, 200):
        stress, q = at_point(term, deformed=deformed, q=q, dt=dt)
        np.testing.assert_allclose(stress - plain, branch * np.exp(-k * dt / 0.05), atol=1e-9)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 4.0])  # omega tau
def test_storage_and_loss_modulus(ratio):
    # small shear e = e0 sin(w t): sigma_12 = e0 (G' sin + G'' cos), G' = 2 mu (1 + a (w tau)^2 / (1 + (w tau)^2)), G'' = 2 mu a w tau / (..)
    share, tau, count = 2.0, 0.05, 2000
    step = 2 * np.pi / count
    found, q = [], None
    for angle in step * np.arange(1, 5 * count + 1):
        strain = 1e-6 * np.sin(angle)
        deformed = np.eye(3) + strain * (np.eye(3)[[1, 0, 2]] - np.diag([0, 0, 1.0]))
        stress, q = at_point(Maxwell({"maxwell_share": share, "maxwell_time": tau}), deformed=deformed, q=q, dt=step * tau / ratio)
        found.append(stress[0, 1] / 1e-6)
    angle, last = step * np.arange(4 * count + 1, 5 * count + 1), np.array(found[4 * count :])
    storage, loss = 2 / count * last @ np.sin(angle), 2 / count * last @ np.cos(angle)
    # 4 periods leave exp(-8 pi / ratio) < 2e-3 of the transient; first order in the 2000 steps of a period
    assert storage == pytest.approx(2 * MU * (1 + share * ratio**2 / (1 + ratio**2)), rel=5e-3)
    assert loss == pytest.approx(2 * MU * share * ratio / (1 + ratio**2), rel=2e-2)


# ---------------------------------------------------------------- what all have in common


def typical(kind, share=1.0):
    return kind({name: share * value for name, value in kind.effect.typical.items()})


KINDS = [t for t in terms().values() if t.stage in ALTERING]


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_a_rotation_turns_the_stress_and_leaves_the_memory(kind):
    # objectivity: P(R F) = R P(F), with constant R also R P for the rate R F', and memories are the material's own
    random, term = np.random.default_rng(3), typical(kind)
    q, turn = None, Rotation.random(random_state=4).as_matrix()
    q_turned, deformed, rate = None, np.eye(3), random.normal(0, 1.0, (3, 3))
    for _ in range(20):
        deformed = deformed + 0.02 * rate
        found, q = at_point(term, deformed=deformed, rate=rate, q=q, dt=0.02, at=np.array([0.3, 0.2, -0.1]))
        turned, q_turned = at_point(term, deformed=turn @ deformed, rate=turn @ rate, q=q_turned, dt=0.02, at=np.array([0.3, 0.2, -0.1]))
        np.testing.assert_allclose(turned, turn @ found, rtol=0, atol=1e-11 * np.abs(found).max())
        np.testing.assert_allclose(q_turned, q, rtol=0, atol=1e-11)


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_of_no_size_it_changes_nothing_to_the_last_bit(kind):
    random = np.random.default_rng(5)
    deformed, rate = np.eye(3) + random.normal(0, 0.1, (50, 3, 3)), random.normal(size=(50, 3, 3))
    found, q = at_point(typical(kind, 0.0), deformed=deformed, rate=rate)
    for _ in range(3):
        found, q = at_point(typical(kind, 0.0), deformed=deformed, rate=rate, q=q)
    np.testing.assert_array_equal(found, at_point(deformed=deformed)[0])


# ---------------------------------------------------------------- the engine


ALL = tuple(KINDS)  # one kernel serves all tests of the engine


def foam(*, seed=0, share=1.0, kinds=ALL, frames=3, **values):
    """A short bar of foam with ``share`` of typical effects, held at one end, which is led away; its start is stretched and shaken."""
    random = np.random.default_rng(seed)
    axes = [(np.arange(n) + 0.5) * 0.004 for n in (12, 6, 5)]
    samples = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    grid = embed(samples, 0.048 * 0.024 * 0.02, 0.02, axes=Rotation.random(random_state=seed).as_matrix(), offset=random.random(3))
    along = grid.positions @ grid.axes[0]
    held = np.flatnonzero(along < along.min() + 0.01)
    system = System(
        positions=grid.positions @ (np.eye(3) + random.normal(0, 0.05, (3, 3))),
        home=grid.positions,
        velocities=random.normal(size=grid.positions.shape) * 0.3,
        masses=grid.masses(DENSITY),
        springs=np.zeros((0, 2), int),
        stiffness=[],
        controllers=grid.positions[held] + np.linspace(0, 0.02, frames)[:, None, None],
        grips=held,
        grid=grid,
        terms=[NeoHookean({"youngs_modulus": YOUNG}), KelvinVoigt({"viscosity": 10.0}), *(typical(k, share) for k in kinds)],
    )
    return system.with_values(**values)


def test_the_engine_computes_what_the_twin_says():
    # two substeps from a memory of its own: forces of v' = v + dt f / m, memories, and damping in one round; rounding of float64 only
    one, dt = foam(), 1e-4
    grid, x, v = one.grid, one.positions, one.velocities
    batch = Batch([one], fps=1 / dt, substeps=1, rounds=1, double=True)
    count = sum(t.stage in ("flow", "branch") for t in one.terms)
    q = np.random.default_rng(1).normal(0, 0.02, (len(grid.cells), 8, count, 3, 3))
    given = replace(batch.inputs, cell_memory=torch.from_numpy(q).reshape(len(grid.cells), 8, -1))
    home, at = point_sites(one)
    lateral, free, masses = POISSON / (1 - POISSON), np.ones(len(x), bool), one.masses[:, None]
    free[one.grips] = False
    damping = next(t for t in one.terms if t.stage == "viscous")
    for step in range(2):
        then = None

        def law(deformed, rate):
            nonlocal then
            stress, then = point_twin([t for t in one.terms if t.stage != "viscous"], deformed, rate, home, at, q, dt)
            return stress

        _, x_found, v_found, carried = batch.march(step, 1, given, whole=True)
        # driven nodes move as their path says, from the first substep on
        v = np.where(free[:, None], v, given.v[: len(x)].numpy() if step else np.diff(one.controllers[:2], axis=0)[0][:1] / dt)
        elastic = v + dt * np.where(free[:, None], internal_forces(grid, x, v, law, lateral=lateral), 0) / masses
        damped = internal_forces(grid, x, elastic, lambda f, r: damping.twin(f, r, **damping.values), lateral=lateral)
        expected = elastic + dt * damped / masses
        np.testing.assert_allclose(v_found.numpy()[free], expected[free], rtol=0, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(carried.cell_memory.numpy().reshape(q.shape), then, rtol=0, atol=1e-9)
        x, v, q = x_found.numpy(), v_found.numpy(), carried.cell_memory.numpy().reshape(q.shape)
        given = replace(given, x=x_found, v=v_found, **vars(carried))


def test_gradients_against_differences():
    batch, random = Batch([foam(seed=s) for s in (2, 3)], fps=30, substeps=60, double=True), np.random.default_rng(6)
    weight = torch.from_numpy(random.normal(size=(2, batch.node_count, 3)))
    recall = torch.from_numpy(random.normal(size=tuple(batch.inputs.cell_memory.shape)))

    def loss(inputs):
        out, _, _, carried = batch.march(0, 2, inputs, whole=True)
        return (out * weight).sum() + 0.1 * (carried.cell_memory * recall).sum()

    names = ("x", "v", "mass", "path", "table", "cell_memory")
    start = replace(batch.inputs, cell_memory=0.01 * recall)
    given = replace(start, **{n: getattr(start, n).clone().requires_grad_() for n in names})
    loss(given).backward()
    for name in names:
        own = getattr(start, name)
        for _ in range(2):
            way = torch.from_numpy(random.normal(size=tuple(own.shape))) * (own.abs() if name in ("table", "mass") else 1e-3)
            ahead, behind = (float(loss(replace(start, **{name: own + s * 1e-5 * way}))) for s in (1, -1))
            assert float((getattr(given, name).grad * way).sum()) == pytest.approx((ahead - behind) / 2e-5, rel=1e-4)


def test_a_batch_is_its_systems_to_the_last_bit():
    systems = [foam(seed=s, share=share, youngs_modulus=young) for s, share, young in ((0, 1.0, 5e3), (1, 0.4, 8e3))]
    both = Batch(systems, fps=30, substeps=60, rounds=2).rollout(4)
    for system, found in zip(systems, both.positions, strict=True):
        assert torch.equal(Batch([system], fps=30, substeps=60, rounds=2).rollout(4).positions[0], found)


def test_a_march_goes_on_from_where_it_was_broken_off():
    batch = Batch([foam()], fps=30, substeps=60, rounds=2)
    whole = batch.march(0, 4)[0]
    first, x, v, carried = batch.march(0, 2, whole=True)
    second = batch.march(2, 2, replace(batch.inputs, x=x, v=v, **vars(carried)))[0]
    assert torch.equal(torch.cat([first, second]), whole)


def test_of_no_size_all_of_them_change_no_bit_of_a_rollout():
    none = Batch([foam(share=0.0)], fps=30, substeps=60, double=True).rollout(4).positions[0]
    without = Batch([foam(kinds=())], fps=30, substeps=60, double=True).rollout(4).positions[0]
    assert torch.equal(none, without)
