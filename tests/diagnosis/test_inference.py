"""The inference on linear bodies whose errors have a known covariance: what is true of it does not depend on any simulator."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import binom, chi2, invgamma, kstest, multivariate_t
from scipy.stats import t as student_t
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.effects import Amount, Candidate, Effect, effects
from twinbench.diagnosis.inference.absorption import absorb
from twinbench.diagnosis.inference.amounts import Scale
from twinbench.diagnosis.inference.budget import budget, detectable
from twinbench.diagnosis.inference.controls import Controls
from twinbench.diagnosis.inference.covariance import Layout, Prior, Scatter, chosen
from twinbench.diagnosis.inference.likelihood import Likelihood, log_gain
from twinbench.diagnosis.inference.phases import _refuted
from twinbench.diagnosis.inference.refit import begun, gained, refitted
from twinbench.diagnosis.inference.scan import Score, Signature, score, usual_errors
from twinbench.diagnosis.inference.search import Asked, Search
from twinbench.diagnosis.inference.significance import misfits, predictive, significance, unexplained
from twinbench.diagnosis.inference.slopes import corrected
from twinbench.diagnosis.inference.trials import Trials, _in_order, _in_other_shapes, _likely, chances_of
from twinbench.physics.parameters import Parameter

REGIONS, TIMES, MEMBERS = 4, 5, 10
SIZE = 3 * REGIONS * TIMES
NOISE, ERROR = 3e-4, 2e-3  # m
PRIOR = Prior(8.0, 0.3, 0.3)
NOWHERE = (np.full(3, -10.0), np.full(3, 10.0))  # bounds that nothing meets


def layout(held_out=0):
    time, region, axis = (a.ravel() for a in np.meshgrid(np.arange(TIMES), np.arange(REGIONS), np.arange(3), indexing="ij"))
    place = np.stack([0.05 * region, 0 * region, 0 * region], 1)
    return Layout(np.zeros(SIZE, int), place, 0.25 * time, axis, time < TIMES - held_out)


def effect(name="wind", low=-100.0):
    return Effect(name, "environment", "the air moves", None, ("solid",), (Amount("push", 1.0, low, 100.0, "mm"),))


def signature(column, name="wind", low=-100.0):
    """Scaled to 1 mm RMS of places, as those of twins are."""
    column = column / (1e3 * np.sqrt(3 * np.mean(column**2)))
    return Signature(Candidate(effect(name, low), {}), column[:, None], np.ones(1), np.full(1, 20.0))


class World:
    """Sound twins J p + e, e normal with a smooth covariance; block means with white noise; signatures drawn from the same smooth field."""

    def __init__(self, seed, candidates=8, growth=0.0):
        self.random = np.random.default_rng(seed)
        self.layout = layout()
        amplitude = ERROR * (1 + growth * self.layout.time)
        self.factor = np.linalg.cholesky(amplitude[:, None] * self.layout.kernel(0.4, 0.4) * amplitude + 1e-12 * np.eye(SIZE))
        self.slopes = 0.01 * np.linalg.cholesky(self.layout.kernel(2.0, 1.0) + 1e-9 * np.eye(SIZE)) @ self.random.normal(size=(SIZE, 3))
        self.reference = self.random.normal(size=SIZE)
        self.catalogue = [signature(self.factor @ self.random.normal(size=SIZE), f"effect {k}") for k in range(candidates)]

    def sound(self, count):
        shifts = 0.5 * self.random.normal(size=(count, 3))
        return self.reference + shifts @ self.slopes.T + self.random.normal(size=(count, SIZE)) @ self.factor.T

    def noise(self, *shape):
        return NOISE * self.random.normal(size=(*shape, SIZE))

    def run(self, shifts):
        return self.reference + shifts @ self.slopes.T

    def evidence(self, measured):
        runs = np.concatenate([self.sound(MEMBERS), measured[None]])
        left, _ = absorb(runs, self.reference, self.slopes, np.full(SIZE, NOISE), self.run, NOWHERE, rounds=2)
        scatter = Scatter(left[:-1], NOISE**2 * np.eye(SIZE), self.slopes, np.zeros((SIZE, 0)), self.layout)
        return scatter, left[-1], left[:-1] + self.noise(MEMBERS)

    def asked(self, measured):
        scatter, residual, noisy = self.evidence(measured)
        return significance(scatter, PRIOR, residual, noisy, self.catalogue, np.ones(SIZE))


@pytest.fixture(scope="module")
def controls():
    """Tests of 60 sound recordings, each with members of its own."""
    found = []
    for seed in range(60):
        world = World(seed, growth=1.0)
        found.append(world.asked(world.sound(1)[0] + world.noise()))
    return found


def test_p_values_of_sound_recordings_are_uniform(controls):
    # Kolmogorov and Smirnov's distance of 60 from the uniform distribution; both are p-values by themselves
    assert kstest([t.p_misfit for t in controls], "uniform").pvalue > 0.01
    assert kstest([t.p_scan for t in controls], "uniform").pvalue > 0.01


def test_the_smaller_of_two_p_values_does_not_alarm_too_often(controls):
    # of 120 at a level of 10 %, more than binom.isf(0.001) would be no chance
    assert sum(t.p < 0.1 for t in controls) <= binom.isf(1e-3, 60, 0.1)


@pytest.mark.long
@pytest.mark.parametrize("candidates", [3, 40])
def test_the_best_of_many_candidates_keeps_its_level(candidates):
    from scipy.stats import norm

    tests = []
    for seed in range(40):
        world = World(1000 + seed, candidates)
        tests.append(world.asked(world.sound(1)[0] + world.noise()))
    assert sum(t.p_scan < 0.1 for t in tests) <= binom.isf(1e-3, 40, 0.1)
    if candidates == 40:  # what is forgotten otherwise: the best of forty, taken for the only one that was asked
        assert sum(norm.sf(t.largest) < 0.1 for t in tests) > binom.isf(1e-3, 40, 0.1)


def test_without_whitening_sound_recordings_alarm():
    world = World(5)
    alarms = [chi2.sf(np.sum(((world.evidence(world.sound(1)[0] + world.noise())[1]) / NOISE) ** 2), SIZE) < 1e-3 for _ in range(10)]
    assert all(alarms)


def test_an_effect_is_found_and_its_size_told():
    world = World(3)
    column = world.catalogue[5].columns[:, 0]
    found = world.asked(world.sound(1)[0] + 12 * column + world.noise())
    assert found.p < 1e-3
    best = max(found.scores, key=lambda s: s.log_evidence)
    assert best.name == "effect 5"
    assert best.sizes[0] == pytest.approx(12, rel=0.25)


def test_absorption_leaves_nothing_where_members_differ_by_parameters_alone():
    # f(p) = f0 + J p + p1^2 q: one linear step leaves the square, a second from where it led leaves its square
    world = World(1)
    bend = 3e-3 * world.random.normal(size=SIZE)

    def run(shifts):
        return world.run(shifts) + shifts[:, :1] ** 2 * bend

    shifts = 0.3 * world.random.normal(size=(MEMBERS, 3))
    sd = np.full(SIZE, NOISE)
    once, _ = absorb(run(shifts), world.reference, world.slopes, sd, run, NOWHERE, rounds=1)
    often, found = absorb(run(shifts), world.reference, world.slopes, sd, run, NOWHERE, rounds=5)
    assert np.abs(often).max() < 1e-5 < np.abs(once).max()  # of some 10 mm that they moved
    assert np.abs(found - shifts).max() < 1e-2


def test_absorption_arrives_where_full_steps_overshoot():
    # f(p) = f0 + J sinh(4 p) / 4: to p = 0.5 the slopes at 0 lead a full step to 0.9, five times too far off in f
    world = World(1)

    def run(shifts):
        return world.run(np.sinh(4 * shifts) / 4)

    shifts = 0.5 * np.sign(world.random.normal(size=(MEMBERS, 3)))
    runs, sd = run(shifts), np.full(SIZE, NOISE)
    left, _ = absorb(runs, run(np.zeros((1, 3)))[0], world.slopes, sd, run, NOWHERE, rounds=6)
    before = np.sqrt(np.mean((runs - world.reference) ** 2, 1))
    assert (np.sqrt(np.mean(left**2, 1)) < 0.1 * before).all()


def test_what_is_not_fitted_is_not_absorbed_but_predicted():
    world = World(2)
    shifts = 0.3 * world.random.normal(size=(MEMBERS, 3))
    runs = world.run(shifts)
    held = world.layout.time > 1.0
    runs[:, held] += 0.05  # of which the fitted frames know nothing
    sd = np.where(held, np.inf, NOISE)
    left, _ = absorb(runs, world.reference, world.slopes, sd, world.run, NOWHERE, rounds=2)
    assert left[:, held] == pytest.approx(0.05, abs=2e-4)
    assert np.abs(left[:, ~held]).max() < 1e-4


def test_a_recording_against_itself_is_nothing():
    world = World(4)
    scatter, _, noisy = world.evidence(world.reference)
    found = significance(scatter, PRIOR, np.zeros(SIZE), noisy, world.catalogue, np.ones(SIZE))
    assert found.misfit == 0
    assert found.p > 0.9
    assert all(s.log_evidence <= 0 and s.sizes == (0.0,) for s in found.scores)


def test_the_covariance_tells_members_that_it_has_not_seen():
    # mean of x' C^-1 x / B of members left out: 1 where C is right; d / (d - 2) of a Student t is within that
    world = World(6, growth=1.0)
    scatter, _, _ = world.evidence(world.reference)
    likelihood = scatter.likelihood(PRIOR)
    fresh = World(6, growth=1.0).factor @ np.random.default_rng(0).normal(size=(SIZE, 200)) + world.noise(200).T
    ratio = np.mean([likelihood.misfit(row) for row in fresh.T]) / SIZE
    assert 0.6 < ratio < 1.6


def test_what_any_recording_is_off_by_is_no_alarm():
    # a recording that is 2 standard deviations off in a way in which no member is: an alarm, unless any recording may be off in that way
    amount = replace(effect().amounts[0], usual=0.5)
    world = World(7)
    way = signature(world.factor @ world.random.normal(size=SIZE))  # 1 mm RMS for an amount of 1
    known = [replace(way, candidate=Candidate(replace(effect(), amounts=(amount,)), {}), columns=2 * way.columns, unit=np.full(1, 2.0))]
    usual = usual_errors(known, np.zeros(SIZE, int))
    np.testing.assert_allclose(usual, 0.5 * way.columns, rtol=1e-12)
    measured = world.sound(1)[0] + world.noise() + 20 * usual[:, 0]  # 10 mm
    scatter, residual, noisy = world.evidence(measured)
    catalogue = [*world.catalogue, way]
    asked = [significance(s, PRIOR, residual, noisy, catalogue, np.ones(SIZE)).p for s in (scatter, replace(scatter, usual=10 * usual))]
    assert asked[0] < 0.01 < 0.1 < asked[1]


def test_usual_errors_are_of_each_recording_by_itself():
    # columns of two recordings: what is usual in one says nothing of the other, and amounts that are not usual have none
    amounts = (Amount("raise", 1.0, -9.0, 9.0, "m", 0.5), Amount("push", 1.0, -9.0, 9.0, "N"))
    one = Signature(Candidate(replace(effect(), amounts=amounts), {}), np.arange(8.0).reshape(4, 2), np.array([2.0, 1.0]), np.ones(2))
    expected = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 1.0], [0.0, 1.5]])  # column / unit * usual, rows of recordings 0 0 1 1
    np.testing.assert_array_equal(usual_errors([one], np.array([0, 0, 1, 1])), expected)
    assert usual_errors([], np.array([0, 0, 1, 1])).shape == (4, 0)


def test_the_prior_that_is_chosen_fades_as_errors_do():
    # errors that are smooth in time and space are likelier under a smooth prior than under one without neighbours, and rough ones not
    world = World(8)
    scatter, _, noisy = world.evidence(world.reference)
    smooth = chosen(scatter, DiagnosisConfig(), noisy)
    rough = ERROR * world.random.normal(size=(MEMBERS, SIZE))
    plain = chosen(replace(scatter, left=rough), DiagnosisConfig(), rough)
    assert smooth.memory > 0 and smooth.reach > 0
    assert (plain.memory, plain.reach) == (0.0, 0.0)


def test_the_density_is_a_student_t():
    random = np.random.default_rng(0)
    root = random.normal(size=(5, 5))
    x = random.normal(size=5)
    own = Likelihood.of(root @ root.T, 4.0)
    assert own.log_density(x) == pytest.approx(multivariate_t.logpdf(x, shape=root @ root.T, df=4.0))


def test_the_evidence_of_a_linear_effect_is_that_of_a_wider_covariance():
    # x ~ C + S V S' over x ~ C
    random = np.random.default_rng(1)
    root, s, spread = random.normal(size=(6, 6)), random.normal(size=(6, 2)), np.array([2.0, 0.5])
    x, scale = random.normal(size=6), root @ root.T
    wider = Likelihood.of(scale + (s * spread**2) @ s.T, 7.0)
    own = Likelihood.of(scale, 7.0)
    likelier = wider.log_density(x, guarded=True) - own.log_density(x, guarded=True)
    assert log_gain(own.whitened(x), own.whitened(s * spread), 7.0) == pytest.approx(likelier)


@pytest.mark.parametrize("size, degrees, misfit", [(5, 6.0, 3.0), (200, 14.0, 20.0), (230, 14.0, 600.0)])
def test_a_guarded_density_is_that_of_scales_of_one_and_more(size, degrees, misfit):
    # integral over s >= 1 of N(x; 0, s) and an inverse gamma distribution; its fall by the misfit is half of the expected 1 / s
    own = Likelihood.of(np.eye(size), degrees)

    def mixed(square, power=0):
        def part(u):  # s = exp(u); what is largest is taken out
            return np.exp(
                u + invgamma.logpdf(np.exp(u), degrees / 2, scale=degrees / 2) - (size / 2 + power) * u - square / 2 * np.expm1(-u)
            )

        whole = quad(part, 0, 12, limit=500, points=(0.05, 0.3, 1.0, 3.0))[0]
        return np.log(whole) - square / 2 - size / 2 * np.log(2 * np.pi) - invgamma.logsf(1, degrees / 2, scale=degrees / 2)

    x = np.full(size, np.sqrt(misfit / size))
    assert own.log_density(x, guarded=True) == pytest.approx(mixed(misfit), abs=1e-6)
    assert own.weight(misfit, size) == pytest.approx(np.exp(mixed(misfit, 1) - mixed(misfit)), rel=1e-6)


def test_a_guard_holds_where_the_gamma_function_is_below_what_a_double_can_be():
    # n numbers of no misfit: x = 0 has the density of s = 1 as n grows, (2 pi)^(-n / 2), but for what changes as log n does
    logs = [Likelihood.of(np.eye(n), 14.0).log_density(np.zeros(n), guarded=True) + n / 2 * np.log(2 * np.pi) for n in (2000, 4000)]
    assert np.isfinite(logs).all() and logs[0] - logs[1] == pytest.approx(np.log(2), rel=0.02)


def test_what_members_get_of_an_effect_by_chance_is_no_evidence_on_average():
    # of x ~ C with a white floor far above what it really is: the mean Bayes factor of effects is 1 or less, while the plain t's is huge
    random = np.random.default_rng(3)
    smooth = np.cumsum(random.normal(size=(60, 60)), 0) / 8  # errors that fade slowly: what effects look like too
    own = Likelihood.of(smooth @ smooth.T + 4.0 * np.eye(60), 14.0)
    errors, ways = smooth @ random.normal(size=(60, 400)), np.cumsum(random.normal(size=(60, 30)), 0)
    white = own.whitened(errors).T
    assert np.mean(np.sum(white**2, 1)) < 20  # of 60
    logs = np.array([[log_gain(x, own.whitened(way[:, None]), own.degrees) for way in ways.T] for x in white])
    assert np.exp(logs).mean() <= 1.0


class Bent:
    """Twins whose one effect is not linear in its amount: 20 mm of it make a fifth more than twenty of 1 mm."""

    def __init__(self, world, column, bend=0.01, dear=np.inf):
        self.bend, self.dear, self.cost = bend, dear, SimpleNamespace(runs=0)
        self.world, self.column, self.unknowns = world, column, [SimpleNamespace(name=f"p{k}") for k in range(3)]
        self.bounds = NOWHERE

    def values(self, shift):
        return {u.name: s for u, s in zip(self.unknowns, shift, strict=True)}

    def with_effects(self, candidates):
        return self

    def at(self, shifts, more):
        return self.rows([{**self.values(shifts), **more}])

    def fitted_alone(self, reference):
        return self

    def steps(self, row):
        return 1 if row.get("push", 0.0) < self.dear else 100

    def rows(self, rows):
        self.cost.runs += len(rows)
        shifts = np.array([[r[u.name] for u in self.unknowns] for r in rows])
        push = np.array([r.get("push", 0.0) for r in rows])[:, None]
        return self.world.run(shifts) + push * (1 + self.bend * push) * self.column


def test_a_refit_agrees_with_the_score_where_effects_are_small_and_corrects_it_where_not():
    world = World(9)
    one = world.catalogue[0]
    twins = Bent(world, one.columns[:, 0])
    scatter, _, _ = world.evidence(world.reference)
    rows = np.arange(SIZE)
    fitting, marginal = scatter.likelihood(PRIOR, parameters=False), scatter.likelihood(PRIOR)
    for push, off in ((0.5, 0.01), (15.0, 0.02)):
        data = twins.rows([dict(p0=0.3, p1=0.0, p2=-0.2, push=push)])[0]
        config = DiagnosisConfig(steps=6)
        found = refitted(twins, Asked(data, world.reference, world.slopes, fitting, rows), one, config)
        linear = score(marginal, data - world.reference, one)
        assert found.amounts[0] == pytest.approx(push, rel=off, abs=3 * off * found.sd[0])
        if push < 1:
            assert linear.sizes[0] == pytest.approx(found.amounts[0], rel=0.05)


def test_the_evidence_of_a_refit_is_that_of_the_linear_effect_where_all_is_normal():
    # Laplace's approximation is exact for a normal distribution (a Student t of many degrees) and an effect that is linear
    world = World(10)
    one = world.catalogue[0]
    twins = Bent(world, one.columns[:, 0], bend=0.0)
    scatter, _, _ = world.evidence(world.reference)
    fitting, marginal = (replace(scatter.likelihood(PRIOR, parameters=p), degrees=1e8) for p in (False, True))
    data = twins.rows([dict(p0=0.3, p1=0.0, p2=-0.2, push=2.0)])[0]
    given = (twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)))
    found, sound = (refitted(*given, what, DiagnosisConfig()) for what in (one, None))
    linear = score(marginal, data - world.reference, one)
    assert found.log_evidence - sound.log_evidence == pytest.approx(linear.log_evidence, abs=1e-3)


@pytest.mark.long
def test_intervals_of_amounts_cover():
    """90 % intervals of an amount, of 100 recordings with errors of their own, none of which another one shares members with.

    By the curvature alone they hold 77. A binomial's 1 % quantile is between.
    """
    wide, inside = student_t.ppf(0.95, MEMBERS), []
    for seed in range(100):
        world = World(3000 + seed)
        one = world.catalogue[0]
        twins = Bent(world, one.columns[:, 0], bend=0.0)
        scatter, _, noisy = world.evidence(world.reference)
        data = twins.rows([dict(p0=0.3, p1=0.0, p2=-0.2, push=2.0)])[0] + world.sound(1)[0] - world.reference + world.noise()
        sound = list(zip(scatter.left_out(PRIOR, parameters=False), noisy, strict=True))
        given = (twins, Asked(data, world.reference, world.slopes, scatter.likelihood(PRIOR, parameters=False), np.arange(SIZE)), one)
        found = [refitted(*given, DiagnosisConfig(), *more) for more in ((), (sound,))]
        inside.append([abs(f.amounts[0] - 2.0) < w * f.sd[0] for f, w in zip(found, (1.645, wide), strict=True)])
    least = binom.ppf(0.01, 100, 0.9)
    assert np.sum(inside, 0)[1] >= least > np.sum(inside, 0)[0]


def test_a_refit_goes_no_farther_than_steps_are_affordable():
    # an effect of 15 mm, of which 8 mm and more take a hundred times the steps: the refit stays below and says what it can there
    world = World(9)
    one = world.catalogue[0]
    twins = Bent(world, one.columns[:, 0], dear=8.0)
    scatter, _, _ = world.evidence(world.reference)
    data = twins.rows([dict(p0=0.3, p1=0.0, p2=-0.2, push=15.0)])[0]
    fitting = scatter.likelihood(PRIOR, parameters=False)
    found = refitted(
        twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)), one, DiagnosisConfig(steps=6, dearest=4.0)
    )
    assert 0.5 < found.amounts[0] < 8.0 and np.isfinite(found.prediction).all()
    before = twins.cost.runs
    refitted(twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)), one, DiagnosisConfig(runs=5))
    assert (
        5 <= twins.cost.runs - before <= 5 + 10 + 7
    )  # amounts are scaled by ten runs, and a step that has begun is ended: three trials, four slopes


def test_a_refit_that_cannot_come_near_its_rival_is_given_up():
    # 15 mm of an effect: of a rival that is 29 nats ahead of where it ends it does not hear; one that is 31 ahead of where its slopes lead
    # ends it before its first step
    world = World(9)
    one = world.catalogue[0]
    twins = Bent(world, one.columns[:, 0])
    data = twins.rows([dict(p0=0.3, p1=0.0, p2=-0.2, push=15.0)])[0]
    fitting = world.evidence(world.reference)[0].likelihood(PRIOR, parameters=False)
    given = (twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)), one, DiagnosisConfig(behind=30.0))

    def raced(reach):
        before = twins.cost.runs
        return refitted(*given, reach=reach), twins.cost.runs - before

    whole, most = raced(-np.inf)
    near, same = raced(whole.log_evidence + 29.0)
    assert same == most and near.log_evidence == whole.log_evidence and near.amounts[0] == whole.amounts[0]
    search = Search.of(*given)
    nothing = search.place(np.zeros(search.size), world.reference)
    step, _ = search.step(nothing, search.slopes, search.low, search.high)
    led = -search.place(step, nothing.prediction + search.slopes @ step).cost
    assert led > -nothing.cost + 50
    ended, fewest = raced(led + 31.0)
    assert ended.log_evidence == pytest.approx(led) and fewest < same and np.isfinite(ended.prediction).all()
    assert np.array_equal(ended.shift, np.zeros(3)) and ended.amounts[0] == 0.0  # as it began


class Stopped(Bent):
    """Of the last 30 numbers, which are not fitted, ``after`` is told where runs are stopped; in whole runs ``far`` N and more diverge."""

    def __init__(self, *given, far=np.inf, after=None):
        super().__init__(*given)
        self.given, self.far, self.after, self.whole = given, far, after, 0

    def fitted_alone(self, reference):
        self.short = Stopped(*self.given, after=reference)
        self.short.cost = self.cost
        return self.short

    def rows(self, rows):
        self.whole += len(rows)
        found = super().rows(rows)
        if self.after is not None:
            return np.concatenate([found[:, :-30], np.tile(self.after[-30:], (len(rows), 1))], 1)
        return np.where(np.array([r.get("push", 0.0) for r in rows])[:, None] >= self.far, np.nan, found)


def test_a_refit_runs_through_what_is_not_fitted_once():
    # what is not fitted tells nothing: the same numbers with and without it; the prediction there is that of a whole run all the same
    world = World(13)
    one = world.catalogue[0]
    scatter, _, _ = world.evidence(world.reference)
    rows = np.arange(SIZE - 30)
    fitting = scatter.only(rows).likelihood(PRIOR, parameters=False)
    data = Bent(world, one.columns[:, 0]).rows([dict(p0=0.3, p1=0.0, p2=-0.2, push=5.0)])[0]

    def found(twins):
        return refitted(twins, Asked(data, world.reference, world.slopes, fitting, rows), one, DiagnosisConfig(steps=6))

    usual, twins = found(Bent(world, one.columns[:, 0])), Stopped(world, one.columns[:, 0])
    own = found(twins)
    assert twins.whole == 1 < twins.short.whole
    np.testing.assert_array_equal(own.prediction[rows], usual.prediction[rows])
    np.testing.assert_allclose(own.prediction[-30:], data[-30:], atol=1e-4)  # 0.1 mm, of 5 mm
    assert own.amounts[0] == usual.amounts[0] == pytest.approx(5.0, rel=0.01)
    # where it diverges later, all frames are run all along, and the refit stays where they do not
    twins = Stopped(world, one.columns[:, 0], far=4.0)
    stays = found(twins)
    assert twins.whole > 1 and stays.amounts[0] < 4.0 and np.isfinite(stays.prediction).all()


class Placed(Bent):
    """Twins whose one effect acts around a place: its share of the column falls with the square of the distance from it over 0.1 m."""

    true = np.array([0.03, -0.02, 0.0])

    def rows(self, rows):
        self.cost.runs += len(rows)
        shifts = np.array([[r[u.name] for u in self.unknowns] for r in rows])
        found = self.world.run(shifts)
        for k, row in enumerate(rows):
            off = np.array([row.get(f"spot_{axis}", 0.0) for axis in "xyz"]) - self.true
            weight = np.exp(-np.square(off[:, None] - 0.05 * self.ways).sum(0) / (2 * 0.1**2))
            found[k] += row.get("push", 0.0) * weight * self.column
        return found


def test_a_refit_finds_the_place_of_an_effect_beside_the_one_that_was_tried():
    # the place that was tried is 36 mm off; what acts there and what the place is are parted by a part of the body that each moves most
    world = World(12)
    placed = replace(effect(), place="spot")
    origin = {f"spot_{axis}": 0.0 for axis in "xyz"}
    one = replace(world.catalogue[0], candidate=Candidate(placed, origin))
    twins = Placed(world, one.columns[:, 0])
    twins.ways = np.random.default_rng(5).normal(size=(3, SIZE))
    scatter, _, _ = world.evidence(world.reference)
    truth = {f"spot_{axis}": c for axis, c in zip("xyz", Placed.true, strict=True)}
    data = twins.rows([dict(p0=0.0, p1=0.0, p2=0.0, push=25.0, **truth)])[0]
    fitting = scatter.likelihood(PRIOR, parameters=False)
    given = (twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)), one)
    found, stuck = refitted(*given, DiagnosisConfig()), refitted(*given, DiagnosisConfig(astray=1e-6))
    assert np.linalg.norm(found.candidate.place - Placed.true) < 0.012 < np.linalg.norm(stuck.candidate.place - Placed.true)
    assert found.log_evidence > stuck.log_evidence + 3
    assert found.amounts.shape == found.sd.shape == (1,)


class MadeUpFor(Bent):
    """Twins whose fit has moved p0 by 4 deviations to make up for the effect: there it does a fifth as much, backwards."""

    def __init__(self, *given):
        super().__init__(*given)
        named = {"grip0_reach": -4.0, "p1": 0.0, "p2": 0.0}
        self.unknowns = [SimpleNamespace(name=name, encode=float, value=told) for name, told in named.items()]
        self.scaled, self.sds = np.zeros(3), np.ones(3)

    def rows(self, rows):
        self.cost.runs += len(rows)
        found = self.world.run(np.array([[r[u.name] for u in self.unknowns] for r in rows]))
        return found + np.array([r.get("push", 0.0) * (-0.2 - 0.3 * r["grip0_reach"]) * self.column for r in rows])


def test_a_refit_begins_at_much_of_an_effect_that_a_little_of_says_nothing_about():
    # p0 does 5 (e + w), the effect 40 e, whitened e and w of one length and at right angles: -4 of p0 leave 20 (e - w), along which p0
    # gains nothing, so that the fit had ended where it is
    world = World(9)
    one = world.catalogue[0]
    scatter, _, _ = world.evidence(world.reference)
    fitting = scatter.likelihood(PRIOR, parameters=False)
    e, w = (fitting.whitened(world.catalogue[k].columns[:, 0]) for k in (0, 1))
    aside = world.catalogue[1].columns[:, 0] - (e @ w) / (e @ e) * one.columns[:, 0]
    aside *= np.linalg.norm(e) / np.linalg.norm(fitting.whitened(aside))
    world.slopes = np.c_[5 * (one.columns[:, 0] + aside), world.slopes[:, 1:]]
    twins = MadeUpFor(world, one.columns[:, 0])
    data = twins.rows([dict(grip0_reach=-4.0, p1=0.0, p2=0.0, push=40.0)])[0]
    given = (twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)))

    hiding = Candidate(replace(effect(low=0.0), hides="grip"), {})
    tried = Signature(hiding, -one.columns, np.full(1, 5.0), np.full(1, 20.0))  # 5 of it make 1 mm where the fit ended
    here, start = begun(*given, [tried], DiagnosisConfig())
    right, stuck = (refitted(*given, tried, DiagnosisConfig(), (), s) for s in (start, None))
    assert here.numbers[0] > -2.0  # about where the fit ended
    assert start.numbers[0] == pytest.approx(-4.0, abs=2.0) and start.numbers[3] > 0  # as it was told, and much of it
    assert right.amounts[0] == pytest.approx(40.0, rel=0.1) and right.shift[0] == pytest.approx(-4.0, rel=0.1)
    assert stuck.amounts[0] < 1.0 and start.log_evidence > stuck.log_evidence + 10  # effects are refitted in the order of starts


class Turning(Bent):
    """Twins with two amounts, a little of which moves a body the other way than much of it does."""

    def rows(self, rows):
        self.cost.runs += len(rows)
        found = self.world.run(np.array([[r[u.name] for u in self.unknowns] for r in rows]))
        for k, row in enumerate(rows):
            for name, column in zip(("push", "pull"), (self.column, self.other), strict=True):
                found[k] += (abs(row.get(name, 0.0)) / 10 - 1) * row.get(name, 0.0) * column
        return found


def test_each_of_several_amounts_is_begun_both_ways():
    # f(a) = a |a| / 10 - a: 25 of it move by 37.5 mm, and from nothing the way down ends at -5, which moves by 2.5
    world = World(9)
    one, other = (world.catalogue[k].columns[:, 0] for k in (0, 1))
    twins = Turning(world, one)
    twins.other = other
    amounts = tuple(Amount(name, 1.0, -100.0, 100.0, "mm") for name in ("push", "pull"))
    tried = Signature(Candidate(replace(effect(), amounts=amounts), {}), -np.c_[one, other], np.ones(2), np.full(2, 20.0))
    scatter, _, _ = world.evidence(world.reference)
    for name, sign in (("push", 1.0), ("pull", -1.0)):
        data = twins.rows([dict(p0=0.0, p1=0.0, p2=0.0) | {name: 25.0 * sign}])[0]
        given = (twins, Asked(data, world.reference, world.slopes, scatter.likelihood(PRIOR, parameters=False), np.arange(SIZE)))
        [start] = begun(*given, [tried], DiagnosisConfig())
        led, k = refitted(*given, tried, DiagnosisConfig(), (), start), ("push", "pull").index(name)
        assert sign * start.numbers[3 + k] > 0 == start.numbers[4 - k]
        assert led.amounts[k] == pytest.approx(25.0 * sign, rel=0.05) and abs(led.amounts[1 - k]) < 1.0


class Paced(Bent):
    """Twins whose one effect has a pace: a power of two of it turns the effect's column by as much of another one."""

    def rows(self, rows):
        self.cost.runs += len(rows)
        found = self.world.run(np.array([[r[u.name] for u in self.unknowns] for r in rows]))
        return found + np.array([r.get("push", 0.0) * (self.column + np.log2(r.get("pace", 1.0)) * self.way) for r in rows])


