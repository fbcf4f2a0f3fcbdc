"""What every method must do, run over every method that is found. A new method is in these tests as soon as its file is there."""

import json
import re
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache

import numpy as np
import pytest
from twinbench.datasets.scenario import Camera, Plane, Scenario, Split
from twinbench.methods.base import Budget, Trajectory, Twin
from twinbench.methods.registry import get_method, methods

FRAMES, TRAIN = 8, 5
# of a preset's work: enough to run every stage once
LEAST = dict(iterations=1, population=3, epochs=1, recordings=2, anchors=24, opacity_steps=2)


def camera(axis):
    """A camera 0.3 m from the bar that looks along world axis ``axis``; a pixel is 2.5 mm there."""
    pose = np.eye(4)
    pose[:3, :3] = np.roll(np.eye(3), axis + 1, axis=0)
    pose[:3, 3] = [0, 0, -0.1] - 0.3 * np.eye(3)[axis]
    return Camera(np.array([[120.0, 0, 31.5], [0, 120, 23.5], [0, 0, 1]]), pose, 64, 48)


CAMERAS = camera(1), camera(2)


@dataclass(frozen=True)
class Pictures:
    """What the cameras see of ``points`` (T, N, 3): a square of 3 x 3 pixels each; no hands."""

    points: np.ndarray
    frame_count: int

    def mask(self, camera, frame):
        if not 0 <= frame < self.frame_count:
            raise IndexError(f"frame {frame} is not within reach")
        found = np.zeros((48, 64), bool)
        pixels, depth = CAMERAS[camera].project(np.nan_to_num(self.points[frame]))
        for column, row in np.rint(pixels[depth > 0]).clip(-9, 99).astype(int):
            found[max(row - 1, 0) : max(row + 2, 0), max(column - 1, 0) : max(column + 2, 0)] = True
        return found

    def human_mask(self, camera, frame):
        return np.zeros_like(self.mask(camera, frame))

    def color(self, camera, frame):
        return np.repeat(self.mask(camera, frame)[..., None], 3, axis=2).astype(np.uint8) * 255

    def depth(self, camera, frame):
        return np.where(self.mask(camera, frame), 0.3, 0.0).astype(np.float32)

    def until(self, frame_count):
        return Pictures(self.points, min(frame_count, self.frame_count))


def scenario(name="made", *, phase=0.0, shift=(0.0, 0.0, 0.0)):
    """A bar of 48 particles, 5 mm apart, that is held at one end and bends up and down; not made by any simulator."""
    random = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(8), np.arange(3), np.arange(2), indexing="ij"), -1).reshape(-1, 3) * 0.005
    points = grid - grid.mean(0) + random.uniform(-8e-4, 8e-4, grid.shape) + [0, 0, -0.1] + shift
    beat = 0.02 * (np.sin(2 * np.pi * 2 * np.arange(FRAMES) / 30 + phase) - np.sin(phase))
    bend = beat[:, None] * (1 + 20 * (points[:, 0] - points[0, 0]))
    moved = points + bend[..., None] * [0, 0, 1]
    visible = random.random((FRAMES, 40)) < 0.9
    visible[0] = True
    hands = points[[0, 2, 5]] - [0.004, 0, 0]
    return Scenario(
        name=name,
        points=moved[:, :40],
        visible=visible,
        motion_valid=visible & np.roll(visible, -1, 0),
        controllers=hands + beat[:, None, None] * [0, 0, 1],
        surface=points[40:45],
        interior=points[45:],
        ground=Plane(np.array([0.0, 0.0, -1.0])),
        split=Split(TRAIN, FRAMES),
        tracks=moved[:, :4],
        cameras=CAMERAS,
        images=Pictures(moved[:, :40], FRAMES),
    )


def poisoned(how):
    """The same recording with test frames that say something else."""
    made = scenario()
    points, visible, valid, tracks = made.points.copy(), made.visible.copy(), made.motion_valid.copy(), made.tracks.copy()
    tracks[TRAIN:] = np.nan
    if how == "elsewhere":
        points[TRAIN:] = 900.0
        visible[TRAIN:] = valid[TRAIN:] = True
    else:
        points[TRAIN:] = np.nan
        visible[TRAIN:] = valid[TRAIN:] = False
    return replace(made, points=points, visible=visible, motion_valid=valid, tracks=tracks, images=Pictures(points, FRAMES))


def make(name):
    """A method that does as little as its stages allow."""
    method = get_method(name)
    if hasattr(method, "presets"):
        method.presets = {key: least(config) for key, config in method.presets.items()}
    return method


def least(config):
    if not is_dataclass(config):
        return config
    return replace(config, **{f.name: LEAST[f.name] for f in fields(config) if f.name in LEAST})


def fit(name, recordings, seed=0, **options):
    return make(name).fit([r.observed() for r in recordings], budget=Budget(), seed=seed, **options)


@cache
def fitted(name):
    return fit(name, [scenario()])


