"""What every metric must do."""

from __future__ import annotations

import doctest
import sys
from dataclasses import dataclass, fields, replace

import numpy as np

from ...datasets.scenario import Camera, Plane, Scenario
from ...metrics.base import Metric, score
from .checking import Skipped, require
from .scene import COUNTS, FRAMES, recording, silhouette, truth

__all__ = ["CHECKS", "Prediction", "Subject"]

SCORED = tuple(range(1, FRAMES))
LOST = 4  # the frame in which something is wrong
OFF = 0.05  # m: farther than the bar is long


@dataclass(frozen=True)
class Prediction:
    """``positions`` (T, M, 3) m of the made recording's particles, and what cameras see of the tracked ones."""

    positions: np.ndarray

    @property
    def tracked(self):
        return self.positions[:, : COUNTS[0]]

    @property
    def surface(self):
        return self.positions[:, : COUNTS[0] + COUNTS[1]]

    def image(self, camera: Camera, frame: int) -> np.ndarray:
        """(H, W, 4): white where the body is."""
        return np.repeat(silhouette(self.tracked[frame], camera)[..., None], 4, axis=2).astype(float)


@dataclass(frozen=True)
class Subject:
    """A metric; called, it scores ``frames``."""

    metric: Metric

    def __call__(self, prediction, scenario: Scenario, frames=SCORED) -> np.ndarray:
        if reason := self.metric.unavailable():
            raise Skipped(f"it cannot run here: {reason}")
        return self.metric(prediction, scenario, frames)


def perfect() -> Prediction:
    """Where everything is."""
    return Prediction(truth())


def wrong(off: float = 0.004, seed: int = 0) -> Prediction:
    """A prediction that is ``off`` [m] everywhere in a direction of its own, but in frame 0."""
    random = np.random.default_rng(seed).normal(size=truth().shape)
    random *= off / np.linalg.norm(random, axis=2, keepdims=True)
    random[0] = 0
    return Prediction(truth() + random)


def unseen(scenario: Scenario, frame: int) -> Scenario:
    """The recording with nothing in ``frame`` that could be compared."""
    visible, tracks = scenario.visible.copy(), np.array(scenario.tracks)
    visible[frame], tracks[frame] = False, np.nan
    return replace(scenario, visible=visible, tracks=tracks, images=Holed(scenario.images, frame))


class Holed:
    """Images without those of one frame."""

    def __init__(self, images, frame: int):
        self._images, self._frame, self.frame_count = images, frame, images.frame_count

    def __getattr__(self, kind: str):
        read = getattr(self._images, kind)

        def reading(camera, frame):
            if frame == self._frame:
                raise ValueError(f"no {kind} of frame {frame}")
            return read(camera, frame)

        return reading


def it_says_what_it_is(subject):
    metric = subject.metric
    doc = type(metric).__doc__
    require(isinstance(doc, str) and doc.strip() and doc != Metric.__doc__, "its class must have a docstring, which lists print")
    reason = metric.unavailable()
    require(
        reason is None or (isinstance(reason, str) and reason), f"unavailable must return None or the reason as a string, got {reason!r}"
    )


def it_has_one_number_for_each_frame_asked_for(subject):
    made, predicted = recording(), wrong()
    values = subject(predicted, made)
    require(np.isfinite(values).all(), f"it must have a value wherever all is seen, got {values}")
    for frames in ((), (3,), (5, 1, 1), SCORED[::-1]):
        expected = [values[SCORED.index(frame)] for frame in frames]
        np.testing.assert_allclose(subject(predicted, made, frames), expected, rtol=1e-12, err_msg=f"frames {frames}")


def the_same_input_has_the_same_value_and_is_left_as_it_was(subject):
    made, predicted = recording(), wrong()
    before = predicted.positions.copy()
    first = subject(predicted, made)
    subject(wrong(seed=1), made)
    np.testing.assert_array_equal(subject(predicted, made), first)
    np.testing.assert_array_equal(predicted.positions, before)


def a_perfect_prediction_is_the_best_and_a_far_one_worse(subject):
    made, sign = recording(), 1 if subject.metric.direction == "lower" else -1
    best = sign * subject(perfect(), made)
    require(not np.isnan(best).any(), f"a perfect prediction must have a value, got {sign * best}")
    for seed, off in enumerate((0.002, 0.01, OFF)):
        worse = sign * subject(wrong(off, seed), made)
        require((worse >= best - 1e-12).all(), f"{off} m off it says {sign * worse}, and of a perfect prediction {sign * best}")
    far = perfect().positions.copy()
    far[1:] += OFF
    worse = sign * subject(Prediction(far), made)
    require((worse > best).all(), f"{OFF} m off it says {sign * worse}, and of a perfect prediction {sign * best}: no worse")