def test_a_refit_finds_the_pace_of_an_effect_beside_the_one_that_was_tried():
    # the effect is 2.5 times as fast as was tried; one that nothing tells of stays where it was tried, and costs no evidence
    world = World(12)
    law = SimpleNamespace(
        parameters=(Parameter("pace", 1.0, 0.1, 10.0, "s", "how fast", "log"), Parameter("reach", 1.0, 0.1, 9.0, "m", "how far", "log"))
    )
    paced = replace(effect(), term=law, shapes={"pace": (1.0,), "reach": (1.0,)}, within="reach")
    assert paced.forms == ("pace",) and replace(paced, roaming=True).forms == ("pace", "reach")  # in the room no other place is next to it
    one = replace(world.catalogue[0], candidate=Candidate(paced, {"pace": 1.0, "reach": 1.0}))
    scatter, _, _ = world.evidence(world.reference)
    fitting = scatter.likelihood(PRIOR, parameters=False)
    still = dict(p0=0.0, p1=0.0, p2=0.0)

    def found(way, pace, **more):
        twins = Paced(world, one.columns[:, 0])
        twins.way = way
        data = twins.rows([still | dict(push=10.0, pace=pace)])[0]
        return refitted(twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)), one, DiagnosisConfig(**more))

    turned = world.catalogue[1].columns[:, 0]
    right, kept = found(turned, 2.5), found(turned, 2.5, reshaped=1.0)
    assert right.candidate.fixed["pace"] == pytest.approx(2.5, rel=0.1) and right.candidate.fixed["reach"] == 1.0
    assert kept.candidate.fixed["pace"] == 1.0 and right.log_evidence > kept.log_evidence + 3
    blind, plain = found(np.zeros(SIZE), 2.5), found(np.zeros(SIZE), 2.5, reshaped=1.0)
    assert blind.candidate.fixed["pace"] == pytest.approx(1.0) and blind.log_evidence == pytest.approx(plain.log_evidence)


