"""The fit of few parameters: closed forms, curved valleys, outliers, bounds, priors, runs that diverge; predictability of coordinates."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.methods.continuum.fitting import AllDiverged, Steps, fit, narrowed
from twinbench.methods.continuum.predictability import absorbed, predictability, smoothed
from twinbench.methods.continuum.robust import StudentT
from twinbench.methods.continuum.unknowns import Unknown, members, spread

LEAST_SQUARES = StudentT(dof=np.inf, scaled=False)
TIMES = np.linspace(0, 2, 400)


def free(count, *, low=-10.0, high=10.0, value=0.0, prior=None):
    return [Unknown(f"p{k}", value, low, high, "-", prior=prior) for k in range(count)]


def linear(matrix):
    return lambda values: values @ matrix.T


def oscillator(values):
    """x(t) = e^(-d t) (cos w t + d / w sin w t) of x'' + 2 d x' + (d^2 + w^2) x = 0, x(0) = 1: values (B, 2) are w [1/s] and d [1/s]."""
    w, d = values.T[:, :, None]
    return np.exp(-d * TIMES) * (np.cos(w * TIMES) + d / w * np.sin(w * TIMES))


OSCILLATOR = [Unknown("frequency", 8.0, 3.0, 30.0, "1/s", "log"), Unknown("decay", 1.0, 0.05, 20.0, "1/s", "log")]


def measured(noise, seed=0, truth=(10.0, 0.8)):
    return oscillator(np.array([truth]))[0] + np.random.default_rng(seed).normal(0, noise, len(TIMES))


# ---------------------------------------------------------------- closed forms


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 8))
def test_linear_least_squares_has_the_analytic_mean_and_covariance(seed, count):
    # posterior precision J' N^-1 J + P, mean its inverse times J' N^-1 y + P m (Bishop 2006, 3.50 and 3.51); one step gets there
    random = np.random.default_rng(seed)
    matrix, sd = random.normal(size=(40, count)), random.uniform(0.5, 2, 40)
    mean, prior = random.normal(size=count), random.uniform(0.1, 1, count)
    data = matrix @ random.normal(size=count) + random.normal(size=40) * sd
    unknowns = [Unknown(f"p{k}", 0.0, -50.0, 50.0, "-", prior=(mean[k], prior[k])) for k in range(count)]
    found = fit(unknowns, linear(matrix), data, sd, loss=LEAST_SQUARES, steps=Steps(tolerance=1e-9))
    precision = matrix.T / sd**2 @ matrix + np.diag(prior**-2)
    expected = np.linalg.solve(precision, matrix.T @ (data / sd**2) + mean / prior**2)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(precision), rtol=1e-6, atol=1e-12)
    # 1e-9 nats from the top is sqrt(2e-9) standard deviations
    np.testing.assert_array_less(np.abs(found.scaled - expected), 5e-5 * np.sqrt(np.diag(found.covariance)) + 1e-12)
    assert found.costs == tuple(sorted(found.costs, reverse=True))


@pytest.mark.parametrize("loss", [LEAST_SQUARES, StudentT()])
def test_an_oscillators_frequency_and_decay_lie_in_their_intervals(loss):
    # 95 % of intervals hold the truth: of 2 x 60 at least 105 (binomial: 99.8 % of the time)
    held = 0
    for seed in range(60):
        found = fit(OSCILLATOR, oscillator, measured(0.05, seed), np.full(len(TIMES), 0.05), loss=loss)
        held += sum(low < truth < high for truth, (low, high) in ((t, found.interval(n)) for n, t in (("frequency", 10.0), ("decay", 0.8))))
    assert held >= 105


def test_noise_that_was_stated_too_small_is_noticed():
    # stated 0.02, is 0.1: least squares would state a fifth of the error; the scale of the t distribution of normal noise is below its sd
    stated = fit(OSCILLATOR, oscillator, measured(0.1), np.full(len(TIMES), 0.02))
    known = fit(OSCILLATOR, oscillator, measured(0.1), np.full(len(TIMES), 0.1), loss=LEAST_SQUARES)
    assert 3.5 < stated.scale < 5
    for name in ("frequency", "decay"):
        assert stated.sd[name] == pytest.approx(known.sd[name], rel=0.25)


