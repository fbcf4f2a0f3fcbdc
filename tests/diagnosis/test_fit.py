"""The batched Gauss-Newton fit finds what made a recording, on bodies that the engine itself moved."""

import numpy as np
import pytest
from twinbench.diagnosis import fit as fitting
from twinbench.diagnosis.baseline import baseline_model
from twinbench.diagnosis.fit import LOST, Fit, Frames, Task, fit, floor_of, gaps, jacobian, mean_error, slopes_at, turned, weights_of
from twinbench.diagnosis.model import Knob, Model, Simulator
from twinbench.diagnosis.replica import build_replica

EXACT = 1e-8  # m: error that no frame need be better than, where the truth can be met


@pytest.fixture(scope="module")
def hung(tiny):
    """A simulator of a sheet at rest without gravity, whose twin can be exact."""
    return tiny.drawn(tiny.concealing(gravity=np.zeros(3), frames=30, train_end=30))


@pytest.fixture(scope="module")
def two(tiny, hung):
    return tiny.known(baseline_model([hung.replica]), "body_stiffness", "drag_damping")


def test_a_free_fit_recovers_the_stiffness_and_drag_that_moved_it(tiny, hung, two):
    # the recording is a roll-out of the same equations in float64, so the least error is 0 and is at the truth but for the pull
    # of priors, which count against a noise of 0.1 mm; quadratic convergence
    found = fit(Task([hung], [30], 0.0, finest=EXACT), two, np.zeros(2), iterations=14)
    assert found.values["body_stiffness"] == pytest.approx(tiny.truth["body_stiffness"], rel=1e-5)
    assert found.values["drag_damping"] == pytest.approx(tiny.truth["drag_damping"], rel=1e-5)
    assert found.history[-1] < 1e-10 * found.history[0]


def test_an_observed_fit_is_near_the_truth(tiny, hung, two):
    # the observer pulls towards straight lines between frames, 1/8 a dt^2 off an accelerated path: a bias of a few per cent at 30 Hz
    found = fit(Task([hung], [30], 2.0), two, np.zeros(2), iterations=8)
    assert found.values["body_stiffness"] == pytest.approx(tiny.truth["body_stiffness"], rel=0.1)
    assert found.values["drag_damping"] == pytest.approx(tiny.truth["drag_damping"], rel=0.15)
    assert list(found.history) == sorted(found.history, reverse=True)


def test_every_second_step_takes_a_secant_and_ends_where_full_jacobians_do(hung, two, monkeypatch):
    task, counted = Task([hung], [30], 0.0, finest=EXACT), []

    def counting(*arguments, **options):
        counted.append(1)
        return jacobian(*arguments, **options)

    monkeypatch.setattr(fitting, "jacobian", counting)
    saved = fit(task, two, np.zeros(2), iterations=14)
    assert len(counted) <= (len(saved.history) + 1) // 2 + 1  # half of the steps had to simulate no column
    # a plain Levenberg-Marquardt with a full finite-difference Jacobian at every step, of another library, on the same residual
    from scipy.optimize import least_squares

    substeps = task.substeps(two, saved.z)
    plain = least_squares(lambda z: task.residuals(task.predict(two, [z], substeps))[0], np.zeros(2), method="lm", diff_step=1e-4)
    np.testing.assert_allclose(saved.z, plain.x, atol=1e-5)  # the least loss is 0, so priors and robust weights do not move it


def test_the_jacobian_is_the_derivative_of_the_residual(hung, two):
    task, z = Task([hung], [12], 2.0), np.array([-0.8, 0.3])
    substeps = task.substeps(two, z)
    residual = task.residuals(task.predict(two, [z], substeps))[0]
    slopes, ok = jacobian(task, two, z, residual, substeps)
    h = 1e-4
    for k, e in enumerate(np.eye(2)):
        ahead, behind = task.residuals(task.predict(two, [z + h * e, z - h * e], substeps))
        central = (ahead - behind) / (2 * h)
        # one-sided with a step of 0.05: off by half of it times the curvature, which is of the order of the slope
        assert np.linalg.norm(slopes[:, k] - central) < 0.05 * np.linalg.norm(central)
    assert ok.all()