def test_what_hides_is_begun_at_other_shapes_than_the_one_that_is_asked():
    # the true pace is four times the one that is asked; as that is, the effect does what the twin's own slopes do, and is not missed
    world = World(12)
    law = SimpleNamespace(parameters=(Parameter("pace", 1.0, 0.1, 10.0, "s", "how fast", "log"),))
    paced = replace(effect(low=0.0), term=law, shapes={"pace": (1.0,)}, hides="grip")
    one = replace(world.catalogue[0], candidate=Candidate(paced, {"pace": 1.0}))
    twins = Paced(world, one.columns[:, 0])
    twins.way = world.catalogue[1].columns[:, 0]
    scatter, _, _ = world.evidence(world.reference)
    fitting = scatter.likelihood(PRIOR, parameters=False)
    data = twins.rows([dict(p0=0.0, p1=0.0, p2=0.0, push=15.0, pace=4.0)])[0]
    [start] = begun(twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)), [one], DiagnosisConfig())
    assert start.numbers[-1] == 2.0 and start.numbers[3] > 0  # two deviations of a factor of two

    # where it is tried in that shape as well, it is begun in that one, and no other is
    slow, fast = (replace(one, candidate=Candidate(paced, {"pace": pace, "hand": hand})) for pace, hand in ((1.0, 0.0), (4.0, 0.0)))
    asked = Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE))
    [start] = begun(twins, asked, [slow, fast], DiagnosisConfig())
    assert start.signature is fast and start.numbers[-1] == 0.0 and start.numbers[3] > 0
    handed = replace(paced, hand="hand")
    catalogue = [
        replace(one, candidate=Candidate(handed, {"pace": p, "hand": h})) for p, h in ((1.0, 0.0), (1.0, 1.0), (4.0, 0.0), (4.0, 1.0))
    ]
    assert _in_other_shapes(catalogue, 2) == [2, 0] and _in_other_shapes(catalogue, 1) == [1, 3]
    catalogue = [replace(s, candidate=replace(s.candidate, effect=replace(handed, hides=""))) for s in catalogue]
    assert _in_other_shapes(catalogue, 2) == [2]