def test_given_derivatives_and_central_differences_find_the_same():
    def slopes(values):
        h = 1e-5
        return np.stack([(oscillator(values + h * e) - oscillator(values - h * e)) / (2 * h) for e in np.eye(2)], 2)

    data, noise = measured(0.05), np.full(len(TIMES), 0.05)
    fits = [fit(OSCILLATOR, oscillator, data, noise, **more) for more in ({}, {"jacobian": slopes}, {"steps": Steps(central=True)})]
    for other in fits[1:]:  # 0.01 nats from the top is 0.14 standard deviations, of either
        assert (np.abs(other.scaled - fits[0].scaled) < 0.3 * np.array([*fits[0].sd.values()])).all()
        sd = np.array([*fits[0].sd.values()])  # forward differences are off by half a step of 0.01 times the curvature
        np.testing.assert_allclose(other.covariance / np.outer(sd, sd), fits[0].covariance / np.outer(sd, sd), atol=0.1)
    assert fits[1].runs < fits[0].runs < fits[2].runs


def test_a_curved_valley_is_followed_to_its_end():
    # Rosenbrock: residuals 10 (y - x^2) and 1 - x, least at (1, 1), from (-1.2, 1)
    unknowns = [Unknown("x", -1.2, -3.0, 3.0, "-", turn=1e-6), Unknown("y", 1.0, -3.0, 3.0, "-", turn=1e-6)]

    def valley(values):
        x, y = values.T
        return np.stack([10 * (y - x**2), 1 - x], 1)

    found = fit(unknowns, valley, np.zeros(2), np.ones(2), loss=LEAST_SQUARES, steps=Steps(iterations=40, tolerance=1e-10))
    np.testing.assert_allclose(found.scaled, [1, 1], atol=1e-4)
    assert found.batches < 60 and not found.notes


def test_several_starts_find_the_frequency_that_one_misses():
    # from 25 1/s the swings of 10 1/s are out of step: a local minimum; starts over the range find it
    unknowns = [Unknown("frequency", 25.0, 3.0, 30.0, "1/s", "log"), Unknown("decay", 0.3, 0.05, 1.0, "1/s", "log")]
    data, noise = measured(0.05, truth=(10.0, 0.2)), np.full(len(TIMES), 0.05)
    one, many = (fit(unknowns, oscillator, data, noise, starts=k) for k in (1, 8))
    assert abs(one.values["frequency"] - 10) > 1
    assert many.values["frequency"] == pytest.approx(10, rel=0.01)


# ---------------------------------------------------------------- outliers


def test_a_fifth_of_outliers_moves_the_fit_by_less_than_its_error():
    # a fifth of the data 20 noises off, all to one side: of 40 fits, in standard deviations as stated, the mean shift is at most 0.6
    # (0.3 in 100 recordings, and 0.16 of chance) and the spread is one; least squares is moved by many
    shifts, wrong = [], []
    for seed in range(40):
        random = np.random.default_rng(100 + seed)
        data, noise = measured(0.05, seed), np.full(len(TIMES), 0.05)
        data[random.choice(len(TIMES), len(TIMES) // 5, replace=False)] += 1.0
        for loss, out in ((StudentT(), shifts), (LEAST_SQUARES, wrong)):
            found = fit(OSCILLATOR, oscillator, data, noise, loss=loss)
            out.append((found.scaled - np.log([10, 0.8])) / np.array([*found.sd.values()]))
    assert (np.abs(np.mean(shifts, 0)) < 0.6).all() and (np.abs(np.std(shifts, 0) - 1) < 0.35).all()
    assert np.abs(np.mean(wrong, 0)).max() > 3


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.5, 30))
def test_the_scale_is_the_likeliest_and_never_below_the_noise(seed, dof):
    residual = np.random.default_rng(seed).standard_t(3, 50) * 3
    loss = StudentT(dof)
    scale = loss.scale(residual)
    assert scale >= 1
    for other in (0.97 * scale, 1.03 * scale):
        if other >= 1:
            assert loss.cost(residual, scale) <= loss.cost(residual, other) + 1e-6