def test_slopes_that_are_known_are_not_looked_for_again(tiny, hung, two, monkeypatch):
    task, one = Task([hung], [30], 0.0, finest=EXACT), tiny.known(two, "body_stiffness")
    z = np.array([-0.5])
    base = Fit(one, z, 0.0, np.eye(1), ())
    known = slopes_at(task, base)
    (drag,) = (k for k in two.knobs if k.name == "drag_damping")
    both = np.append(z, drag.encode(tiny.truth["drag_damping"]))  # at which the other has it fixed
    substeps = task.substeps(two, both)
    residual = task.residuals(task.predict(two, [both], substeps))[0]
    asked, predict = [], Task.predict
    monkeypatch.setattr(Task, "predict", lambda self, model, zs, *steps: asked.append(len(zs)) or predict(self, model, zs, *steps))
    slopes, ok = jacobian(task, two, both, residual, substeps, known)
    assert asked == [1] and ok.all()  # the drag's column alone was simulated
    np.testing.assert_array_equal(slopes[:, 0], known[0][:, 0])
    np.testing.assert_allclose(slopes, jacobian(task, two, both, residual, substeps)[0], atol=1e-6 * np.abs(slopes).max())
    # and with slopes that were found far away, and so are off, a fit ends there too, a step or two later
    found = fit(task, two, np.zeros(2), iterations=14, known=known)
    assert found.values["body_stiffness"] == pytest.approx(tiny.truth["body_stiffness"], rel=1e-4)
    assert found.values["drag_damping"] == pytest.approx(tiny.truth["drag_damping"], rel=1e-4)


def test_knobs_are_turned_one_at_a_time_and_back_from_a_bound():
    model = Model((), {}, (Knob("a", 1.0, 1.0, 0.0, 2.0, step=0.1), Knob("b", 1.0, 1.0, 0.0, 2.0, step=0.2)))
    trials, steps = turned(model, np.array([1.0, 0.5]))  # a is at its upper bound
    assert steps.tolist() == [-0.1, 0.2]
    np.testing.assert_allclose(trials, [[0.9, 0.5], [1.0, 0.7]])


def test_frames_that_are_not_fitted_do_not_matter(tiny):
    first = tiny.concealing(gravity=np.zeros(3), frames=24, train_end=16)
    moved = first.points.copy()
    moved[16:] += 0.05
    fits = []
    for points in (first.points, moved):
        simulator = tiny.drawn(tiny.filmed(points, first.controllers, gravity=np.zeros(3)))
        model = tiny.known(baseline_model([simulator.replica]), "body_stiffness", "drag_damping")
        fits.append(fit(Task([simulator], [16], 2.0), model, np.zeros(2), iterations=4))
    assert (fits[0].z == fits[1].z).all() and fits[0].history == fits[1].history


def test_weights_count_every_node_alike_and_sum_to_one(tiny):
    scenario = tiny.concealing(gravity=np.zeros(3), frames=8, train_end=8)
    seen = scenario.points.copy()
    seen[3:, 5] = np.nan
    weights = weights_of(tiny.drawn(scenario, seen=seen), 8)
    assert (weights**2).sum() == pytest.approx(1)
    assert (weights[0] == 0).all() and (weights[3:, 5] == 0).all()  # frame 0 is given; what was not seen says nothing
    assert len(np.unique(weights[weights > 0])) == 1


def test_mean_error_is_the_mean_distance_of_seen_nodes(tiny):
    scenario = tiny.concealing(gravity=np.zeros(3), frames=8, train_end=8)
    seen = scenario.points.copy()
    seen[5:] = np.nan
    replica = tiny.drawn(scenario, seen=seen).replica
    assert mean_error(replica, scenario.points + [0.003, 0, 0.004], 2, 8) == pytest.approx(0.005)  # 3, 4, 5
    assert np.isnan(mean_error(replica, scenario.points, 5, 8))


