"""Effects in the material of solids against closed forms, at a material point; the engine against the numpy twin; gradients, batches.

A point's stress is P(F); a bar under tension has the stretch l along its axis and t across, with no stress there.
"""

import itertools
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation
from twinbench.physics import batch as engine
from twinbench.physics.batch import Batch, Inputs
from twinbench.physics.catalogue import terms
from twinbench.physics.cells import point_sites
from twinbench.physics.grids import embed
from twinbench.physics.materials import point_twin
from twinbench.physics.solids import damping_forces, internal_forces
from twinbench.physics.stability import stable_step
from twinbench.physics.system import System
from twinbench.physics.terms import (
    DahlFriction,
    Damage,
    Fibres,
    Fung,
    GrownShape,
    Inflation,
    KelvinVoigt,
    Maxwell,
    NeoHookean,
    NortonCreep,
    StiffnessPatch,
    TensionCompression,
    Yielding,
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


@pytest.mark.parametrize("ratio", [1.0, *(pytest.param(r, marks=pytest.mark.slow) for r in (0.3, 4.0))])  # omega tau
def test_storage_and_loss_modulus(ratio):
    # shear e = e0 sin(w t), y = w tau: sigma_12 = e0 (G' sin + G'' cos), G' = 2 mu (1 + a y^2 / (1 + y^2)), G'' = 2 mu a y / (1 + y^2)
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


# ---------------------------------------------------------------- flow


def drawn(term, strains, dt):
    """(P_11 [Pa], memory (3, 3)) at every one of ``strains`` that a bar, free across, goes through."""
    q, across, found = np.zeros((1, 3, 3)), 1.0, []
    for e in strains:

        def shape(t, e=e):
            return np.diag([1 + e, t, t])

        across = fsolve(lambda t, q=q: at_point(term, deformed=shape(t[0]), q=q, dt=dt)[0][1, 1] / YOUNG, across, xtol=1e-12)[0]
        stress, q = at_point(term, deformed=shape(across), q=q, dt=dt)
        found.append((stress[0, 0], q[0]))
    return tuple(np.array(part) for part in zip(*found, strict=True))


def test_a_bar_yields_at_its_yield_strain_and_keeps_what_flowed():
    # P = Y e up to e_Y, then Y e_Y; unloaded by e_Y nothing pulls: the permanent set is e - e_Y. Small strains: errors of order e = 0.5 %
    yields = 0.002
    term = Yielding({"yielding_rate": 1000.0, "solid_yield_strain": yields})
    strains = np.concatenate([np.linspace(0, 5 * yields, 51), np.linspace(5 * yields, 4 * yields, 11)])
    stress, q = drawn(term, strains, 0.02)
    elastic, flowing, back = slice(1, 10), slice(15, 51), slice(51, None)
    np.testing.assert_allclose(stress[elastic], YOUNG * strains[elastic], rtol=0.01)
    assert (q[elastic] == 0).all()
    np.testing.assert_allclose(stress[flowing], YOUNG * yields, rtol=0.02)
    np.testing.assert_allclose(stress[back], YOUNG * (strains[back] - 4 * yields), atol=0.02 * YOUNG * yields)
    np.testing.assert_allclose(q[-1, 0, 0], 4 * yields, rtol=0.02)


@pytest.mark.parametrize("stretch", [1.6, 0.6])
def test_what_flowed_far_is_at_rest_there_with_the_volume_that_it_had(stretch):
    # G: no stress at F = G, det(G) = 1; and flow ends at the yield strain, elastic strains being as large in either sense
    deformed, q = np.diag([stretch, stretch**-0.5, stretch**-0.5]) @ Rotation.random(random_state=0).as_matrix(), None
    term = Yielding({"yielding_rate": 1000.0, "solid_yield_strain": 0.05})
    for _ in range(60):
        _, q = at_point(term, deformed=deformed, q=q, dt=1e-2)
    shape = np.eye(3) + q[0]
    assert np.linalg.det(shape) == pytest.approx(1, abs=1e-9)
    assert abs(np.diag(shape)).max() > 1.1
    np.testing.assert_allclose(at_point(term, deformed=shape, q=q)[0], 0, atol=1e-9 * YOUNG)
    left = deformed @ np.linalg.inv(shape)
    strain = (left.T @ left - np.eye(3)) / 2
    size = np.linalg.norm(strain - np.trace(strain) / 3 * np.eye(3))
    assert np.sqrt(1.5) * size / (1 + POISSON) == pytest.approx(0.05, rel=1e-6)


@pytest.mark.parametrize("power", [1.0, 4.0])
def test_a_loaded_bar_creeps_by_nortons_law(power):
    # at the elastic strain e, e' = r e (e / e_0)^(n - 1); to first order in e = 0.2 %
    rate, reference, load, dt = 2.0, 0.004, 0.002, 1e-3
    term = NortonCreep({"norton_rate": rate, "norton_exponent": power, "norton_strain": reference})
    q, lengths = np.zeros((1, 3, 3)), []
    guess = np.array([1 + load, 1 - POISSON * load])
    for _ in range(20):

        def unbalanced(s, q=q):
            stress = at_point(term, deformed=np.diag([s[0], s[1], s[1]]), q=q, dt=dt)[0] / YOUNG
            return [stress[0, 0] - load, stress[1, 1]]

        guess = fsolve(unbalanced, guess, xtol=1e-12)
        q = at_point(term, deformed=np.diag([guess[0], guess[1], guess[1]]), q=q, dt=dt)[1]
        lengths.append(guess[0])
    pace = np.diff(lengths) / dt
    np.testing.assert_allclose(pace, rate * load * (load / reference) ** (power - 1), rtol=0.01 * power)


def test_creep_relaxes_a_held_shear_exponentially_and_never_overshoots():
    # n = 1: dev E decays at 3 r / 2 (1 + nu); a step of any length leaves it between all and nothing
    deformed, rate = np.eye(3) + 1e-3 * np.outer([1.0, 0, 0], [0, 1.0, 0]), 2.0
    start, q = at_point(deformed=deformed)[0][0, 1], None
    for k in range(1, 101):
        stress, q = at_point(NortonCreep({"norton_rate": rate}), deformed=deformed, q=q, dt=5e-3)
        assert stress[0, 1] == pytest.approx(start * np.exp(-1.5 / (1 + POISSON) * rate * k * 5e-3), rel=2e-3)
    for power, dt in itertools.product((1.0, 3.0, 8.0), (1e-3, 1.0, 1e3)):
        term = NortonCreep({"norton_rate": 20.0, "norton_exponent": power, "norton_strain": 0.002})
        deformed = np.eye(3) + 0.1 * np.outer([1.0, 0, 0], [0, 1.0, 0])
        assert 0 <= at_point(term, deformed=deformed, dt=dt)[0][0, 1] <= at_point(deformed=deformed)[0][0, 1] * (1 + 1e-12)


# ---------------------------------------------------------------- friction


def rubbed(term, strain, dt):
    """(work per volume and cycle [J/m^3], last memory) of a small shear E_12 = ``strain`` (T,), of which the last half is one cycle."""
    cross, q, stress = np.eye(3)[[1, 0, 2]] - np.diag([0, 0, 1.0]), None, []
    for before, now in itertools.pairwise(strain):
        found, q = at_point(term, deformed=np.eye(3) + before * cross, rate=(now - before) / dt * cross, q=q, dt=dt)
        stress.append(found[0, 1])
    half = len(stress) // 2
    return 2 * (np.array(stress) * np.diff(strain))[half:].sum(), q


@pytest.mark.parametrize("dt", [1e-4, 1e-2])
def test_a_cycle_of_friction_takes_the_same_work_at_every_speed(dt):
    # along a path of length s = sqrt(2) E_12: dz / ds = (+-1 - z) / e_h, so that a steady cycle of amplitude A takes
    # 4 a (n : C : n) (A - e_h tanh(A / e_h)), n : C : n = 2 mu. 800 steps a cycle, first order in them
    amplitude, share, width = 2e-3, 0.05, 1e-3
    wave = amplitude * np.interp(np.arange(1601) / 800 % 1, [0, 0.25, 0.75, 1], [0, 1, -1, 0])
    work, _ = rubbed(DahlFriction({"dahl_friction": share, "dahl_strain": width}), wave, dt)
    a = np.sqrt(2) * amplitude
    assert work == pytest.approx(4 * share * 2 * MU * (a - width * np.tanh(a / width)), rel=0.01)


def test_friction_tends_to_its_largest_and_no_further():
    _, q = rubbed(DahlFriction({"dahl_friction": 0.05, "dahl_strain": 1e-3}), np.linspace(0, 0.02, 200), 1e-2)
    assert np.linalg.norm(q[0]) == pytest.approx(1, abs=1e-3) and np.linalg.norm(q[0]) <= 1
    held = at_point(DahlFriction(), deformed=np.eye(3), rate=np.zeros((3, 3)), q=q, dt=100.0)[1]
    np.testing.assert_allclose(held, q, rtol=0, atol=0.2)  # what counts as no motion, 1e-6 / s, fades it in hours


# ---------------------------------------------------------------- damage


def test_a_held_bar_tears_exponentially_and_does_not_heal():
    # nu = 0, E_11 = E: d = 1 - exp(-r w (E / e_c - 1) t), P = (1 - 0.95 d) P_0; let go nothing changes
    stretch, edge, rate, dt = 1.1, 0.04, 5.0, 0.01
    term = Damage({"damage_rate": rate, "damage_strain": edge, "damage_x": 0.1, "damage_radius": 0.05})
    deformed, q, w = np.diag([stretch, 1, 1]), None, np.exp(-0.5)
    known = dict(home=np.array([0.05, 0, 0]), poisson=0.0, dt=dt)
    plain = at_point(deformed=deformed, poisson=0.0)[0]
    for k in range(1, 40):
        stress, q = at_point(term, deformed=deformed, q=q, **known)
        torn = 1 - np.exp(-rate * w * ((stretch**2 - 1) / 2 / edge - 1) * k * dt)
        assert q[0, 0, 0] == pytest.approx(torn, rel=1e-9)
        np.testing.assert_allclose(stress, (1 - 0.95 * torn) * plain, atol=1e-9)
    np.testing.assert_array_equal(at_point(term, deformed=np.eye(3), q=q, **known)[1], q)


def test_a_bar_bears_ten_times_the_strain_in_compression():
    # e of a bar strained by e is e in tension and e / 10 in compression, to first order
    for times, torn in ((1.01, True), (0.99, False), (-9.7, False), (-10.3, True)):
        deformed = np.eye(3) + 0.002 * times * np.diag([1, -POISSON, -POISSON])
        q = at_point(Damage({"damage_rate": 1e3, "damage_strain": 0.002}), deformed=deformed, dt=1.0)[1]
        assert (q[0, 0, 0] > 0) == torn


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


def foam(*, seed=0, share=1.0, kinds=ALL, frames=3, held=True, **values):
    """A short bar of foam with ``share`` of typical effects, held at one end, which is led away; its start is stretched and shaken."""
    random = np.random.default_rng(seed)
    axes = [(np.arange(n) + 0.5) * 0.004 for n in (12, 6, 5)]
    samples = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    grid = embed(samples, 0.048 * 0.024 * 0.02, 0.02, axes=Rotation.random(random_state=seed).as_matrix(), offset=random.random(3))
    along = grid.positions @ grid.axes[0]
    held = np.flatnonzero(along < along.min() + 0.01) if held else np.zeros(0, int)
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
    # a substep from a memory of its own: v' = v + dt (f + f_v(v)) / m in one round, and memories; rounding of float64 only
    one, dt = foam(held=False), 1e-4
    batch = Batch([one], fps=1 / dt, substeps=1, rounds=1, double=True)
    count = sum(t.stage in ("flow", "branch") for t in one.terms)
    q = np.random.default_rng(1).normal(0, 0.02, (len(one.grid.cells), 8, count, 3, 3))
    given = replace(batch.inputs, cell_memory=torch.from_numpy(q).reshape(len(q), 8, -1))
    _, _, v_found, carried = batch.march(0, 1, given, whole=True)
    matter, (damping,) = ([t for t in one.terms if (t.stage == "viscous") == viscous] for viscous in (False, True))
    after, lateral, (home, at) = [], POISSON / (1 - POISSON), point_sites(one)

    def law(deformed, rate):
        stress, then = point_twin(matter, deformed, rate, home, at, q, dt)
        after.append(then)
        return stress

    force = internal_forces(one.grid, one.positions, one.velocities, law, lateral=lateral)
    force += damping_forces(one.grid, one.positions, one.velocities, lambda rate: damping.twin(rate, **damping.values), lateral=lateral)
    v = one.velocities + dt * force / one.masses[:, None]
    np.testing.assert_allclose(v_found.numpy(), v, rtol=0, atol=1e-10 * np.abs(v).max())
    np.testing.assert_allclose(carried.cell_memory.numpy().reshape(q.shape), after[0], rtol=0, atol=1e-12)


def test_what_alters_elasticity_needs_one():
    one = foam(kinds=())
    with pytest.raises(ValueError, match="maxwell alters the elasticity of a solid and needs a term that has one, such as neo_hookean"):
        replace(one, terms=[KelvinVoigt(), Maxwell()])


def test_layers_that_grow_differently_bend_a_bar():
    # G = 1 + g . X has no stress in the shape x = X (1 + g . X) - g |X|^2 / 2, a circle of curvature |g| = g_b / R: forces there are of
    # second order in g_b, and those of a shape that is bent otherwise grow with the difference
    axes = [(np.arange(n) + 0.5) * 0.0015 for n in (80, 20, 20)]
    grid = embed(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3), 0.12 * 0.03**2, 0.015, axes=np.eye(3))
    known = dict(springs=np.zeros((0, 2), int), stiffness=[], controllers=np.zeros((1, 0, 3)), grid=grid)
    system = System(positions=grid.positions, terms=[NeoHookean(), GrownShape({"growth_b": 0.01})], **known)
    home, at = point_sites(system)
    middle = (home * grid.volume[:, None, None]).sum((0, 1)) / (8 * grid.volume.sum())
    radius = np.sqrt((0.12**2 + 2 * 0.03**2) / 12)
    away, g = grid.positions - middle, 0.01 / radius * np.array([0, 1.0, 0])

    def forces(share):
        bent = away * (1 + share * (away @ g)[:, None]) - share * g * (away**2).sum(1, keepdims=True) / 2
        none = np.zeros((*home.shape[:2], 0, 3, 3))
        return np.linalg.norm(
            internal_forces(
                grid,
                bent,
                0 * bent,
                lambda f, r: point_twin(system.terms, f, r, home, at, none, 1e-3)[0],
                lateral=POISSON / (1 - POISSON),
            )
        )

    straight = forces(0.0)
    assert forces(1.0) < 0.02 * straight
    for share in (0.5, 0.9, 1.1, 2.0):
        assert forces(share) == pytest.approx(abs(1 - share) * straight, rel=0.1)


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
            step = 1e-5 if name == "v" else 1e-6  # between the kinks of friction and yielding, and the rounding of what counts little
            ahead, behind = (float(loss(replace(start, **{name: own + s * step * way}))) for s in (1, -1))
            assert float((getattr(given, name).grad * way).sum()) == pytest.approx((ahead - behind) / (2 * step), rel=1e-4)