def test_weights_are_the_slope_of_the_cost():
    # d cost / d r = w r
    residual, step = np.linspace(-6, 6, 13), 1e-6
    loss = StudentT()
    for k, weight in enumerate(loss.weights(residual, 1.7)):
        turned = np.eye(13)[k] * step
        slope = (loss.cost(residual + turned, 1.7) - loss.cost(residual - turned, 1.7)) / (2 * step)
        assert slope == pytest.approx(weight * residual[k], abs=1e-8)


def test_data_without_noise_figure_are_not_heard():
    data, noise = measured(0.05), np.full(len(TIMES), 0.05)
    data[200:], noise[200:] = np.nan, np.inf
    found = fit(OSCILLATOR, oscillator, data, noise)
    assert found.values["frequency"] == pytest.approx(10, rel=0.02)
    assert np.isnan(found.prediction[200:]).all() and not found.weights[200:].any()


# ---------------------------------------------------------------- bounds and priors


def test_a_parameter_beyond_its_bound_ends_there_and_is_named():
    unknowns = [Unknown("frequency", 8.0, 3.0, 9.0, "1/s"), Unknown("decay", 1.0, 0.05, 20.0, "1/s", "log")]
    found = fit(unknowns, oscillator, measured(0.05), np.full(len(TIMES), 0.05))
    assert found.values["frequency"] == 9.0
    assert found.at_bounds == ("frequency",)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_bounded_least_squares_is_that_of_scipy(seed):
    from scipy.optimize import lsq_linear

    random = np.random.default_rng(seed)
    matrix, data = random.normal(size=(20, 4)), random.normal(size=20) * 3
    found = fit(free(4, low=-0.3, high=0.3), linear(matrix), data, np.ones(20), loss=LEAST_SQUARES, steps=Steps(40, tolerance=1e-9))
    expected = lsq_linear(matrix, data, (-0.3, 0.3), tol=1e-12).x
    assert found.costs[-1] == pytest.approx(0.5 * ((matrix @ expected - data) ** 2).sum(), abs=1e-6)


def test_what_the_data_do_not_say_keeps_its_prior_and_is_named():
    matrix = np.array([[1.0, 1.0, 0.0]] * 10)  # only the sum of two of three
    told = [Unknown("a", 0.0, -9.0, 9.0, "-", prior=(1.0, 0.5)), *free(2)]
    found = fit(told, linear(matrix), np.full(10, 3.0), np.full(10, 0.1), loss=LEAST_SQUARES)
    assert found.values["a"] == pytest.approx(1, abs=0.03) and found.values["p0"] == pytest.approx(2, abs=0.03)
    assert found.unconstrained == ("a", "p1")
    # var(p0) = var(a) + var(sum) = 0.25 + 0.001
    np.testing.assert_allclose(found.covariance[1, 1], 0.251, rtol=1e-6)


def test_data_that_move_together_count_for_fewer():
    noise = np.full(len(TIMES), 0.05)
    all_of_them, tenth = (fit(OSCILLATOR, oscillator, measured(0.05), noise, independent=k) for k in (None, 40))
    np.testing.assert_allclose(tenth.covariance, 10 * all_of_them.covariance, rtol=0.02)


# ---------------------------------------------------------------- runs that diverge


def diverging(beyond):
    def simulate(values):
        return np.where(values[:, :1] > beyond, np.nan, oscillator(values))

    return simulate


def test_trials_and_differences_that_diverge_are_gone_round():
    unknowns = [Unknown("frequency", 8.0, 3.0, 30.0, "1/s", "log", turn=0.02), OSCILLATOR[1]]
    found = fit(unknowns, diverging(10.1), measured(0.05), np.full(len(TIMES), 0.05))
    assert found.values["frequency"] == pytest.approx(10, rel=0.01)
    edge = fit(unknowns, diverging(8.05), measured(0.05), np.full(len(TIMES), 0.05))  # half of a difference from there
    assert 8 <= edge.values["frequency"] <= 8.05


