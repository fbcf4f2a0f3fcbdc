"""How statistics of sound recordings are distributed, against draws of known distributions and closed forms."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm, t
from twinbench.diagnosis.inference.tails import Tail, any_beyond, going_together


@pytest.mark.parametrize("degrees", [2.0, 4.0, 30.0])
def test_a_tail_is_that_of_its_draws(degrees):
    # 20,000 draws of a known Student t: place and scale to 4 standard errors (1.5 / sqrt(n) at most), tails to 10 % at 1 %
    draws = t.rvs(degrees, loc=0.7, scale=1.3, size=20000, random_state=1)
    tail = Tail.of(draws)
    assert tail.degrees == degrees
    assert (tail.place, tail.scale) == pytest.approx((0.7, 1.3), abs=0.05)
    assert tail.beyond(t.isf(0.01, degrees, 0.7, 1.3)) == pytest.approx(0.01, rel=0.1)
    assert tail.beyond(tail.at(0.03)) == pytest.approx(0.03)


def test_one_recording_far_out_leaves_the_rest_alone():
    # 36 normal draws, one of them moved to 8: a normal's scale would be 1.7 times as large
    draws = np.random.default_rng(4).normal(size=36)
    moved = np.append(draws[:-1], 8.0)
    assert Tail.of(moved).scale < 1.15 * Tail.of(draws).scale
    assert 1e-4 < Tail.of(moved).beyond(8.0) < 0.03


@pytest.mark.parametrize("degrees", [3.0, 30.0])
@pytest.mark.parametrize("far", [-1.0, 0.5, 2.0, 4.0])
def test_a_further_error_is_added_to_a_tail(degrees, far):
    # P(0.2 + 0.12 t + 0.3 z > x), z normal, by scipy's adaptive quadrature; where it is normal as well, about as far as the root of squares
    tail = Tail(0.2, 0.12, degrees, 0.3)
    expected, _ = quad(lambda z: norm.pdf(z) * t.sf((far - 0.2 - 0.3 * z) / 0.12, degrees), -12, 12, epsabs=0, epsrel=1e-10, limit=400)
    assert float(tail.beyond(far)) == pytest.approx(expected, rel=1e-6)
    assert tail.at(float(tail.beyond(far))) == pytest.approx(far, abs=1e-6)
    assert tail.beyond([far, far]).shape == (2,)


@pytest.mark.parametrize("further", [0.0, 0.3])
@pytest.mark.parametrize("far", [-0.5, 0.3, 2.0])
def test_a_density_is_how_fast_a_tail_falls(far, further):
    # central differences of 1e-4, of which the third derivative makes a part of 1e-6
    tail = Tail(0.2, 0.12, 4.0, further)
    assert tail.density(far) == pytest.approx(float(tail.beyond(far - 1e-4) - tail.beyond(far + 1e-4)) / 2e-4, rel=1e-5)


@pytest.mark.parametrize("far", [0.1, 1.0, 2.5, 5.0])
def test_how_much_likelier_a_value_is_where_something_was_added(far):
    # ln of the mean of f(x - u) over u in (0, 3), over f(x), by scipy's adaptive quadrature
    tail = Tail(0.44, 0.18, 30.0, 0.3)
    mean = quad(lambda u: tail.density(far - u), 0, 3, points=[min(3, max(0, far - 0.44))], epsrel=1e-9)[0] / 3
    assert tail.wider(far, 3.0) == pytest.approx(np.log(mean / tail.density(far)), abs=1e-5)
    assert tail.wider(0.44, 3.0) < 0 < tail.wider(1.5, 3.0)


@pytest.mark.parametrize("p", [1e-9, 0.03, 0.4])
def test_of_those_that_have_no_further_error_fewer_are_as_rare(p):
    # normal with 0.12 and 0.3 beside: at p it is hypot(0.12, 0.3) deviates out, and so so many of 0.12
    tail = Tail(0.2, 0.12, 1e6, 0.3)
    assert tail.within(p) == pytest.approx(norm.sf(norm.isf(p) * np.hypot(0.12, 0.3) / 0.12), rel=1e-3)
    assert Tail(0.2, 0.12, 4.0).within(p) == p


def test_a_further_error_that_is_nothing_changes_nothing():
    assert Tail(0.2, 0.12, 4.0, 1e-9).beyond(0.7) == pytest.approx(Tail(0.2, 0.12, 4.0).beyond(0.7), rel=1e-6)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("p", [1e-12, 1e-5, 0.03, 0.5, 0.999])
def test_what_does_not_go_together_costs_as_many_times_as_there_are(count, p):
    # 1 - (1 - p)^k, to rounding also where it is as small as a recording with a hand kept back has it
    assert any_beyond(p, np.eye(count)) == pytest.approx(-np.expm1(count * np.log1p(-p)), rel=1e-12)


def test_statistics_may_be_rare_each_in_its_own_way():
    # 1 - (1 - a)(1 - b), and by Genz's integral where they go together
    assert any_beyond([0.03, 0.2], np.eye(2)) == pytest.approx(1 - 0.97 * 0.8, rel=1e-12)
    inside = multivariate_normal.cdf(norm.isf([0.03, 0.2]), cov=[[1.0, 0.62], [0.62, 1.0]], abseps=1e-8, releps=1e-8)
    assert any_beyond([0.03, 0.2], [[1.0, 0.62], [0.62, 1.0]]) == pytest.approx(1 - inside, abs=1e-6)


@pytest.mark.parametrize("p", [0.001, 0.03, 0.4])
def test_of_statistics_that_go_together_it_is_the_normal_distributions(p):
    # scipy's multivariate normal (Genz), whose error is asked to be below 1e-8 and reaches 1e-8 in three dimensions
    two = [[1.0, 0.62], [0.62, 1.0]]
    three = [[1.0, 0.26, -0.23], [0.26, 1.0, 0.1], [-0.23, 0.1, 1.0]]
    for correlation in (two, three):
        inside = multivariate_normal.cdf(np.full(len(correlation), norm.isf(p)), cov=correlation, abseps=1e-8, releps=1e-8)
        assert any_beyond(p, correlation) == pytest.approx(1 - inside, abs=1e-6)


def test_what_is_the_same_costs_nothing():
    # of two that are nearly one: between p and 2 p, and less the closer they are
    found = [any_beyond(0.03, [[1.0, r], [r, 1.0]]) for r in (-0.9, 0.0, 0.6, 0.9, 0.99)]
    assert np.all(np.diff(found) < 0) and found[0] < 0.06 + 1e-12 and 0.03 < found[-1] < 0.036


def test_how_much_goes_together_is_told_by_draws():
    # a Gaussian copula of correlation 0.6 under two unlike Student t: to 4 standard errors of 4000 draws, (1 - 0.6^2) / sqrt(4000) each
    deviates = np.random.default_rng(2).multivariate_normal([0.0, 0.0], [[1.0, 0.6], [0.6, 1.0]], size=4000)
    values = np.stack([t.isf(norm.sf(deviates[:, 0]), 3, 1.0, 0.2), t.isf(norm.sf(deviates[:, 1]), 10, -2.0, 3.0)], 1)
    found = going_together(values, [Tail.of(column) for column in values.T])
    assert found[0, 1] == pytest.approx(0.6, abs=0.04) and np.diag(found).tolist() == [1.0, 1.0]
    assert going_together(values[:, :1], [Tail.of(values[:, 0])]).tolist() == [[1.0]]