def a_frame_with_nothing_to_compare_is_NaN_and_has_a_reason(subject):
    made, predicted = recording(), wrong()
    empty = unseen(made, LOST)
    values, usual = subject(predicted, empty), subject(predicted, made)
    i = SCORED.index(LOST)
    require(np.isnan(values[i]), f"frame {LOST}, in which nothing was seen, must be NaN, got {values[i]}")
    np.testing.assert_allclose(np.delete(values, i), np.delete(usual, i), rtol=1e-12, err_msg="the other frames changed")
    reason = subject.metric.reason(predicted, empty, LOST)
    require(isinstance(reason, str) and reason, f"reason must say in words why a frame is NaN, got {reason!r}")
    found = score(subject.metric, predicted, empty, SCORED)
    require((found.frames, found.unscorable) == (len(SCORED), 1), f"one frame of {len(SCORED)} must be counted as unscorable, got {found}")


def a_recording_with_nothing_to_compare_has_no_value(subject):
    made = recording()
    bare = replace(made, visible=np.zeros_like(made.visible), tracks=None, images=None, cameras=())
    values = subject(wrong(), bare)
    require(np.isnan(values).all(), f"nothing was seen, so all must be NaN, got {values}")
    reason = subject.metric.reason(wrong(), bare, 1)
    require(isinstance(reason, str) and reason, f"reason must say in words why a frame is NaN, got {reason!r}")


def a_prediction_that_is_not_finite_has_no_value_there(subject):
    for bad in (np.nan, np.inf):
        broken = wrong().positions.copy()
        broken[LOST] = bad
        value = subject(Prediction(broken), recording())[SCORED.index(LOST)]
        require(np.isnan(value), f"frame {LOST}, in which all is {bad}, must be NaN, got {value}")


def what_was_not_seen_does_not_matter(subject):
    made, predicted = recording(), wrong()
    expected = subject(predicted, made)
    for junk in (np.nan, 1e6):
        points = made.points.copy()
        points[~made.visible] = junk
        np.testing.assert_allclose(subject(predicted, replace(made, points=points)), expected, rtol=1e-12)


def names_and_the_split_do_not_matter(subject):
    made, predicted = recording(), wrong()
    other = replace(made.with_split(2), name="other", object="thing", session="take", self_collision=True)
    np.testing.assert_array_equal(subject(predicted, other), subject(predicted, made))


def moving_everything_alike_changes_nothing(subject):
    if subject.metric.images:
        raise Skipped("it looks at images, where a pixel may change sides")
    made, predicted, way = recording(), wrong(), np.array([0.7, -0.3, 0.2])
    moved = {
        f.name: getattr(made, f.name) + way for f in fields(made) if f.name in ("points", "controllers", "surface", "interior", "tracks")
    }
    assert made.ground is not None  # of the scene of these checks
    there = replace(made, **moved, ground=Plane(made.ground.normal, made.ground.offset + float(made.ground.normal @ way)))
    # coordinates of order 1 in float64: rounding below 1e-15
    np.testing.assert_allclose(subject(Prediction(predicted.positions + way), there), subject(predicted, made), rtol=1e-9, atol=1e-12)


def frames_outside_are_refused(subject):
    for frame in (-1, FRAMES):
        try:
            subject(wrong(), recording(), (1, frame))
        except ValueError as error:
            require(str(frame) in str(error), f"the ValueError for frame {frame} must name it, got {str(error)!r}")
        else:
            raise AssertionError(f"frame {frame} of {FRAMES} must raise ValueError")


def the_examples_in_its_documentation_hold(subject):
    found = doctest.testmod(sys.modules[type(subject.metric).__module__], extraglobs={"np": np}, optionflags=doctest.NORMALIZE_WHITESPACE)
    if not found.attempted:
        raise Skipped("there are none")
    require(not found.failed, f"{found.failed} of {found.attempted} fail: python -m doctest shows them")


CHECKS = (
    it_says_what_it_is,
    it_has_one_number_for_each_frame_asked_for,
    the_same_input_has_the_same_value_and_is_left_as_it_was,
    a_perfect_prediction_is_the_best_and_a_far_one_worse,
    a_frame_with_nothing_to_compare_is_NaN_and_has_a_reason,
    a_recording_with_nothing_to_compare_has_no_value,
    a_prediction_that_is_not_finite_has_no_value_there,
    what_was_not_seen_does_not_matter,
    names_and_the_split_do_not_matter,
    moving_everything_alike_changes_nothing,
    frames_outside_are_refused,
    the_examples_in_its_documentation_hold,
)