def test_a_fault_of_what_was_measured_is_not_begun():
    world = World(9)
    one = world.catalogue[0]
    twins = Bent(world, one.columns[:, 0])
    fault = Signature(Candidate(replace(effect(), seen=lambda scene, amounts: scene), {}), one.columns, np.ones(1), np.full(1, 20.0))
    fitting = world.evidence(world.reference)[0].likelihood(PRIOR, parameters=False)
    asked = Asked(world.reference, world.reference, world.slopes, fitting, np.arange(SIZE))
    assert begun(twins, asked, [fault], DiagnosisConfig()) == [] and twins.cost.runs == 0


def test_sizes_whose_motion_is_known_are_run_once():
    world = World(9)
    one = world.catalogue[0]
    twins = Bent(world, one.columns[:, 0])
    scatter, _, _ = world.evidence(world.reference)
    fitting = scatter.likelihood(PRIOR, parameters=False)
    data = twins.rows([dict(p0=0.3, p1=0.0, p2=0.0, push=12.0)])[0]
    before = twins.cost.runs
    [start] = begun(twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)), [one], DiagnosisConfig())
    assert start.numbers[3] > 0 and twins.cost.runs - before == 10 + 2  # five sizes on each side, two that are led
    first = twins.cost.runs
    given = (twins, Asked(data, world.reference, world.slopes, fitting, np.arange(SIZE)), one)
    led = refitted(*given, DiagnosisConfig(runs=1), (), start)
    # what is measured at the start (one run of it, and four slopes) is not of the budget, of which the least is a step
    assert twins.cost.runs - first > 1 + 4 and led.log_evidence > start.log_evidence


