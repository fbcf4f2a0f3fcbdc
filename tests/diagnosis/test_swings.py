"""How fast chains swing that were let go: known oscillations are recovered, and judged beside sound ones by a line's interval."""

from dataclasses import replace

import numpy as np
import pytest
from driven_chain import commands, driven
from releases import bent, table
from scipy.stats import kstest
from twinbench.datasets.collection import open_collection
from twinbench.diagnosis.swings import Faster, Swing, faster, swing_of


def let_go(root, *, rates, seed=0):
    """Releases that begin at rest and swing at ``rates`` [rad/s], from 0.1 to 0.3 rad, dying out at 2 1/s."""
    random, t, made = np.random.default_rng(seed), np.maximum(np.arange(430) - 30, 0) / 100, []
    for rate in rates:
        angle = random.uniform(0.1, 0.3) * np.exp(-2 * t) * (np.cos(rate * t) + 2 / rate * np.sin(rate * t))
        made.append(bent(angle[:, None] * [0.3, 0.7, 1.0]) + random.normal(0, 1e-5, (430, 3, 3)))
    table(root / "observations_decay_200g.csv", made)
    found = open_collection(root)
    return [found.load(f"decay_200g/{k}") for k in range(len(rates))]


def test_a_known_oscillation_is_recovered(tmp_path):
    # the disk's way is sin(angle) times lengths: 0.3 rad is 1.5 % less than straight, and less as it dies out
    (one,) = let_go(tmp_path, rates=[9.0])
    found = swing_of(one)
    assert found is not None
    assert found.rate == pytest.approx(9.0, rel=0.01) and found.decay == pytest.approx(2.0, rel=0.05)
    # the first turn is half a swing on, after exp(-2 pi / 9) of what it began with; 0.3 rad is 2 to 4 % less than straight and level
    began = np.linalg.norm(one.points[0, 4] - one.points[-1, 4])
    assert found.amplitude == pytest.approx(began * np.exp(-2 * np.pi / 9), rel=0.05) and found.off < 0.05 * found.amplitude


def test_what_swings_more_slowly_is_as_if_heavier(tmp_path):
    # w^2 = k / m: at 0.93 of the rate 1 / 0.93^2 = 1.156 times the mass
    random = np.random.default_rng(3)
    found = let_go(tmp_path, rates=[*(9.0 * np.exp(random.normal(0, 0.01, 12))), *(0.93 * 9.0 * np.exp(random.normal(0, 0.01, 3)))])
    sound, cases = ([swing_of(one) for one in group] for group in (found[:12], found[12:]))
    told = faster(cases, sound)
    assert told is not None
    share, low, high = told.heavier()
    assert told.p < 1e-3 and low < 0.93**-2 - 1 < high and share == pytest.approx(0.93**-2 - 1, abs=0.03)
    assert "more slowly than sound recordings at equal amplitude" in told.said() and "times the mass moved" in told.said()
    alone = faster(cases[:1], sound)
    assert alone is not None and alone.sd > told.sd
    assert faster(cases, sound[:7]) is None  # too few


def test_p_values_are_those_of_the_prediction_interval():
    # log w = 2 - 0.3 log a + normal strays: Student's t with n - 2 degrees makes p uniform for any n (Seber and Lee 2003, section 5.3)
    random, found = np.random.default_rng(5), []
    for _ in range(2000):
        amplitudes = random.uniform(0.08, 0.14, 12)  # m, all within twice each other's
        rates = np.exp(2 - 0.3 * np.log(amplitudes) + random.normal(0, 0.03, 12))
        drawn = [Swing(rate, 3.0, amplitude, 0.0) for rate, amplitude in zip(rates, amplitudes, strict=True)]
        found.append(faster(drawn[:2], drawn[2:]).p)
    assert kstest(found, "uniform").pvalue > 0.01


def test_lighter_and_stiffer_are_said_as_well():
    one = Faster(0.1, 0.02, 10, 1e-3)
    assert one.heavier()[0] == pytest.approx(np.exp(-0.2) - 1) and "faster" in one.said() and "lighter, or stiffer" in one.said()


def test_what_does_not_swing_by_itself_says_nothing(tmp_path):
    (one,) = let_go(tmp_path, rates=[9.0])
    moved = one.controllers + np.linspace(0, 0.1, len(one.controllers))[:, None, None]
    assert swing_of(replace(one, controllers=moved)) is None
    assert swing_of(driven("driven", commands(100))) is None
    points = one.points.copy()
    points[:, 2:] = points[0, 2:]
    assert swing_of(replace(one, points=points)) is None  # it hangs still
    held = replace(one, grips=np.array([0, 4]))
    assert swing_of(held) is None


def test_a_heavier_trunk_swings_more_slowly_and_another_session_does_not(recordings):
    # 300 g for 200 g: more than a tenth of what moves; two sessions with 200 g. Two short ones, let go from near rest, swing twice as fast
    found = open_collection(recordings / "trunk")
    every = {name: found.load(name) for name in found.scenarios if "decay" in name}
    long = {name: swing_of(one) for name, one in every.items() if one.frame_count > 330}
    first, second, heavy = ([one for name, one in long.items() if name.startswith(f"decay_{s}/")] for s in ("200g", "200g_2", "300g"))
    more, same = faster(heavy, first), faster(second, first)
    assert more is not None and more.p < 0.03 and more.heavier()[1] > 0
    assert same is not None and same.p > 0.1
    assert faster([swing_of(every["decay_200g_2/4"]), *second], first) == same
