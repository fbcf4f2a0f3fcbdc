"""What every method must do."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.scenario import Scenario
from ...methods.base import Budget, Method, Trajectory, Twin
from ...methods.registry import methods
from .checking import Skipped, require
from .scene import COUNTS, FRAMES, TRAIN, Pictures, recording

__all__ = ["CHECKS", "Subject"]

# of a preset's work: enough to run every stage once
LEAST = dict(iterations=1, population=3, epochs=1, recordings=2, anchors=24, opacity_steps=2)
LEAST |= dict(starts=1, refinement=1, members=4, pitch=3.0)
SINGLE = 1e-7  # m: float32 at 0.1 m


@dataclass(frozen=True)
class Subject:
    """A method, as ``found`` makes it, and a twin of the made recording."""

    found: Callable[[], Method]

    def make(self) -> Method:
        """The method, doing as little as its stages allow."""
        method: Any = self.found()
        if hasattr(method, "presets"):
            method.presets = {key: _least(config) for key, config in method.presets.items()}
        return method

    def fit(self, *recordings: Scenario, **options) -> Twin:
        """A twin of the train frames of ``recordings``."""
        if reason := self.make().skip(recordings[0]):
            raise Skipped(f"it says that it cannot run on the made recording: {reason}")
        return self.make().fit([one.observed() for one in recordings], budget=Budget(), **{"seed": 0, **options})

    @cached_property
    def fitted(self) -> Twin:
        """The twin of the made recording."""
        return self.fit(recording())

    @cached_property
    def again(self) -> tuple[Twin, list[tuple[Any, Any]]]:
        """The twin of the same recording fitted anew, and what the fit told of its progress."""
        told: list[tuple[Any, Any]] = []
        return self.fit(recording(), progress=lambda stage, share: told.append((stage, share))), told


def _least(config: Any):
    if not is_dataclass(config):
        return config
    made: Any = config
    return replace(made, **{f.name: LEAST[f.name] for f in fields(made) if f.name in LEAST})


def _same(twin: Twin, other: Twin, controllers=None) -> None:
    """Raises AssertionError unless two twins do the same, bit for bit."""
    path = recording().controllers if controllers is None else controllers
    np.testing.assert_array_equal(twin.rollout(path).positions, other.rollout(path).positions)


def it_says_what_it_is(subject):
    method, made = subject.make(), recording()
    require(
        isinstance(type(method).__doc__, str) and str(type(method).__doc__).strip(), "its class must have a docstring, which lists print"
    )
    for one in (made, replace(made, controllers=np.zeros((FRAMES, 0, 3)), grips=None), replace(made, images=None, cameras=())):
        reason = method.skip(one)
        require(reason is None or (isinstance(reason, str) and reason), f"skip must return None or the reason as a string, got {reason!r}")
    if method.builds_on:
        require(method.builds_on in methods(), f"it builds on {method.builds_on!r}, which is no method")
        below = set(methods()[method.builds_on].reads_images) - set(method.reads_images)
        require(not below, f"reads_images lacks {', '.join(sorted(below))}, which {method.builds_on} looks at")


def a_roll_out_starts_in_frame_0_and_covers_every_frame(subject):
    made, twin = recording(), subject.fitted
    promised: Any = getattr(subject.make(), "twin_class", None)
    sound = isinstance(promised, type) and issubclass(promised, Twin)
    require(sound, f"twin_class must be the class of what fit returns, got {promised!r}")
    require(isinstance(twin, promised), f"fit must return a {promised.__name__}, its twin_class, got {type(twin).__name__}")
    trajectory = twin.rollout(made.controllers)
    require(isinstance(trajectory, Trajectory), f"rollout must return a Trajectory, got {type(trajectory).__name__}")
    require(trajectory.counts == made.counts == COUNTS, f"counts must be {COUNTS}, got {trajectory.counts}")
    shape = np.shape(trajectory.positions)
    require(shape == (FRAMES, sum(COUNTS), 3), f"positions must have shape {(FRAMES, sum(COUNTS), 3)}, got {shape}")
    require(trajectory.positions.dtype == np.float32, f"positions must be float32, got {trajectory.positions.dtype}")
    require(np.isfinite(trajectory.positions).all(), "positions must be finite")
    np.testing.assert_allclose(trajectory.positions[0], made.structure, rtol=0, atol=SINGLE)


def the_same_seed_gives_the_same_bits(subject):
    _same(subject.again[0], subject.fitted)  # whether or not somebody listens to its progress


def a_roll_out_repeats_and_leaves_the_twin_as_it_was(subject):
    path = recording().controllers
    first = subject.fitted.rollout(path).positions
    subject.fitted.rollout(path[::-1])
    np.testing.assert_array_equal(subject.fitted.rollout(path).positions, first)


def what_controllers_do_later_changes_nothing_before(subject):
    if subject.fitted.looks_ahead:
        raise Skipped("its twins say that they look ahead")
    path = recording().controllers
    later = path.copy()
    later[5:] += 0.05
    roll = subject.fitted.rollout
    np.testing.assert_array_equal(roll(later).positions[:5], roll(path).positions[:5])
    np.testing.assert_array_equal(roll(path[:5]).positions, roll(path).positions[:5])


def a_twin_survives_saving_without_a_pickle(subject):
    twin = subject.fitted
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder) / "twin"
        twin.save(folder)
        files = [file for file in folder.rglob("*") if file.is_file()]
        require(files, "save wrote no file")
        for file in files:
            require(file.suffix in (".npz", ".json"), f"a twin is saved as .npz and .json files, got {file.name}")
            if file.suffix == ".npz":
                with np.load(file, allow_pickle=False) as arrays:
                    require(all(arrays[key].dtype != object for key in arrays), f"{file.name} holds Python objects")
            else:
                json.loads(file.read_text(encoding="utf-8"))
        again = type(twin).load(folder)
    require(type(again) is type(twin), f"load must return a {type(twin).__name__}, got {type(again).__name__}")
    _same(again, twin)


def held_out_frames_do_not_matter(subject):
    usual = subject.make().skip(recording())
    for elsewhere in (True, False):
        poisoned = _poisoned(elsewhere)
        reason = subject.make().skip(poisoned)  # or fit would be left out, and nothing compared
        require(reason == usual, f"skip must say the same whatever test frames show, got {reason!r} instead of {usual!r}")
        _same(subject.fit(poisoned), subject.fitted)


def _poisoned(elsewhere: bool) -> Scenario:
    """The made recording with test frames that say something else: points far away, or none at all."""
    made = recording()
    points, visible, valid, tracks = made.points.copy(), made.visible.copy(), made.motion_valid.copy(), np.array(made.tracks)
    tracks[TRAIN:] = np.nan
    points[TRAIN:] = 900.0 if elsewhere else np.nan
    visible[TRAIN:] = valid[TRAIN:] = elsewhere
    return replace(made, points=points, visible=visible, motion_valid=valid, tracks=tracks, images=Pictures(points, FRAMES))


def train_frames_matter(subject):
    # the guard of the check above: poison cannot show in a method that never looks
    made = recording()
    points = made.points.copy()
    along = points[0, :, :1] - points[0, :, 0].min()
    points[1:TRAIN] += along / along.max() * [0.0, 0.03, 0.001]  # the free end swings aside; the hand keeps what it holds
    changed = subject.fit(replace(made, points=points, images=Pictures(points, FRAMES)))
    if np.array_equal(*(twin.rollout(made.controllers).positions for twin in (changed, subject.fitted))):
        raise Skipped("its twins are the same whatever the train frames show: a baseline that looks at frame 0 only")


def a_twin_is_placed_in_another_recording(subject):
    target = recording("target", phase=2.0, shift=(0.2, -0.1, 0.0))
    if reason := subject.make().skip_transfer:  # the rows say so, and nobody is given a twin that is not there
        try:
            subject.fitted.retarget(target.initial())
        except ValueError as error:
            require(reason in str(error), f"retarget must raise ValueError with skip_transfer, {reason!r}, got {str(error)!r}")
            return
        raise AssertionError(f"retarget must raise ValueError, as skip_transfer says: {reason}")
    trajectory = subject.fitted.retarget(target.initial()).rollout(target.controllers)
    require(trajectory.positions.shape == (FRAMES, sum(trajectory.counts), 3), f"positions have shape {trajectory.positions.shape}")
    require(np.isfinite(trajectory.positions).all(), "positions must be finite")
    # the same body, only shifted: it is found to well within the particles' spacing of 5 mm
    np.testing.assert_allclose(trajectory.positions[0], target.structure, rtol=0, atol=1e-4)


def a_twin_is_fitted_on_several_recordings_and_stands_in_the_first(subject):
    other = recording("other", phase=1.0)
    twin = subject.fit(other, recording())
    np.testing.assert_allclose(twin.rollout(other.controllers).positions[0], other.structure, rtol=0, atol=SINGLE)


def progress_is_a_stage_and_a_share(subject):
    for stage, share in subject.again[1]:
        said = f"progress must be told a string and a share in [0, 1], got {stage!r} and {share!r}"
        require(isinstance(stage, str) and 0 <= share <= 1, said)


CHECKS = (
    it_says_what_it_is,
    a_roll_out_starts_in_frame_0_and_covers_every_frame,
    the_same_seed_gives_the_same_bits,
    a_roll_out_repeats_and_leaves_the_twin_as_it_was,
    what_controllers_do_later_changes_nothing_before,
    a_twin_survives_saving_without_a_pickle,
    held_out_frames_do_not_matter,
    train_frames_matter,
    a_twin_is_placed_in_another_recording,
    a_twin_is_fitted_on_several_recordings_and_stands_in_the_first,
    progress_is_a_stage_and_a_share,
)