def test_effects_are_refitted_in_the_order_of_the_better_of_two_evidences():
    scores = [Score(name, 0.0, logs, (0.0,), 0.0) for name, logs in (("a", 9.0), ("b", 2.0), ("b", 4.0), ("c", 3.0), ("d", 1.0))]
    assert _in_order(scores, {}) == ["a", "b", "c", "d"]
    assert _in_order(scores, {"a": -5.0, "c": 3.5, "d": 50.0}) == ["d", "a", "b", "c"]


def test_amounts_have_a_prior_by_what_they_do():
    # motion of 20 mm sqrt(amount): a deviation of 20 mm is an amount of 1, two are 4, and a twentieth of one is 1 / 400
    world = World(11)
    column = world.catalogue[0].columns[:, 0]  # of 1 mm
    one = replace(world.catalogue[0], candidate=Candidate(effect(low=0.0), {}), unit=np.array([1 / 400]))

    def run(amounts):
        return world.reference + 20 * np.sqrt(amounts) * column

    scale = Scale.of(one, run, world.reference, 20.0)
    numbers, sizes = scale.knots
    assert scale.low == 0 and scale.high == pytest.approx(10.0)  # its bound is an amount of 100
    np.testing.assert_allclose(sizes, numbers**2, rtol=1e-9)
    at = np.array([numbers[2:4].mean()])
    assert scale.amounts(at) == pytest.approx(sizes[2:4].mean())
    assert scale.slope(at) == pytest.approx(np.diff(sizes[2:4]) / np.diff(numbers[2:4]))