def test_starts_that_diverge_are_dropped_with_a_note_and_all_of_them_raise():
    starts = np.array([[8.0, 1.0], [20.0, 1.0]])
    found = fit(OSCILLATOR, diverging(12), measured(0.05), np.full(len(TIMES), 0.05), starts=starts)
    assert found.values["frequency"] == pytest.approx(10, rel=0.01)
    assert found.notes == ("start dropped, its run diverged: frequency 20, decay 1",)
    with pytest.raises(AllDiverged, match="of every start its run diverged: frequency 8, decay 1; frequency 20, decay 1") as caught:
        fit(OSCILLATOR, diverging(5), measured(0.05), np.full(len(TIMES), 0.05), starts=starts)
    np.testing.assert_allclose(caught.value.values, starts)
    alone = [u.__class__(**{**vars(u), "value": v}) for u, v in zip(OSCILLATOR, (8.0, 1.0), strict=True)]
    with pytest.raises(AllDiverged, match="all its differences"):
        fit(alone, lambda v: np.where((v == v[:1]).all() & (len(v) == 1), oscillator(v), np.nan), measured(0.05), np.full(len(TIMES), 0.05))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(unknowns=[]), "at least one"),
        (dict(unknowns=[OSCILLATOR[0]] * 2), "a name each"),
        (dict(data=np.zeros((2, 2))), "one shape"),
        (dict(noise=np.zeros(len(TIMES))), "noise must be > 0"),
        (dict(noise=np.full(len(TIMES), np.inf)), "finite for some"),
        (dict(data=np.full(len(TIMES), np.nan)), "data must be finite where noise is"),
        (dict(simulate=lambda v: np.zeros((len(v), 3))), "simulate must return shape"),
        (dict(starts=0), "starts must be at least 1"),
        (dict(starts=np.array([[99.0, 1.0]])), "within the bounds"),
        (dict(independent=0), "independent must be > 0"),
        (dict(jacobian=lambda v: np.zeros(3)), "jacobian must return"),
    ],
)
def test_bad_input_is_refused(change, message):
    asked = dict(unknowns=OSCILLATOR, simulate=oscillator, data=measured(0.05), noise=np.full(len(TIMES), 0.05)) | change
    rest = {k: asked.pop(k) for k in ("starts", "independent", "jacobian") if k in asked}
    with pytest.raises(ValueError, match=message):
        fit(*asked.values(), **rest)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(scale="square"), "scale of e must be"),
        (dict(low=3.0), r"e must lie in \[3.0, 5.0\] Pa, got 2.0"),
        (dict(low=0.0, scale="log"), "low end must be > 0"),
        (dict(high=-1.0), "low < high"),
        (dict(prior=(0.0, 0.0)), "prior of e"),
        (dict(turn=0.0), "turn of e"),
    ],
)
def test_an_unknown_that_means_nothing_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        Unknown(**(dict(name="e", value=2.0, low=1.0, high=5.0, unit="Pa") | change))


# ---------------------------------------------------------------- ensembles


def test_points_fill_the_prior():
    # of a normal prior, bounds far: mean and spread of 256 points of a Sobol sequence within a hundredth; even within the bounds otherwise
    unknowns = [Unknown("a", 1.0, 1e-4, 1e4, "Pa", "log", prior=(0.0, 1.0)), Unknown("b", 0.0, -1.0, 3.0, "m")]
    points = spread(unknowns, 256, seed=3)
    assert np.log(points[:, 0]).mean() == pytest.approx(0, abs=0.02) and np.log(points[:, 0]).std() == pytest.approx(1, abs=0.02)
    assert (np.histogram(points[:, 1], 16, (-1, 3))[0] == 16).all()
    np.testing.assert_array_equal(points, spread(unknowns, 256, seed=3))
    found = members(unknowns, 24, choices={"bending": ("quadratic", "cubic")}, seed=1)
    assert sorted(found[0]) == ["a", "b", "bending"] and 10 <= sum(m["bending"] == "cubic" for m in found) <= 14