def test_what_hands_drive_is_neither_fitted_nor_judged(tiny):
    points = np.repeat(tiny.sheet(4, 5)[None], 8, 0)
    replica = build_replica(tiny.filmed(points, points[:, [8, 3]], grips=[8, 3]), nodes=20)
    driven = np.isin(np.arange(20), replica.driven)
    np.testing.assert_allclose(replica.nodes[replica.driven], points[0, [8, 3]])
    assert ((weights_of(Simulator(replica), 8)[1:] == 0) == driven).all()
    off = replica.sightings.position + [0.003, 0, 0.004]
    assert (np.isnan(gaps(replica, off)) == driven).all()
    assert mean_error(replica, np.where(driven[:, None], 9.0, off), 0, 8) == pytest.approx(0.005)


@pytest.mark.parametrize("log", [False, True])
def test_a_knob_decodes_what_it_encodes_and_stays_within_its_bounds(log):
    knob = Knob("k", 2.0, 0.5, 1.0, 8.0, log=log)
    for value in (1.0, 2.0, 3.7, 8.0):
        assert knob.decode(knob.encode(value)) == pytest.approx(value)
    assert (knob.decode(-100.0), knob.decode(100.0)) == (1.0, 8.0)


def test_the_misfit_of_frames_is_the_mean_log_of_their_squares():
    # frame 0 has one node, off by 3 mm, frame 1 two, one of them off by 4 mm: mean squares 9 and 8 mm^2
    seen = np.array([[True, False], [True, True]])
    frames = Frames.of_seen([seen], [1e-6])
    residual = np.zeros((2, 2, 3))
    residual[0, 0, 1], residual[1, 0, 2] = 0.003, -0.004
    residual = residual.ravel() / np.sqrt(3)
    np.testing.assert_allclose(frames.squares(residual), [9e-6, 8e-6])
    level = lambda m: np.log(m / (1 + m / LOST**2))  # noqa: E731
    assert frames.misfit(residual) == pytest.approx(level(10e-6) / 3 + level(9e-6) * 2 / 3, rel=1e-12)


def test_the_weights_of_squares_have_the_gradient_of_the_misfit():
    # d misfit / d r = 2 weight r, by central differences in float64: relative errors of h^2
    rng = np.random.default_rng(0)
    seen = [rng.random((4, 5)) < 0.7, rng.random((3, 2)) < 0.7]
    frames = Frames.of_seen(seen, [1e-6, 4e-6])
    mask = np.concatenate([np.repeat(one.ravel(), 3) / np.sqrt(one.sum()) for one in seen])
    residual = rng.normal(0, 0.02, len(mask)) * mask
    h = 1e-6
    for k in rng.choice(np.flatnonzero(mask), 8, replace=False):
        step = np.zeros_like(residual)
        step[k] = h
        slope = (frames.misfit(residual + step) - frames.misfit(residual - step)) / (2 * h)
        assert slope == pytest.approx(2 * frames.weights(residual)[k] * residual[k], rel=1e-4)


def test_a_lost_frame_does_not_outweigh_the_others(hung, two):
    # one frame 10 m off: a plain sum of squares would be that frame alone; its log levels off, and its weight is gone
    task = Task([hung], [30], 2.0)
    residual = task.residuals(task.predict(two, [np.zeros(2)]))[0]
    far = np.where(task.by_frame.of == 20, residual + 10 * (residual != 0) / np.sqrt((residual != 0).sum() / 3), residual)
    assert task.by_frame.misfit(far) - task.by_frame.misfit(residual) < task.by_frame.share[20] * np.log(LOST**2 / floor_of(hung.replica))
    assert task.by_frame.weights(far)[task.by_frame.of == 20].max() < 1e-6 * task.by_frame.weights(far).max()