def test_what_blows_up_bounds_an_amount_and_what_does_no_more_is_told_apart():
    world = World(12)
    column = world.catalogue[0].columns[:, 0]
    one = replace(world.catalogue[0], candidate=Candidate(effect(), {}), unit=np.array([1.0]))

    def run(amounts):
        return world.reference + np.where(amounts > 50, np.nan, np.clip(amounts, -10, 10)) * column

    scale = Scale.of(one, run, world.reference, 20.0)
    assert scale.amounts(scale.low) == -100 and 10 < scale.amounts(scale.high)[0] < 50
    assert (np.diff(scale.knots[0]) > 0).all() and (np.diff(scale.knots[1]) > 0).all()


def test_an_amount_of_which_no_size_ends_is_taken_as_linear():
    # every run of it blows up: what its signature says is all that is known, and its slope is that
    world = World(12)
    one = replace(world.catalogue[0], candidate=Candidate(effect(), {}), unit=np.array([1.0]))
    scale = Scale.of(one, lambda amounts: world.reference + np.full((len(amounts), 1), np.nan), world.reference, 20.0)
    wide = one.unit * one.spread
    assert scale.knots is None and scale.amounts(np.array([0.5])) == pytest.approx(wide / 2)
    assert scale.slope(np.zeros(1)) == pytest.approx(wide)
    assert scale.low * wide == pytest.approx([-100.0]) and scale.high * wide == pytest.approx([100.0])


