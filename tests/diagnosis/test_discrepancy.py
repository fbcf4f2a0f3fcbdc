"""What a twin is expected to miss, told by sound recordings: against closed forms of ridges and of means."""

import numpy as np
import pytest
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.inference.discrepancy import alike, expected

RIDGES = DiagnosisConfig().ridges


def starts(random, count, size=6):
    return random.normal(0, 0.1, (count, size // 3, 3))


def test_of_one_command_it_is_the_mean():
    # equal starts tell nothing, and of a constant with ridge r the posterior mean is K / (K + r) of the mean (Rasmussen and Williams 2.23)
    missed = 0.01 + np.random.default_rng(0).normal(0, 1e-4, (9, 12))
    found, far = expected(missed, alike([np.ones((2, 3))] * 10), (0.03,))
    np.testing.assert_allclose(found[-1], 9 / 9.03 * missed.mean(0), rtol=1e-9)
    np.testing.assert_allclose(found[0], 8 / 8.03 * missed[1:].mean(0), rtol=1e-9)
    assert far == 1.0  # a ninth recording more tells it better than the others tell each


def test_what_follows_the_start_is_expected():
    random = np.random.default_rng(1)
    begin, law = starts(random, 30), random.normal(size=(6, 20))
    missed = begin.reshape(30, -1) @ law * 0.1
    found, _ = expected(missed[:-1], alike(begin), (1e-9,))
    np.testing.assert_allclose(found, missed, atol=1e-6)  # linear, and without noise: found from any others by a ridge of next to nothing


def test_of_what_follows_nothing_little_is_expected():
    # independent recordings: what is expected of each has nothing to do with it, and must not add more than an eighth to what is missed
    random, shares = np.random.default_rng(2), []
    for _ in range(20):
        missed = random.normal(0, 0.01, (12, 40))
        found, far = expected(missed, alike(starts(random, 13)), RIDGES)
        assert far.shape == (1,) and far >= 1.0
        shares.append(np.mean((missed - found[:-1]) ** 2) / np.mean(missed**2))
    assert np.mean(shares) < 1.125


def test_no_recording_tells_of_itself():
    random = np.random.default_rng(3)
    missed, kernel = random.normal(0.01, 0.01, (8, 5)), alike(starts(random, 9))
    other = missed.copy()
    other[3] += 1.0
    before, after = (expected(one, kernel, RIDGES)[0] for one in (missed, other))
    np.testing.assert_array_equal(after[3], before[3])
    assert np.abs(after[-1] - before[-1]).max() > 1e-3


def test_what_is_told_counts_alike_whatever_its_size():
    random = np.random.default_rng(4)
    small, large = starts(random, 7), 30 * starts(random, 7, 300)
    kernel = alike(small, large)
    assert np.trace(kernel) / 7 == pytest.approx(3.0)  # a constant, and 1 on average of each
    hidden = large.copy()
    hidden[2, 5] = np.nan
    assert np.isfinite(alike(small, hidden)).all() and np.abs(alike(small, hidden) - kernel).max() < 0.1


def test_nothing_is_told_of_what_never_moves_nor_of_unequal_hands():
    random = np.random.default_rng(5)
    begin = starts(random, 6)
    still = 0.5 + random.normal(0, 1e-4, (6, 30, 2, 3))  # 0.1 mm, a tracker's noise
    np.testing.assert_array_equal(alike(begin, still), alike(begin))
    np.testing.assert_array_equal(alike(begin, [np.zeros((4, 3))] * 5 + [np.zeros((2, 3))]), alike(begin))


def test_what_starts_elsewhere_is_expected_less_well():
    # along a line, by a constant and a linear kernel: the predictive variance grows as the square of the way from where others start
    random = np.random.default_rng(6)
    begin = np.concatenate([random.normal(0, 0.1, 12), [0.0, 1.0, 2.0]])[:, None] * np.ones((1, 3))
    missed = 0.1 * begin[:12] + random.normal(0, 1e-3, (12, 3))
    _, far = expected(missed, alike(begin), (0.1,))
    assert far[0] < 1.1 and far[2] > far[1] > 1.5 * far[0]