@pytest.mark.parametrize("room", [1, 7])
def test_checkpointed_gradients_equal_the_whole_history_bit_for_bit(room, monkeypatch):
    # states are recomputed by the same arithmetic from the same start; 20 = 2 * 7 + 6. A path's gradient may be given in two parts
    found = []
    for bytes_ in (engine.HISTORY_BYTES, 0):
        batch = Batch([foam(seed=2)], fps=180, substeps=10, rounds=2, double=True)
        monkeypatch.setattr(engine, "HISTORY_BYTES", bytes_ or room * batch.substep_bytes)
        assert bool(bytes_) == (len(batch.stretches(2, history=True)) == 1)
        given = replace(batch.inputs, **{f.name: getattr(batch.inputs, f.name).clone().requires_grad_() for f in fields(Inputs)})
        out, _, _, carried = batch.march(0, 2, given, whole=True)
        ((out**2).sum() + (carried.cell_memory**2).sum()).backward()
        found.append({n: getattr(given, n).grad for n in ("x", "v", "mass", "table", "cell_memory")})
    for name, whole in found[0].items():
        assert whole.abs().max() > 0 and torch.equal(whole, found[1][name]), name


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


@pytest.mark.parametrize("values", [dict(maxwell_share=4.0), dict(dahl_friction=0.1), dict(fibre_share=5.0)], ids=lambda v: next(iter(v)))
def test_a_substep_is_as_long_as_stability_allows(values):
    # at 0.95 of the bound a shaken bar stays together, well beyond it it does not; small motions, since effects may stiffen as they grow
    one = foam(share=0.0, held=False, viscosity=0.0, fibre_compression=1.0, **values)
    small = np.random.default_rng(8).normal(0, 1e-4, one.positions.shape)
    one = replace(one, positions=one.grid.positions, velocities=small)
    step = stable_step(one)
    assert step < 0.8 * stable_step(one.with_values(**dict.fromkeys(values, 0.0)))
    good, bad = (
        Batch([one], fps=1 / (20 * dt), substeps=20, dt=dt, double=True).rollout(41).positions[0][-1].numpy()
        for dt in (0.95 * step, 1.4 * step)
    )
    assert np.abs(good - one.positions).max() < 1e-3
    assert not np.abs(bad - one.positions).max() < 1e-3


@pytest.mark.parametrize("double", [True, False])
def test_gradients_are_finite_at_rest(double):
    # where there is no strain and no motion, roots and directions have no derivative of their own
    one = replace(foam(held=False), velocities=None, positions=foam().grid.positions, home=None)
    batch = Batch([one.with_values(growth=0.0, growth_a=0.0, growth_b=0.0, growth_c=0.0)], fps=180, substeps=10, rounds=2, double=double)
    given = replace(batch.inputs, **{n: getattr(batch.inputs, n).clone().requires_grad_() for n in ("x", "v", "table", "cell_memory")})
    (batch.march(0, 1, given)[0] ** 2).sum().backward()
    for name in ("x", "v", "table", "cell_memory"):
        assert torch.isfinite(getattr(given, name).grad).all(), name