@pytest.fixture(params=sorted(methods()))
def name(request):
    reason = make(request.param).skip(scenario())
    assert reason is None or (isinstance(reason, str) and reason)
    if reason:
        pytest.skip(reason)
    return request.param


def positions(twin, controllers):
    return twin.rollout(controllers).positions


def test_a_roll_out_starts_in_frame_0_and_covers_every_frame(name):
    made, twin = scenario(), fitted(name)
    assert isinstance(twin, Twin)
    trajectory = twin.rollout(made.controllers)
    assert isinstance(trajectory, Trajectory) and trajectory.counts == made.counts == (40, 5, 3)
    assert trajectory.positions.shape == (FRAMES, 48, 3) and trajectory.positions.dtype == np.float32
    assert np.isfinite(trajectory.positions).all()
    np.testing.assert_allclose(trajectory.positions[0], made.structure, atol=1e-7)  # float32 at 0.1 m


def test_the_same_seed_gives_the_same_bits(name):
    path = scenario().controllers
    np.testing.assert_array_equal(positions(fit(name, [scenario()]), path), positions(fitted(name), path))


def test_a_roll_out_repeats_and_leaves_the_twin_as_it_was(name):
    path = scenario().controllers
    first = positions(fitted(name), path)
    positions(fitted(name), path[::-1])
    np.testing.assert_array_equal(positions(fitted(name), path), first)


def test_what_controllers_do_later_changes_nothing_before(name):
    if fitted(name).looks_ahead:
        pytest.skip("its twins say that they look ahead")
    path = scenario().controllers
    later = path.copy()
    later[5:] += 0.05
    np.testing.assert_array_equal(positions(fitted(name), later)[:5], positions(fitted(name), path)[:5])
    np.testing.assert_array_equal(positions(fitted(name), path[:5]), positions(fitted(name), path)[:5])


def test_a_twin_survives_saving_without_a_pickle(name, tmp_path):
    twin, path = fitted(name), scenario().controllers
    twin.save(tmp_path / "twin")
    for file in (tmp_path / "twin").rglob("*"):
        assert file.suffix in (".npz", ".json")
        if file.suffix == ".npz":
            with np.load(file, allow_pickle=False) as arrays:
                assert all(arrays[key].dtype != object for key in arrays)  # reading an object array raises ValueError
        else:
            json.loads(file.read_text(encoding="utf-8"))
    again = type(twin).load(tmp_path / "twin")
    assert type(again) is type(twin)
    np.testing.assert_array_equal(positions(again, path), positions(twin, path))


@pytest.mark.parametrize("how", ["elsewhere", "unseen"])
def test_test_frames_do_not_matter(name, how):
    path = scenario().controllers
    np.testing.assert_array_equal(positions(fit(name, [poisoned(how)]), path), positions(fitted(name), path))


def test_train_frames_matter(name):
    # the guard of the test above: poison cannot show in a method that never looks, and only the baselines may not
    made = scenario()
    points = made.points.copy()
    points[1:TRAIN] += [0.0, 0.03, 0.001]  # also along the way of the controllers
    changed = positions(fit(name, [replace(made, points=points, images=Pictures(points, FRAMES))]), made.controllers)
    assert np.array_equal(changed, positions(fitted(name), made.controllers)) == (name in ("static", "rigid"))


def test_a_twin_is_placed_in_another_recording(name):
    target = scenario("target", phase=2.0, shift=(0.2, -0.1, 0.0))
    if reason := make(name).skip_transfer:  # the rows say so, and nobody is given a twin that is not there
        with pytest.raises(ValueError, match=re.escape(reason)):
            fitted(name).retarget(target.initial())
        return
    twin = fitted(name).retarget(target.initial())
    trajectory = twin.rollout(target.controllers)
    assert trajectory.positions.shape == (FRAMES, sum(trajectory.counts), 3) and np.isfinite(trajectory.positions).all()
    # the same body, only shifted: it is found to well within the particles' spacing of 5 mm
    np.testing.assert_allclose(trajectory.positions[0], target.structure, atol=1e-4)


def test_a_twin_is_fitted_on_several_recordings_and_stands_in_the_first(name):
    other = scenario("other", phase=1.0)
    twin = fit(name, [other, scenario()])
    np.testing.assert_allclose(positions(twin, other.controllers)[0], other.structure, atol=1e-7)


def test_progress_is_a_stage_and_a_share(name):
    calls = []
    fit(name, [scenario()], progress=lambda stage, share: calls.append((stage, share)))
    assert all(isinstance(stage, str) and 0 <= share <= 1 for stage, share in calls)


@pytest.mark.parametrize("field", ["points", "controllers", "surface", "interior", "gravity"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_never_reaches_a_method(field, bad):
    values = np.array(getattr(scenario(), field))
    values[0] = bad
    with pytest.raises(ValueError, match=rf"{field} must be finite.*\(scenario made\)"):
        replace(scenario(), **{field: values})