def test_slopes_are_corrected_by_steps_and_not_by_rounding():
    # Broyden's secant: the corrected slopes say what the step did, and are as before across it
    random = np.random.default_rng(2)
    slopes, step, change = random.normal(size=(6, 3)), np.array([0.3, 0.0, -0.4]), random.normal(size=6)
    found = corrected(slopes, step, change)
    np.testing.assert_allclose(found @ step, change, atol=1e-12)
    np.testing.assert_allclose(found @ [0.4, 0.0, 0.3], slopes @ [0.4, 0.0, 0.3], atol=1e-12)
    assert corrected(slopes, 1e-9 * step, slopes @ (1e-9 * step) + 1e-7) is slopes  # of a refit that has arrived


def test_what_a_refit_corrects_it_corrects_in_all_candidates_of_its_effect():
    # two candidates of 30 and 28 nats, the first of which a refit leaves 5: the other has 3, and log((e^5 + e^3) / 2) is less than 10
    scored = [Score(name, 3.0, log, (1.0,), 0.5) for name, log in (("a", 30.0), ("a", 28.0), ("b", 10.0))]
    effect = SimpleNamespace(amounts=(Amount("much", 0.1, 0.0, 10.0, "-"),), roaming=False, hand="")
    alike = [SimpleNamespace(effect=effect, place=None, fixed={"which": float(k > 0)}) for k, _ in enumerate(scored)]
    catalogue = [SimpleNamespace(name=s.name, unit=np.array([0.1]), candidate=c) for s, c in zip(scored, alike, strict=True)]
    test = SimpleNamespace(scores=scored)
    assert next(iter(chances_of(test, catalogue, {}))) == "a" and _likely(test, catalogue, DiagnosisConfig()) == {"a": [0], "b": [2]}
    # where the first needs a thousand times what is noticeable, three deviations of ten, the other explains as much: 30 - 9 / 2 < 28
    catalogue[0].unit = np.array([100.0])
    assert _likely(test, catalogue, DiagnosisConfig()) == {"a": [1], "b": [2]}
    # and where both have a place, farther apart than refits of either would go, both are refitted
    for far, expected in ((0.02, [1]), (0.2, [1, 0])):
        for k in range(2):
            catalogue[k].candidate.place = np.array([k * far, 0.0, 0.0])
        assert _likely(test, catalogue, DiagnosisConfig())["a"] == expected
    for k in range(2):
        catalogue[k].candidate.place = None
    assert _likely(test, catalogue, DiagnosisConfig())["a"] == [1]
    effect.hand = "which"  # a little of one hand does not tell what much of the other does
    assert _likely(test, catalogue, DiagnosisConfig())["a"] == [1, 0]
    found = chances_of(test, catalogue, {0: 5.0})
    ratio = (np.exp(5) + np.exp(3)) / 2 / np.exp(10)
    assert list(found) == ["b", "a"] and found["a"] == pytest.approx(ratio / (1 + ratio))


def test_what_a_refit_refutes_is_told_from_the_first():
    # e^6.7 times less likely is told apart, however alike a little of both is; less than that is not
    named = [SimpleNamespace(name=name, log_evidence=nats) for name, nats in (("a", 100.0), ("b", 95.0), ("c", 90.0), ("d", -np.inf))]
    assert _refuted(named, DiagnosisConfig()) == {"c", "d"} and _refuted(named[:1], DiagnosisConfig()) == set()


@pytest.mark.parametrize("stray", [0.4, 2.0])
def test_what_strays_beside_hands_speaks_for_effects_at_hands_alone(stray):
    # by how much a stray is likelier where up to 3 was added to that of controls, in scores and refits of such effects; p is as it was
    world = World(12)
    catalogue = [world.catalogue[0], signature(world.catalogue[1].columns[:, 0], "sag")]
    sag = catalogue[1].candidate
    catalogue[1] = replace(catalogue[1], candidate=replace(sag, effect=replace(sag.effect, kind="grip")))
    scatter, residual, noisy = world.evidence(world.reference + world.noise())
    controls = Controls(np.random.default_rng(0).normal(size=(60, 3)) * [1, 1, 0.2] + [0, 0, 0.4], ("misfit", "scan", "stray"))
    plain, told = (
        significance(scatter, PRIOR, residual, noisy, catalogue, np.ones(SIZE), controls=controls, hands={"stray": stray}, farther=farther)
        for farther in (0.0, 3.0)
    )
    expected = controls.tails["stray"].wider(stray, 3.0)
    assert told.at_hands == expected and (expected > 5 if stray > 1 else -3 < expected < 0)
    assert [a.log_evidence - b.log_evidence for a, b in zip(told.scores, plain.scores, strict=True)] == pytest.approx([0.0, expected])
    assert told.p == plain.p and plain.at_hands == 0.0
    trials = Trials(SimpleNamespace(catalogue=catalogue), PRIOR, told, DiagnosisConfig(), None, SimpleNamespace(log_evidence=2.0), {})
    assert [trials.over_sound(k, SimpleNamespace(log_evidence=5.0)) for k in (0, 1)] == pytest.approx([3.0, 3.0 + expected])
    none = significance(scatter, PRIOR, residual, noisy, catalogue, np.ones(SIZE), controls=controls, hands={}, farther=3.0)
    assert none.at_hands == 0.0  # no hand tells


