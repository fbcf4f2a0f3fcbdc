"""Planning: the search against problems of known solution, what hands may do, goals, batches, nulls, the command and its files."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from blocks import lifted
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ttest_rel
from twinbench.benchmark.cli import main
from twinbench.benchmark.planning import experiment
from twinbench.benchmark.planning.arms import Arm, fitted
from twinbench.benchmark.planning.config import PlanConfig
from twinbench.benchmark.planning.controls import Controls, axes_of
from twinbench.benchmark.planning.cost import Judge
from twinbench.benchmark.planning.goal import Goal
from twinbench.benchmark.planning.guesses import guesses, wanted_shifts
from twinbench.benchmark.planning.keeping import KnownTwins
from twinbench.benchmark.planning.mppi import coloured, mppi, shooting, softmax
from twinbench.benchmark.planning.planner import held, plan
from twinbench.benchmark.planning.summary import difference, summary
from twinbench.benchmark.planning.tasks import get_task, tasks
from twinbench.benchmark.planning.tasks.cloud import cloud_goal, read_cloud
from twinbench.benchmark.planning.tasks.rope import arc_lengths
from twinbench.benchmark.planning.trial import Trial
from twinbench.benchmark.planning.truth import drawn
from twinbench.datasets.concealed import motions
from twinbench.datasets.scenario import Observed
from twinbench.methods.base import Budget, Diverged
from twinbench.methods.continuum import Continuum
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.solids import Solid
from twinbench.methods.continuum.twin import ContinuumTwin
from twinbench.methods.phystwin.body import Place, build
from twinbench.methods.phystwin.config import Config
from twinbench.methods.phystwin.ranges import SEARCHED
from twinbench.methods.phystwin.twin import PhysTwinTwin
from twinbench.methods.registry import methods
from twinbench.methods.rigid import RigidTwin
from twinbench.methods.static import StaticTwin

SMALL = PlanConfig(samples=6, updates=3, moving=9, resting=3, segments=2)


def lying(gravity=(0, 0, -9.8), hands=1):
    """A thin bar on the table, held at one end or at both."""
    x = np.linspace(-0.1, 0.1, 21)
    bar = np.stack([np.repeat(x, 2), np.tile([-0.01, 0.01], 21), np.full(42, 0.005)], 1)
    tips = np.concatenate([[[s, y, 0.02] for y in (-0.01, 0.0, 0.01)] for s in (-0.1, 0.1)[:hands]])
    seen = np.ones((1, 42), bool)
    about = dict(ground=None, gravity=np.array(gravity, float))
    return Observed(name="bar", points=bar[None], visible=seen, motion_valid=seen, controllers=tips[None], **about)


def moved_goal(start, shift):
    return Goal.of("moved", start, lambda points: points + shift)


# ---------------------------------------------------------------- the search


@settings(deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20), st.floats(1e-3, 1e3))
def test_weights_are_their_formula(costs, temperature):
    # w_k = exp(-c_k / T) / sum_j exp(-c_j / T), in logarithms so that nothing overflows; 1e-9: rounding of some 20 sums of float64
    weights = softmax(np.array(costs), temperature)
    logs = -np.array(costs) / temperature
    np.testing.assert_allclose(weights, np.exp(logs - np.logaddexp.reduce(logs)), atol=1e-9)


def test_a_diverged_sample_has_no_weight():
    assert softmax(np.array([1.0, np.inf, 1.0]), 0.5).tolist() == [0.5, 0.0, 0.5]


def test_noise_is_coloured():
    # steps of a stationary AR(1): unit variance, correlation `colour` from one to the next; 5 sd of 20000 samples are 0.035
    steps = np.diff(coloured(np.random.default_rng(0), 20000, (4, 1, 1), 0.5)[..., 0, 0], axis=1, prepend=0)
    assert steps.var(0) == pytest.approx(np.ones(4), abs=0.05)
    assert [np.corrcoef(steps[:, k], steps[:, k + 1])[0, 1] for k in range(3)] == pytest.approx([0.5] * 3, abs=0.035)


@pytest.mark.parametrize("seed", range(3))
def test_mppi_finds_the_optimum_of_a_quadratic(seed):
    # sum_k |P_k - g_k|^2 has its minimum, 0, at g, which is feasible. The last noise is 0.5 * 0.2 * 0.8^24 m = 0.5 mm a step, summed over
    # two steps; the mean of 200 samples is nearer than one sample is
    config = PlanConfig(samples=200, updates=25, segments=2, noise=0.5)
    goal = np.array([[[0.1, -0.05, 0.08]], [[0.2, 0.02, 0.0]]])
    count = []

    def cost(ways):
        count.append(len(ways))
        return np.square(ways - goal).sum((1, 2, 3))

    controls = replace(Controls.of(lying(), config), config=config)
    found = mppi(cost, controls.feasible, (2, 1, 3), 0.2, config, seed=seed)
    assert np.abs(found.ways - goal).max() < 2e-3
    assert sum(count) == config.rollouts and list(found.best) == sorted(found.best, reverse=True)
    shot = shooting(cost, controls.feasible, (2, 1, 3), 0.2, config, seed=seed)
    assert sum(count) == 2 * config.rollouts and found.cost < shot.cost  # as many roll-outs find less without a mean


def test_searches_begin_at_the_best_guess_and_simulate_no_more_for_it():
    # cost |P - goal|: a guess that is the goal is never left, whatever is drawn; all in all samples x updates paths are simulated
    goal, seen = np.full((1, 2, 1, 3), 0.05), []

    def cost(ways):
        seen.append(len(ways))
        return np.abs(ways - goal).sum((1, 2, 3))

    config = replace(SMALL, samples=6, updates=3)
    for search in (mppi, shooting):
        seen.clear()
        found = search(cost, lambda ways: ways, (2, 1, 3), 0.1, config, guesses=np.concatenate([0 * goal, goal, 3 * goal]))
        assert found.cost == 0 and found.best == (0.0,) * 3 and sum(seen) == config.rollouts
        np.testing.assert_array_equal(found.ways, goal[0])
    seen.clear()
    few = replace(config, samples=2)
    assert mppi(cost, lambda ways: ways, (2, 1, 3), 0.1, few, guesses=np.zeros((7, 2, 1, 3))).cost > 0 and sum(seen) == few.rollouts


@pytest.mark.parametrize(("search", "number"), [("straight", 1), ("arc", 2)])
def test_without_a_search_hands_do_what_geometry_says(search, number):
    # a rigid body that is moved straight arrives, so that both paths, which end in one place, cost nothing; one roll-out says so
    start, config = lying(), replace(SMALL, moving=31)
    goal = moved_goal(start, np.array([0.06, 0.0, 0.0]))
    found = plan(RigidTwin.of(start), start, goal, config, optimiser=search)
    expected = Controls.of(start, config).moved(guesses(Controls.of(start, config), goal)[number : number + 1])[0]
    np.testing.assert_allclose(found.moved, expected, atol=1e-12)
    assert found.rollouts == 1 and found.cost < 1e-6 and str(Arm.of(f"rigid/{search}")) == f"rigid/{search}"


@pytest.mark.parametrize("gravity", [(0, 0, -9.8), (0, 9.8, 0)])
def test_hands_first_go_to_where_what_they_hold_is_wanted(gravity):
    start, shift = lying(gravity), np.array([0.1, 0.02, -0.03])
    controls, goal = Controls.of(start, PlanConfig()), moved_goal(start, shift)
    np.testing.assert_allclose(wanted_shifts(controls, goal)[0] @ controls.axes, shift, atol=1e-12)
    still, straight, arc = guesses(controls, goal)
    assert not still.any()
    np.testing.assert_allclose(straight[-2:, 0] @ controls.axes, [shift, shift], atol=1e-12)
    np.testing.assert_allclose(arc[-1], straight[-1], atol=1e-12)
    # half a circle of the diameter d over a level way: d / 2 above it in its middle
    level = np.linalg.norm(controls.axes[:2] @ shift)
    np.testing.assert_allclose((arc - straight).max((0, 1)), [0, 0, level / 2], atol=1e-12)
    cloud = Goal("cloud", goal.points, None, goal.points[:30] + shift)
    expected = goal.points[:30].mean(0) + shift - goal.points.mean(0)
    np.testing.assert_allclose(wanted_shifts(controls, cloud)[0] @ controls.axes, expected, atol=1e-12)


def test_nothing_that_does_not_diverge_is_said():
    with pytest.raises(ValueError, match="every roll-out of the search diverged"):
        mppi(lambda ways: np.full(len(ways), np.inf), lambda ways: ways, (2, 1, 3), 0.1, SMALL)


# ---------------------------------------------------------------- what hands may do


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 7), st.integers(8, 60), st.floats(0.01, 3.0))
def test_hands_keep_to_their_speed_and_box(seed, segments, moving, scale):
    # a B-spline lies in the hull of its control points and its velocity in that of their differences (de Boor); 1e-9 m: rounding
    config = PlanConfig(segments=segments, moving=moving, resting=4)
    controls = Controls.of(lying(hands=2), config)
    ways = controls.feasible(np.random.default_rng(seed).normal(0, scale, (5, *controls.shape)))
    moved = controls.moved(ways)
    assert moved.shape == (5, config.frames, 2, 3) and not moved[:, 0].any()
    steps = np.linalg.norm(np.diff(moved, axis=1), axis=-1)
    assert steps.max() <= config.speed / controls.fps + 1e-9
    assert not steps[:, moving:].any()  # at rest
    inside = moved @ controls.axes.T
    assert (inside >= controls.low - 1e-9).all() and (inside <= controls.high + 1e-9).all()
    np.testing.assert_allclose(controls.feasible(ways), ways, atol=1e-12)  # what is feasible stays
    mean = np.random.default_rng(seed).dirichlet(np.ones(5)) @ ways.reshape(5, -1)
    mean = mean.reshape(1, *controls.shape)
    np.testing.assert_allclose(controls.feasible(mean), mean, atol=1e-9)  # both sets are convex


def test_hands_are_told_apart_and_carried_as_wholes():
    controls = Controls.of(lying(hands=2), SMALL)
    assert controls.hand.tolist() == [0, 0, 0, 1, 1, 1]
    ways = np.zeros((1, *controls.shape))
    ways[:, :, 1, 2] = 0.1
    paths = controls.paths(ways)[0]
    np.testing.assert_array_equal(paths[:, :3], np.repeat(controls.controllers[None, :3], len(paths), 0))
    np.testing.assert_allclose(paths[-1, 3:] - controls.controllers[3:], [[0, 0, 0.1]] * 3, atol=1e-12)


@pytest.mark.parametrize("gravity", [(0, 0, -9.8), (0, 0, 9.8), (3, -4, 5), (0, 0, 0)])
def test_axes_are_a_right_handed_frame_with_gravity_down(gravity):
    axes = axes_of(gravity)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1) and axes[2] @ gravity == pytest.approx(-np.linalg.norm(gravity))


def test_a_start_without_hands_is_refused():
    bare = replace(lying(), controllers=np.zeros((1, 0, 3)), grips=None)
    with pytest.raises(ValueError, match="no controllers"):
        Controls.of(bare, SMALL)


WRONG = [("samples", 1), ("updates", 0), ("segments", 1.5), ("colour", 1.0), ("speed", 0), ("resting", -1)]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_wrong_constants_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        PlanConfig(**{name: value})


# ---------------------------------------------------------------- costs and goals


def test_outcomes_of_a_known_end():
    # a bar carried 3 cm along x and 4 cm up, wanted 3 cm along x: each point is 4 cm off; the goal's cloud likewise, as nothing is nearer
    start = replace(lying(), ground=None)
    judge = Judge.of(moved_goal(start, [0.03, 0, 0]), start, SMALL)
    path = np.stack([start.points[0], start.points[0] + [0.03, 0, 0.04]])
    outcome = judge.outcome(path)
    assert (outcome.point, outcome.stretch, outcome.reach) == pytest.approx((0.04, 0, 0), abs=1e-12)
    assert 0.04 <= outcome.goal_to_body <= outcome.point + 1e-12
    assert judge.cost(outcome) == pytest.approx(0.04)
    doubled = judge.outcome(np.stack([start.points[0], 2 * start.points[0]]))
    assert doubled.stretch == pytest.approx(1.0)  # every length is twice what it was
    assert judge.cost(doubled) > doubled.point  # beyond what is allowed, and costs
    far = judge.outcome(np.stack([start.points[0], start.points[0] + [0, 0, -0.5]]))
    assert far.reach == pytest.approx(0.1, abs=0.006)  # the workspace ends 0.4 m below the lowest point


def test_both_directions_are_apart():
    # of a cloud that is half of the bar, each of its points is on the bar, but half of the bar is nowhere near it
    start = lying()
    half = start.points[0][start.points[0][:, 0] < 0]
    outcome = Judge.of(Goal("cloud", start.points[0], None, half), start, SMALL).outcome(start.points[[0, 0]])
    # 11 of its 21 columns are 1, 2, ... 11 cm from the nearest of the cloud
    assert np.isnan(outcome.point) and outcome.goal_to_body == 0 and outcome.body_to_goal == pytest.approx(0.66 / 21)


def test_a_pose_is_rigid_and_drawn_from_its_seed():
    start, task = lying(), get_task("pose")
    goal, same, other = (task.goal(start, seed=k) for k in (4, 4, 5))
    np.testing.assert_array_equal(goal.targets, same.targets)
    assert np.abs(goal.targets - other.targets).max() > 1e-3
    apart = lambda x: np.linalg.norm(x[:, None] - x, axis=2)  # noqa: E731
    np.testing.assert_allclose(apart(goal.targets), apart(start.points[0]), atol=1e-12)
    np.testing.assert_allclose(goal.targets[:, 2], start.points[0][:, 2], atol=1e-12)


def test_a_folded_bar_is_half_as_long_with_the_hands_end_on_the_other():
    goal = get_task("fold").goal(lying())
    assert goal.targets[:, 0].min() == pytest.approx(0, abs=1e-9)  # the hand is at x = -0.1
    np.testing.assert_allclose(goal.targets[0, :2], [0.1, -0.01], atol=1e-9)
    np.testing.assert_allclose(goal.targets[-1], lying().points[0, -1], atol=1e-9)


def test_a_rope_is_laid_out_at_its_length():
    # arc lengths of a quarter circle of radius 0.2 m are angles times radius, to the 3 mm that its points are wide
    angle = np.linspace(0, np.pi / 2, 80)
    rope = np.stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), 0 * angle], 1)
    np.testing.assert_allclose(arc_lengths(rope, rope[-1]), 0.2 * angle, atol=3e-3)
    thick = np.repeat(rope, 8, 0) + np.random.default_rng(0).uniform(-3e-3, 3e-3, (640, 3))  # a rope's skin, and its tracker's noise
    np.testing.assert_allclose(arc_lengths(thick, rope[-1]), 0.2 * np.repeat(angle, 8), atol=0.01)
    seen = np.ones((1, 80), bool)
    start = replace(lying(), points=rope[None], visible=seen, motion_valid=seen, controllers=rope[None, -3:])
    goal = get_task("rope-line").goal(start, seed=1)
    assert np.linalg.svd(goal.targets - goal.targets.mean(0), compute_uv=False)[1] < 1e-9  # in a line
    assert np.linalg.norm(goal.targets[-1] - goal.targets[0]) == pytest.approx(0.1 * np.pi, rel=0.02)
    letter = get_task("rope-l").goal(start, seed=1).targets
    assert abs((letter[0] - letter[40]) @ (letter[-1] - letter[60])) < 1e-9  # the corner of an L, at 1 / 1.6 of the length, is square
    with pytest.raises(ValueError, match="in one piece"):
        arc_lengths(np.concatenate([rope, rope + [5, 0, 0]]), rope[0])


def test_a_tip_alone_is_asked_for():
    goal = get_task("tip").goal(lying())
    assert 0 < goal.asked.sum() < 6 and goal.asked[-1]
    assert np.ptp(goal.targets[goal.asked], axis=0).max() == 0


@pytest.mark.parametrize("kind", [".npy", ".ply", ".csv", ".txt"])
def test_goal_clouds_are_read(tmp_path, kind):
    from twinbench.datasets.ply_file import write_vertices

    cloud, file = np.random.default_rng(0).normal(0, 0.1, (7, 3)), tmp_path / f"goal{kind}"
    if kind == ".npy":
        np.save(file, cloud)
    elif kind == ".ply":
        write_vertices(file, dict(zip("xyz", cloud.T.astype(np.float32), strict=True)))
    else:
        np.savetxt(file, cloud, delimiter="," if kind == ".csv" else " ")
    np.testing.assert_allclose(read_cloud(file), cloud, atol=1e-6)
    assert cloud_goal(file, lying()).targets is None


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("goal.npy", None, "no such file"),
        ("goal.obj", b"v 0 0 0", "must end in one of"),
        ("goal.npy", b"\x80\x04N.", "not a cloud"),
        ("goal.txt", b"1 2\n3 4\n5 6\n", r"shape \(points, 3\)"),
        ("goal.txt", b"1 2 3\n", "at least 3 points"),
        ("goal.txt", b"1 2 nan\n1 2 3\n1 2 4\n", "finite"),
        ("goal.csv", b"a,b,c\n", "not a cloud"),
    ],
)
def test_wrong_goal_clouds_are_refused(tmp_path, name, content, said):
    file = tmp_path / name
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ValueError, match=said) as caught:
        read_cloud(file)
    assert str(file) in str(caught.value)


def test_every_task_says_what_it_wants():
    assert {"rope-line", "fold", "pose", "tip"} <= set(tasks())
    for name, task in tasks().items():
        assert task.name == name and task.says
    with pytest.raises(ValueError, match="did you mean 'fold'"):
        get_task("folt")


# ---------------------------------------------------------------- plans of twins


@pytest.mark.long
def test_a_stiff_body_is_put_where_it_should_be():
    # every point goes where the hand goes, so that the plan's end is the goal's shift; 2 mm as for the quadratic
    start, shift = held(lying(), 30), np.array([0.12, -0.08, 0.05])
    config = PlanConfig(samples=64, updates=25, moving=25, resting=5)
    made = plan(RigidTwin.of(start), start, moved_goal(start, shift), config)
    assert made.moved[-1, 0] == pytest.approx(shift, abs=2e-3) and made.outcome.point < 4e-3
    assert made.rollouts == config.rollouts and made.diverged == 0 and made.controllers.shape == (30, 3, 3)


def solid():
    recording = lifted()
    body = Solid.told(recording, body_of(recording, kind="solid", pitch=0.02))
    return recording, ContinuumTwin(Scene.of(recording, body), dict(youngs_modulus=8e3))


def springs():
    recording = lifted()
    values = {p.name: p.value for p in SEARCHED} | dict(global_spring_Y=3e3, object_radius=0.016, controller_radius=0.02)
    place = Place.of(recording)
    return recording, PhysTwinTwin(build(values, place), place, Config(substeps=200))


@pytest.mark.parametrize("made", [solid, springs, lambda: (lifted(), RigidTwin.of(lifted()))], ids=["continuum", "phystwin", "rigid"])
def test_roll_outs_of_a_batch_are_those_of_single_ones(made):
    recording, twin = made()
    controls = Controls.of(recording, SMALL)
    ways = controls.feasible(np.random.default_rng(0).normal(0, 0.02, (3, *controls.shape)))
    together = twin.rollouts(controls.paths(ways))
    for path, one in zip(controls.paths(ways), together, strict=True):
        np.testing.assert_array_equal(twin.rollout(path).positions, one.positions)
    assert np.abs(together[0].positions - together[1].positions).max() > 1e-3


def test_what_blows_up_is_said_and_the_others_go_on():
    class Fragile(StaticTwin):
        def rollout(self, controllers):
            if np.abs(controllers - controllers[0]).max() > 0.01:
                raise Diverged("it blew up in frame 3", 3)
            return super().rollout(controllers)

    start = held(lying(), SMALL.frames)
    twin = Fragile.of(start)
    first, second = twin.rollouts(np.stack([start.controllers, start.controllers + np.linspace(0, 1, SMALL.frames)[:, None, None]]))
    assert first.positions.shape == (SMALL.frames, 42, 3) and isinstance(second, Diverged) and second.frame == 3
    made = plan(twin, start, moved_goal(start, [0.1, 0, 0]), SMALL)
    assert made.diverged > 0 and made.cost == pytest.approx(0.1)


@pytest.mark.long
def test_equal_twins_plan_alike(tmp_path):
    # the null: a twin and its copy from a file gain nothing over each other, to the last bit
    recording, twin = solid()
    start = held(recording, SMALL.frames)
    twin.save(tmp_path)
    goal = moved_goal(start, [0.05, 0.02, 0.0])
    first, second = (plan(one.retarget(start), start, goal, SMALL, seed=3) for one in (twin, ContinuumTwin.load(tmp_path)))
    np.testing.assert_array_equal(first.moved, second.moved)
    assert first.cost == second.cost and first.best == second.best


def test_a_twin_that_knows_nothing_plans_nothing():
    # all costs are equal, so that nothing is better than to hold still
    start = held(lying(), SMALL.frames)
    assert not plan(StaticTwin.of(start), start, moved_goal(start, [0.1, 0, 0]), SMALL).moved.any()


@pytest.mark.long
def test_only_frame_0_is_looked_at():
    recording, twin = solid()
    other = replace(recording, points=np.concatenate([recording.points[:1], recording.points[1:] + 0.3]))
    starts = [held(one, SMALL.frames) for one in (recording, other)]
    plans = [plan(twin.retarget(start), start, get_task("pose").goal(start), SMALL) for start in starts]
    np.testing.assert_array_equal(plans[0].moved, plans[1].moved)


def test_arms_are_read():
    for said in ("rigid", "continuum+wind", "continuum/shooting", "continuum+wind/shooting@2", "phystwin+diagnosed"):
        assert str(Arm.of(said)) == said
    wrong = {"rigit": "did you mean 'rigid'", "rigid+wind": "only continuum", "rigid/mpi": "mppi", "rigid@x": "whole number"}
    for said, why in wrong.items():
        with pytest.raises(ValueError, match=why):
            Arm.of(said)


def test_of_an_effect_the_name_is_told_and_the_amounts_are_fitted(monkeypatch):
    calls, (recording, twin) = [], solid()

    def noted(self, observed, config, **told):
        calls.append(told)
        return replace(twin, extra=told.get("extra", ()))

    monkeypatch.setattr(Continuum, "fitted", noted)
    known = {}
    windy = fitted(Arm.of("continuum+wind"), recording, budget=Budget(), known=known)
    assert set(known) == {"continuum", "continuum+wind"} and "extra" not in calls[0]
    assert {u.name for u in calls[1]["extra_unknowns"]} == {"wind_x", "wind_y", "wind_z", "wind_speed"} and not calls[1]["fixed"]
    assert calls[1]["begin"]["youngs_modulus"] == twin.values["youngs_modulus"]
    blown = replace(windy, values=windy.values | dict(wind_x=5.0, wind_speed=3.0))
    still, moved = (one.rollout(recording.controllers).positions for one in (windy, blown))
    assert (moved - still)[-1, :, 0].mean() > 1e-4  # downwind


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n, m in methods().items() if m.room == "methods"])
def test_every_method_can_be_planned_with_or_says_why_not(name):
    from twinbench.benchmark.opening import open_scenario

    trial = Trial.of_recording(open_scenario("sample/plush_lift"), "pose", PlanConfig(samples=2, updates=1), seed=0)
    attempt = trial.attempt(Arm.of(name))
    assert attempt.plan is not None or attempt.row["status"] not in ("", "ok")
    assert "Error" not in attempt.row["status"]


# ---------------------------------------------------------------- the truth


@pytest.fixture(scope="module")
def rope():
    """Dragged for the first two thirds of a second: how long is not what is tested."""
    whole = motions.draw
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motions, "draw", lambda *given: replace(whole(*given), frames=20))
        yield drawn("rope", "drag", seed=7)


def test_the_same_points_are_seen_of_a_plan_as_of_its_start(rope):
    # hands that do not move leave a rope on its table: the true points are those that were seen, within the tracker's noise (1.5 mm a
    # coordinate at 1 m, 6 sd) and the millimetre that it settles
    start = rope.start("drag", 8)
    true = rope.execute(start, np.zeros((8, 1, 3)))
    assert true.shape[1:] == start.scenario.points.shape[1:]
    assert np.abs(true - start.scenario.points[0]).max() < 0.012
    moved = np.zeros((8, 1, 3))
    moved[:, 0, 1] = np.linspace(0, 0.03, 8)
    held_end = np.argmin(np.linalg.norm(true[0] - start.scenario.controllers[0].mean(0), axis=1))
    gone = rope.execute(start, moved)[-1, held_end] - true[-1, held_end]
    assert gone == pytest.approx([0, 0.03, 0], abs=3e-3)  # in the recording's axes, and with the hand
    with pytest.raises(ValueError, match="moved must have shape"):
        rope.execute(start, np.zeros((8, 2, 3)))


@pytest.mark.long
def test_a_truth_is_drawn_from_its_seed_and_hides_what_is_asked(rope):
    np.testing.assert_array_equal(drawn("rope", "drag", seed=7).recording.points, rope.recording.points)
    heavy = drawn("rope", "drag", seed=7, hidden="added_mass")
    assert heavy.body.mass.sum() > rope.body.mass.sum() and not heavy.physics.laws
    for wrong, said in ((dict(body="rop"), "did you mean 'rope'"), (dict(hidden="wnd"), "did you mean 'wind'")):
        with pytest.raises(ValueError, match=said):
            drawn(**dict(body="rope", shows="drag", seed=1) | wrong)


@pytest.mark.slow
def test_an_experiment_is_resumed(tmp_path, capfd):
    asked = ["--out", str(tmp_path), "--tasks", "rope-line", "--starts", "0", "--arms", "static", "rigid", "--samples", "2"]
    asked += ["--updates", "1"]
    assert experiment.main(asked) == 0
    rows = json.loads((tmp_path / "cases" / "rope-line_none_0.json").read_text())
    assert [row["arm"] for row in rows] == ["static", "rigid"] and all(row["true_cost"] > 0 for row in rows)
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == 3
    written = (tmp_path / "cases" / "rope-line_none_0.json").stat().st_mtime_ns
    assert "1 to run" in capfd.readouterr().out and experiment.main(asked) == 0
    assert "0 to run" in capfd.readouterr().out
    assert (tmp_path / "cases" / "rope-line_none_0.json").stat().st_mtime_ns == written
    more = list(asked)
    more[more.index("--arms") + 1 : more.index("--samples")] = ["static", "rigid@1", "rigid"]
    assert experiment.main(more) == 0  # an arm that is added is run alone, with the twin that is there
    again = json.loads((tmp_path / "cases" / "rope-line_none_0.json").read_text())
    assert [row["arm"] for row in again] == ["static", "rigid@1", "rigid"] and again[0] == rows[0] and again[2] == rows[1]
    assert {p.name for p in (tmp_path / "twins" / "rope_drag_none_0_quick").iterdir()} == {"static", "rigid"}
    capfd.readouterr()
    with pytest.raises(ValueError, match="has plans of 2 roll-outs, got 4"):
        experiment.main([*more, "--updates", "2"])


def test_twins_of_an_experiment_come_back_from_the_disk_and_half_of_one_does_not(tmp_path):
    start = lying()
    twins = KnownTwins(tmp_path)
    assert "rigid" not in twins
    twins["rigid"] = RigidTwin.of(start)
    again = KnownTwins(tmp_path)
    path = start.controllers + np.linspace(0, 0.1, 4)[:, None, None]
    np.testing.assert_array_equal(again["rigid"].rollout(path).positions, twins["rigid"].rollout(path).positions)
    (tmp_path / "rigid" / "fitted").unlink()
    assert "rigid" not in KnownTwins(tmp_path)
    with pytest.raises(KeyError):
        KnownTwins(tmp_path)["rigid"]


def test_intervals_are_students():
    random = np.random.default_rng(0)
    first, second = random.normal(1, 1, 6), random.normal(0, 1, 6)
    mean, half = difference(first, second)
    low, high = ttest_rel(first, second).confidence_interval(0.95)
    assert (mean - half, mean + half) == pytest.approx((low, high))
    assert difference(pd.Series([np.nan, 1.0]), pd.Series([2.0, 0.5]))[0] == 0.5  # as a table's columns are, by place
    assert difference([1, np.nan], [0.5, 2])[0] == 0.5 and np.isnan(difference([np.nan], [1])[0])


def test_a_summary_counts_what_has_no_outcome():
    row = dict(task="pose", hidden="none", still=0.1, status="ok", twin_cost=0.01)
    rows = [row | dict(start=k, arm=arm, true_cost=0.01 * (k + far)) for k in range(3) for arm, far in (("one", 1), ("two", 2))]
    rows[-1] = row | dict(start=2, arm="two", status="it diverged")
    said = summary(rows)
    assert "| one | 3 of 3 | 20.0 |" in said and "| two | 2 of 3 | 25.0 |" in said and "+10.0 ± 0.0" in said
    assert "no outcome of two, start 2: it diverged" in said


# ---------------------------------------------------------------- the command


def test_the_command_writes_plans_a_table_and_a_page(tmp_path, capsys):
    out = tmp_path / "plan"
    asked = ["plan", "sample/plush_lift", "--task", "pose", "--methods", "static", "rigid", "--samples", "4", "--updates", "1", "--quiet"]
    assert main([*asked, "--out", str(out)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert "as each twin says" in said[0] and said[1].split()[0] == "arm" and said[4].startswith("static")
    outcome = json.loads((out / "outcome.json").read_text())
    assert [one["arm"] for one in outcome["arms"]] == ["static", "rigid"] and outcome["truth"] is None
    with np.load(out / "plan_rigid.npz") as found:
        assert found["controllers"].shape[0] == PlanConfig().frames and np.isfinite(found["predicted"]).all()
    page = (out / "plan.html").read_text()
    assert page.count("<svg") == 5 + 4 and "http" not in page.replace("http-equiv", "")  # a key and two views of each; from no network


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["sample/plush_lift", "--task", "pos"], "did you mean 'pose'"),
        (["sample/plush_lift", "--methods", "rigit"], "did you mean 'rigid'"),
        (["sample/nothing"], "none named 'nothing'"),
        (["sample/plush_lift", "--goal", "none.npy"], "none.npy: there is no such file"),
        (["sample/plush_lift", "--hidden", "wind"], "--hidden goes with"),
        (["rope:x"], "whole number"),
        (["sample/plush_lift", "--samples", "1"], "samples must be"),
    ],
)
def test_bad_input_is_one_line(arguments, said, capsys, tmp_path):
    assert main(["plan", *arguments, "--out", str(tmp_path / "out")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and said in lines[0]
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").iterdir())


@pytest.mark.slow
def test_the_page_of_plans_fits_a_screen_and_a_phone_and_needs_no_network(tmp_path, capsys):
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no chromium here: apt-get install chromium")
    asked = ["plan", "sample/plush_lift", "--task", "pose", "--methods", "rigid", "static", "--samples", "4", "--updates", "1"]
    assert main([*asked, "--out", str(tmp_path)]) == 0
    capsys.readouterr()
    with playwright.sync_playwright() as one:
        browser = one.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        context, wrong = browser.new_context(offline=True), []
        for width, height in ((1000, 700), (390, 780)):
            view = context.new_page()
            view.set_viewport_size(dict(width=width, height=height))
            view.on("pageerror", lambda error: wrong.append(str(error)))
            view.on("request", lambda request: wrong.append(request.url) if not request.url.startswith("file:") else None)
            view.goto((tmp_path / "plan.html").as_uri())
            assert view.evaluate("document.documentElement.scrollWidth") <= width
            assert view.locator("svg[role=img]").count() == 4  # two twins, each from above and from the side
        assert not wrong
        browser.close()