def test_what_a_fit_absorbs_is_not_unpredictable():
    # members differ by a shift of the frequency (absorbed) and by a wave of their own after 1 s, of standard deviation 0.2 at its crests
    random = np.random.default_rng(5)
    reference = oscillator(np.array([[10.0, 0.8]]))[0]
    turned = oscillator(np.array([[10.001, 0.8]]))[0]
    jacobian = ((turned - reference) / np.log(1.0001))[:, None]
    shift = random.normal(0, 0.02, 64)
    wave = np.where(TIMES > 1, np.sin(40 * TIMES), 0.0)
    runs = reference + np.outer(shift, jacobian[:, 0]) + np.outer(random.normal(0, 0.2, 64), wave)
    runs[7] = np.nan
    found = predictability(runs, reference, jacobian, np.full(len(TIMES), 0.01), block=np.zeros(len(TIMES)), time=TIMES, width=0.1)
    assert 7 not in found.members and len(found.members) == 63
    assert found.spread[TIMES < 0.6].max() < 0.01  # smoothing reaches 0.4 s back
    assert found.spread[TIMES > 1.2] == pytest.approx(0.2 / np.sqrt(2), rel=0.25)  # 63 members: 9 %; the waves' phase in 0.1 s: 10 %
    np.testing.assert_allclose(found.shifts[:, 0], np.delete(shift, 7), atol=0.01)
    np.testing.assert_allclose(found.weight, 1 / (0.01**2 + found.spread**2))


def test_absorption_leaves_nothing_of_what_lies_in_the_jacobian_and_all_that_is_across():
    random = np.random.default_rng(0)
    jacobian, sd = random.normal(size=(30, 3)), random.uniform(0.5, 2, 30)
    shift = random.normal(size=(5, 3))
    shifts, left = absorbed(shift @ jacobian.T, jacobian, sd)
    np.testing.assert_allclose(shifts, shift, atol=1e-10)
    np.testing.assert_allclose(left, 0, atol=1e-10)
    across = random.normal(size=30)
    weighted = jacobian / sd[:, None] ** 2
    across -= jacobian @ np.linalg.solve(weighted.T @ jacobian, weighted.T @ across)
    np.testing.assert_allclose(absorbed(across[None], jacobian, sd)[1][0], across, atol=1e-10)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0, 3))
def test_smoothing_keeps_what_is_constant_and_blocks_apart(seed, width):
    random = np.random.default_rng(seed)
    block, time = random.integers(0, 3, 60), random.integers(0, 10, 60)
    np.testing.assert_allclose(smoothed(np.full(60, 2.5), block, time, width), 2.5)
    squares = np.where(block == 1, random.random(60) + 10, random.random(60))
    found = smoothed(squares, block, time, width)
    assert (found[block == 1] >= 10).all() and (found[block != 1] <= 1).all()


def test_too_few_members_are_refused():
    kept = np.zeros((5, 4))
    kept[1:3] = np.nan
    with pytest.raises(ValueError, match="at least 4 members must not diverge, got 3 of 5"):
        predictability(kept, np.zeros(4), np.zeros((4, 1)), np.ones(4), block=np.zeros(4), time=np.zeros(4), width=0)
    with pytest.raises(ValueError, match="must share R"):
        predictability(np.zeros((5, 4)), np.zeros(3), np.zeros((4, 1)), np.ones(4), block=np.zeros(4), time=np.zeros(4), width=0)


def test_starts_are_led_over_a_part_of_the_data_and_such_as_meet_are_kept_once():
    # cos(w t) over a long time has a valley in w at every beat; over a short one (w t < pi) it has one, at the true w
    time = np.linspace(0, 20, 200)
    unknown = (Unknown("w", 3.0, 0.5, 6.0, "1/s", prior=(3.0, 2.0)),)
    data, starts = np.cos(2.0 * time), np.array([[0.8], [1.2], [2.9], [3.4]])

    def until(count):
        return lambda values: np.cos(values * time[None, :count])

    astray = fit(unknown, until(200), data, np.full(200, 0.1), starts=starts[2:], steps=Steps(iterations=20)).values["w"]
    assert abs(astray - 2.0) > 0.1
    led = narrowed(unknown, until(15), data[:15], np.full(15, 0.1), starts=starts, steps=Steps(iterations=6, halving=1, kept=3))
    assert len(led) == 1 and np.allclose(led, 2.0, atol=0.02)  # the valley of all 20 s is 0.15 wide on either side
    assert np.isclose(fit(unknown, until(200), data, np.full(200, 0.1), starts=led).values["w"], 2.0, atol=1e-4)