def test_hands_are_asked_one_by_one_and_all_together():
    slip = next(e for e in effects("rope") if e.name == "grip_slip")
    for hands, asked in (((), []), ((1,), [1]), ((0, 2), [0, 2, -1])):
        found = slip.candidates(None, hands=hands)
        shapes = len(slip.shapes["slide_weights"]) * len(slip.shapes["slide_speed"])
        assert [c.fixed["slide_hand"] for c in found] == asked * shapes
        assert {c.fixed["slide_weights"] for c in found} == (set(slip.shapes["slide_weights"]) if hands else set())
    wind = next(e for e in effects("rope") if e.name == "wind")
    assert len(wind.candidates(None, hands=(0, 1))) == len(wind.candidates(None))  # it is of no hand


def test_a_part_reaches_no_farther_than_places_lie_apart():
    weight = next(e for e in effects("solid") if e.name == "added_mass")
    for apart, reach in ((0.05, 0.03), (0.024, 0.03), (0.008, 0.01)):
        places = apart * np.c_[np.arange(10), np.zeros((10, 2))]
        found = weight.candidates(places)
        assert [one.fixed["added_mass_within"] for one in found] == pytest.approx([reach] * 10)
    assert weight.candidates(np.zeros((1, 3)))[0].fixed["added_mass_within"] == 0.03
    assert weight.shapes["added_mass_within"] == (0.03,)  # the effect itself stays


def test_gains_are_paired():
    data, sound = np.zeros(8), np.repeat([1.0, 3.0], 4)
    found = gained(data, sound, sound / 2, np.arange(8) // 2)
    assert (found.share, found.error) == (pytest.approx(0.75), pytest.approx(0.0, abs=1e-12))
    # what is off by as much as sound twins are, thrice here, counts for a ninth: of 1 + 9 / 9 squares 1/4 + 1 are left
    other = np.repeat([0.5, 3.0], 4)
    assert gained(data, sound, other, np.arange(8) // 2, sound**2).share == pytest.approx(1 - 1.25 / 2)


@pytest.mark.long
def test_what_is_detectable_is_detected():
    world = World(11)
    scatter, _, noisy = world.evidence(world.reference)
    test = significance(scatter, PRIOR, np.zeros(SIZE), noisy, world.catalogue, np.ones(SIZE))
    sizes = detectable(scatter, PRIOR, test, world.catalogue, 0.03)
    hits = []
    for draw in range(40):
        k = draw % len(world.catalogue)
        measured = world.sound(1)[0] + sizes[k].size * world.catalogue[k].columns[:, 0] + world.noise()
        left, _ = absorb(measured[None], world.reference, world.slopes, np.full(SIZE, NOISE), world.run, NOWHERE, rounds=2)
        hits.append(significance(scatter, PRIOR, left[0], noisy, world.catalogue, np.ones(SIZE)).p < 0.03)
    assert np.mean(hits) > 0.7  # 0.95 were the members' covariance exact; 0.7 is what ten members come to


def test_the_budget_adds_up():
    world = World(12)
    scatter, residual, _ = world.evidence(world.sound(1)[0])
    parts = budget(scatter, PRIOR, residual, np.zeros((SIZE, SIZE)), np.zeros(SIZE))
    assert len(parts) == TIMES
    for part in parts:
        squares = sum(getattr(part, name) ** 2 for name in ("noise", "representation", "parameters", "named", "unexplained"))
        assert squares >= part.error**2 - 1e-9
    # mean squares of parts of equal size are those of the whole
    assert np.mean([p.error**2 for p in parts]) == pytest.approx(3e6 * np.mean(residual**2))
    # what the twin is expected to miss is error that is explained
    more = budget(scatter, PRIOR, residual, np.zeros((SIZE, SIZE)), np.zeros(SIZE), missed := 1e-3 * np.sign(residual))
    assert np.mean([p.error**2 for p in more]) == pytest.approx(3e6 * np.mean((residual + missed) ** 2))
    np.testing.assert_allclose([p.unexplained for p in more], [p.unexplained for p in parts], atol=1e-6)
    assert all(b.representation > a.representation for a, b in zip(parts, more, strict=True))


def test_a_prediction_interval_of_a_normal_sample_holds_what_it_says():
    random = np.random.default_rng(3)
    p = [predictive(float(np.exp(random.normal())), np.exp(random.normal(size=6)))[0] for _ in range(300)]
    assert kstest(p, "uniform").pvalue > 0.01


def test_every_effect_says_what_it_is():
    for one in effects():
        assert one.amounts and one.says and one.bodies
        zero = one.candidates([np.zeros(3)], hands=(0,))[0].values(np.zeros(len(one.amounts)))
        assert all(np.isfinite(v) for v in zero.values())
        if one.term:  # what a candidate sets are parameters of its term, within their ranges
            one.term(zero)
    assert len({(e.name, e.term) for e in effects()}) == len(effects())


def test_an_effect_of_no_kind_is_refused():
    with pytest.raises(ValueError, match="kind of effect wind must be one of"):
        replace(effect(), kind="weather")


def test_a_name_must_leave_as_little_as_sound_twins_do():
    # of the misfit: members are draws of one normal distribution; a refit that leaves such a draw explains, one that leaves three
    # of them does not. Of the motion, where controls know how much is usual: a tenth here, give or take; half of it explains nothing
    random = np.random.default_rng(0)
    members, motion, noise, none = random.normal(0, 1e-3, (12, SIZE)), np.full(SIZE, 0.01), 1e-8 * np.eye(SIZE), np.zeros((SIZE, 1))
    scatter, prior = Scatter(members, noise, none, none, layout()), Prior(8.0, 0.0, 0.0)
    draws = random.normal(0, 1e-3, (20, SIZE))

    def left(scatter, members, residuals, controls=None):
        usual = misfits(scatter.likelihood(prior), scatter.left_out(prior), members[0], members)[1]
        test = SimpleNamespace(misfits=usual, controls=controls)
        return np.array([unexplained(test, scatter.likelihood(prior), one, motion) for one in residuals])

    usual, thrice = (left(scatter, members, k * draws) for k in (1, 3))
    assert np.median(usual) > 0.2 and (usual < 0.03).mean() <= 0.15 and thrice.max() < 0.01  # of 20, three by chance in one of 50 tests
    three = np.c_[random.normal(size=(40, 2)), np.log(0.1) + 0.3 * random.normal(size=40)]
    for share, enough in ((0.1, True), (0.5, False)):
        as_wide = 10 * share * members  # among which nothing stands out
        wide = Scatter(as_wide, noise, none, none, layout())
        these = 0.01 * share * draws / np.sqrt(np.mean(draws**2, axis=1, keepdims=True))
        p = [left(wide, as_wide, these, Controls(three[:, :n], ("misfit", "scan", "left")[:n])) for n in (3, 2)]
        assert (np.median(p[0]) > 0.03) == enough and np.median(p[1]) > 0.03
