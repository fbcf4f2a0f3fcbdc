"""Metrics against independent implementations, worked-out numbers and properties."""

import doctest
import math
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.distance import cdist
from twinbench.datasets.scenario import Scenario, Split
from twinbench.metrics.base import get_metric, metrics, score
from twinbench.metrics.chamfer import one_sided_chamfer
from twinbench.metrics.coordinate_error import mean_absolute_difference

NAMES = ("chamfer", "chamfer_l2", "coordinate_error", "track_error")
ROUNDING = 1e-12  # metres; float64 sums of a few hundred terms of order 1


def scenario(points, *, visible=None, tracks=None, surface=None, interior=None, train_end=2):
    points = np.asarray(points, float)
    frames, count = points.shape[:2]
    visible = np.ones((frames, count), bool) if visible is None else np.asarray(visible)
    return Scenario(
        name="made",
        points=points,
        visible=visible,
        motion_valid=np.zeros((frames, count), bool),
        controllers=np.zeros((frames, 0, 3)),
        surface=np.zeros((0, 3)) if surface is None else surface,
        interior=np.zeros((0, 3)) if interior is None else interior,
        split=Split(train_end, frames),
        tracks=tracks,
    )


def prediction(positions, tracked, surface=0):
    positions = np.asarray(positions, float)
    return SimpleNamespace(positions=positions, tracked=positions[:, :tracked], surface=positions[:, : tracked + surface])


def random_case(seed, *, frames=5, tracked=20, surface=10, interior=5):
    """A body in random motion, a third of its points unseen, 6 tracks of which some are missing; and a wrong prediction of it."""
    random = np.random.default_rng(seed)
    body = random.normal(size=(tracked + surface + interior, 3))
    truth = body + np.cumsum(random.normal(scale=0.1, size=(frames, 1, 3)), axis=0)
    visible = random.random((frames, tracked)) < 0.66
    visible[:, 0] = True
    tracks = truth[:, :6] + 0.01
    tracks[random.random((frames, 6)) < 0.3] = np.nan
    tracks[:, 5] = truth[:, 5]
    made = scenario(
        truth[:, :tracked], visible=visible, tracks=tracks, surface=truth[0, tracked : tracked + surface], interior=truth[0, -interior:]
    )
    predicted = truth + random.normal(scale=0.05, size=truth.shape) * np.arange(frames)[:, None, None]
    return made, prediction(predicted, tracked, surface)


def brute_force(name, made, predicted, frame):
    """The definitions once more, by full distance tables."""
    points, seen = made.points[frame], made.visible[frame]
    if name.startswith("chamfer"):
        kind = "cityblock" if name == "chamfer" else "euclidean"
        return cdist(points[seen], predicted.surface[frame], kind).min(axis=1).mean()
    if name == "coordinate_error":
        return np.mean([abs(points[i, k] - predicted.tracked[frame, i, k]) for i in np.flatnonzero(seen) for k in range(3)])
    errors = []
    for k in range(made.tracks.shape[1]):
        if not np.isnan(made.tracks[0, k]).any() and not np.isnan(made.tracks[frame, k]).any():
            j = cdist(made.tracks[:1, k], predicted.positions[0]).argmin()
            errors.append(math.dist(made.tracks[frame, k], predicted.positions[frame, j]))
    return np.mean(errors)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_brute_force(name, seed):
    made, predicted = random_case(seed)
    values = get_metric(name)(predicted, made, range(1, 5))
    assert values == pytest.approx([brute_force(name, made, predicted, t) for t in range(1, 5)], abs=ROUNDING)


def test_worked_out_by_hand():
    # Two points at 0 and x=1; in frame 1 both have moved by (0.3, 0.4, 0) and the prediction has not moved.
    made = scenario([[[0, 0, 0], [1, 0, 0]], [[0.3, 0.4, 0], [1.3, 0.4, 0]]], tracks=[[[0.1, 0, 0]], [[0.4, 0.4, 0]]])
    still = prediction([[[0, 0, 0], [1, 0, 0]]] * 2, 2)
    for name, expected in {
        "chamfer": 0.7,  # |0.3| + |0.4|, the same for both points
        "chamfer_l2": 0.5,  # the 3-4-5 triangle
        "coordinate_error": 0.7 / 3,  # (0.3 + 0.4 + 0) / 3
        "track_error": math.hypot(0.4, 0.4),  # matched with the particle at 0
    }.items():
        assert get_metric(name)(still, made, [1]) == pytest.approx([expected], abs=ROUNDING), name


def test_the_manhattan_nearest_is_not_the_euclidean_nearest():
    # From 0, particle (0.5, 0.5, 0) is nearer in L2 (0.71 < 0.9) and (0.9, 0, 0) is nearer in L1 (0.9 < 1).
    made = scenario([[[0, 0, 0]]] * 2)
    predicted = prediction([[[0.5, 0.5, 0], [0.9, 0, 0]]] * 2, 1, surface=1)
    assert get_metric("chamfer")(predicted, made, [1]) == pytest.approx([0.9], abs=ROUNDING)
    assert get_metric("chamfer_l2")(predicted, made, [1]) == pytest.approx([math.sqrt(0.5)], abs=ROUNDING)


def test_chamfer_leaves_interior_particles_out_and_track_error_does_not():
    made = scenario([[[0, 0, 0]]] * 2, tracks=np.zeros((2, 1, 3)))
    predicted = prediction([[[1, 0, 0], [0, 0, 0]]] * 2, 1)  # the second particle is an interior one
    assert get_metric("chamfer")(predicted, made, [1]) == pytest.approx([1.0], abs=ROUNDING)
    assert get_metric("track_error")(predicted, made, [1]) == pytest.approx([0.0], abs=ROUNDING)


def test_a_frame_that_cannot_be_scored_is_nan_and_counted():
    tracks = np.zeros((4, 1, 3))
    tracks[2] = np.nan
    made = scenario(np.zeros((4, 1, 3)), visible=[[True], [True], [False], [True]], tracks=tracks)
    moved = prediction(np.full((4, 1, 3), 0.1), 1)
    for name in NAMES:
        result = score(get_metric(name), moved, made, range(1, 4))
        assert (result.frames, result.unscorable) == (3, 1), name
        assert np.isfinite(result.mean) and result.mean > 0, name


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_prediction_that_blew_up_has_no_score(name, bad):
    made, predicted = random_case(0)
    positions = predicted.positions.copy()
    positions[3] = bad
    broken = prediction(positions, 20, 10)
    values = get_metric(name)(broken, made, range(1, 5))
    assert np.isnan(values[2]) and np.isfinite(values[[0, 1, 3]]).all()
    assert math.isnan(score(get_metric(name), broken, made, range(1, 5)).mean)


def test_no_tracks_no_track_error():
    made, predicted = random_case(0)
    result = score(get_metric("track_error"), predicted, scenario(made.points), range(1, 5))
    assert math.isnan(result.mean) and result.unscorable == 4


def test_tracks_that_begin_later_are_not_used():
    tracks = np.zeros((3, 2, 3))
    tracks[0, 1] = np.nan
    tracks[1:, 1] = 9.0
    made = scenario(np.zeros((3, 1, 3)), tracks=tracks)
    assert get_metric("track_error")(prediction(np.zeros((3, 1, 3)), 1), made, [1, 2]).tolist() == [0, 0]


def test_coordinate_error_needs_the_same_points():
    made, predicted = random_case(0)
    metric = get_metric("coordinate_error")
    fewer = prediction(predicted.positions[:, 1:], 19, 10)
    order = np.r_[np.roll(np.arange(20), 1), np.arange(20, 35)]
    shuffled = prediction(predicted.positions[:, order], 20, 10)
    for other in (fewer, shuffled):
        assert np.isnan(metric(other, made, [1, 2])).all()


@pytest.mark.parametrize("frame", [-1, 5, 99])
def test_frames_outside_are_refused(frame):
    made, predicted = random_case(0)
    with pytest.raises(ValueError, match=f"chamfer: frame {frame} is outside the 5 predicted frames"):
        get_metric("chamfer")(predicted, made, [1, frame])


def test_every_metric_states_what_it_is():
    found = metrics()
    assert set(NAMES) <= set(found)
    for name, metric in found.items():
        assert metric.name == name and metric.__doc__
        assert metric.direction in ("lower", "higher") and metric.version >= 1 and isinstance(metric.unit, str)


@pytest.mark.parametrize("name", NAMES)
def test_the_examples_run(name):
    result = doctest.testmod(import_module(f"twinbench.metrics.{name}"), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted and not result.failed


def test_unknown_name_suggests_the_nearest():
    with pytest.raises(ValueError, match="did you mean 'chamfer'"):
        get_metric("chamfre")


coordinates = st.floats(-10, 10, allow_nan=False, width=32)
clouds = arrays(np.float64, st.tuples(st.integers(1, 12), st.just(3)), elements=coordinates)


@settings(max_examples=60, deadline=None)
@given(clouds, clouds, st.randoms(use_true_random=False))
def test_chamfer_properties(observed, predicted, random):
    for norm in (1, 2):
        value = one_sided_chamfer(observed, predicted, norm=norm)
        table = cdist(observed, predicted, "minkowski", p=norm)
        assert value == pytest.approx(table.min(axis=1).mean(), abs=1e-9)  # coordinates to 10: rounding below 1e-9
        shuffled = predicted[random.sample(range(len(predicted)), len(predicted))]
        assert one_sided_chamfer(observed, shuffled, norm=norm) == pytest.approx(value, abs=1e-9)
        assert one_sided_chamfer(observed, np.concatenate([predicted, observed]), norm=norm) == 0
    manhattan, euclidean = (one_sided_chamfer(observed, predicted, norm=norm) for norm in (1, 2))
    assert euclidean - 1e-9 <= manhattan <= math.sqrt(3) * euclidean + 1e-9  # |x|_2 <= |x|_1 <= sqrt(3) |x|_2 in three dimensions


@settings(max_examples=60, deadline=None)
@given(clouds, arrays(np.float64, 3, elements=coordinates))
def test_coordinate_error_of_a_translation(points, shift):
    # mean |x + s - x| over points and coordinates = (|s_x| + |s_y| + |s_z|) / 3
    assert mean_absolute_difference(points, points + shift) == pytest.approx(np.abs(shift).mean(), abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), arrays(np.float64, 3, elements=st.floats(-1, 1)))
def test_a_translation_of_everything_changes_nothing(seed, shift):
    made, predicted = random_case(seed)
    moved = scenario(made.points + shift, visible=made.visible, tracks=made.tracks + shift, surface=made.surface, interior=made.interior)
    shifted = prediction(predicted.positions + shift, 20, 10)
    for name in NAMES:
        before, after = (get_metric(name)(p, s, range(1, 5)) for p, s in ((predicted, made), (shifted, moved)))
        assert after == pytest.approx(before, abs=1e-9, nan_ok=True), name


@pytest.mark.parametrize("name", NAMES)
def test_a_perfect_prediction_scores_zero(name):
    made, _ = random_case(3)
    tracks = made.points[:, :4].copy()
    tracks[~made.visible[:, :4]] = np.nan
    exact = scenario(made.points, visible=made.visible, tracks=tracks)
    perfect = prediction(made.points, 20)
    assert get_metric(name)(perfect, exact, range(1, 5)) == pytest.approx([0] * 4, abs=ROUNDING)
