"""What a recording is, what it refuses, and that a method cannot reach the frames it is scored on."""

import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reaching import reachable
from twinbench.datasets.scenario import Camera, Observed, Plane, Scenario, Split, TransferPair

T, N, C, TRAIN = 10, 4, 2, 6
HIDDEN = 777.0  # every number of a test frame and of the ground-truth tracks is this, so that a leak is seen wherever it is


class Pictures:
    """Images in memory whose test frames hold HIDDEN; ``until`` copies what may be seen."""

    def __init__(self, frames):
        self.frames, self.frame_count = frames, len(frames)

    def color(self, camera, frame):
        if not 0 <= frame < self.frame_count:
            raise IndexError(frame)
        return self.frames[frame]

    depth = mask = human_mask = color

    def until(self, frame_count):
        return Pictures([f.copy() for f in self.frames[:frame_count]])


def values(**changes):
    rng = np.random.default_rng(0)
    points, colors = rng.normal(size=(T, N, 3)), rng.random((T, N, 3))
    points[TRAIN:] = colors[TRAIN:] = HIDDEN
    frames = [np.full((2, 2), float(t)) for t in range(TRAIN)] + [np.full((2, 2), HIDDEN)] * (T - TRAIN)
    return {
        "name": "rope",
        "points": points,
        "visible": np.ones((T, N), bool),
        "motion_valid": np.ones((T, N), bool),
        "controllers": rng.normal(size=(T, C, 3)),
        "surface": rng.normal(size=(3, 3)),
        "interior": rng.normal(size=(5, 3)),
        "colors": colors,
        "images": Pictures(frames),
        "split": Split(TRAIN, T),
        "tracks": np.full((T, 2, 3), HIDDEN),
        **changes,
    }


def scenario(**changes):
    return Scenario(**values(**changes))


def with_nan(shape, at):
    array = np.zeros(shape)
    array[at] = np.nan
    return array


# --- what is refused ------------------------------------------------------------------------------------------------------

REFUSED = {
    "flat points": ({"points": np.zeros((T, 3))}, r"points must have shape \(frames, points, 3\), got \(10, 3\)"),
    "2-D points": ({"points": np.zeros((T, N, 2))}, r"points must have shape \(frames, points, 3\), got \(10, 4, 2\)"),
    "text": ({"points": np.full((T, N, 3), "x")}, r"points must hold numbers, got dtype <U1"),
    "objects": ({"points": np.full((T, N, 3), None)}, r"points must hold numbers, got dtype object"),
    "complex": ({"controllers": np.zeros((T, C, 3), complex)}, r"controllers must hold numbers"),
    "no points": (
        {"points": np.zeros((T, 0, 3)), "visible": np.ones((T, 0)), "motion_valid": np.ones((T, 0)), "colors": None},
        r"at least one frame and one tracked point",
    ),
    "visible": ({"visible": np.ones((T, N + 1), bool)}, r"visible must have shape \(10, 4\), got \(10, 5\)"),
    "motion_valid": ({"motion_valid": np.ones((T - 1, N), bool)}, r"motion_valid must have shape \(10, 4\), got \(9, 4\)"),
    "flat controllers": ({"controllers": np.zeros((T, 3))}, r"controllers must have shape"),
    "short controllers": ({"controllers": np.zeros((T - 1, C, 3))}, r"controllers must have shape \(10, controllers, 3\), got \(9, 2, 3\)"),
    "long controllers": ({"controllers": np.zeros((T + 1, C, 3))}, r"controllers must have shape \(10, controllers, 3\), got \(11, 2, 3\)"),
    "NaN controllers": ({"controllers": with_nan((T, C, 3), 3)}, r"controllers must be finite"),
    "NaN visible": ({"points": with_nan((T, N, 3), (3, 1))}, r"points must be finite wherever visible"),
    "infinite": ({"points": np.full((T, N, 3), np.inf)}, r"points must be finite wherever visible"),
    "NaN start": ({"points": with_nan((T, N, 3), (0, 1)), "visible": np.zeros((T, N))}, r"points must be finite in frame 0"),
    "surface": ({"surface": np.zeros((3, 2))}, r"surface must have shape \(points, 3\), got \(3, 2\)"),
    "one surface point": ({"surface": np.zeros(3)}, r"surface must have shape"),
    "NaN interior": ({"interior": with_nan((3, 3), 0)}, r"interior must be finite"),
    "colors": ({"colors": np.zeros((T, N))}, r"colors must have shape \(10, 4, 3\), got \(10, 4\)"),
    "gravity": ({"gravity": 9.8}, r"gravity must have shape \(3,\), got \(\)"),
    "NaN gravity": ({"gravity": [0, 0, np.nan]}, r"gravity must be finite"),
    "fps 0": ({"fps": 0}, r"fps must be a number from 0.1 .*, got 0"),
    "fps NaN": ({"fps": np.nan}, r"fps must be a number from 0.1 .*, got nan"),
    "grip too high": ({"grips": [0, N]}, r"grips must be -1 or the index of one of the 4 points, got \[0, 4\]"),
    "grip too low": ({"grips": [0, -2]}, r"grips must be -1 or the index of one of the 4 points, got \[0, -2\]"),
    "the same grip twice": ({"grips": [2, 2]}, r"grips must hold a point once, got \[2, 2\]"),
    "one grip": ({"grips": [0]}, r"grips must have shape \(2,\), got \(1,\)"),
    "split": ({"split": Split(TRAIN, T + 1)}, r"split must speak of the recording's 10 frames, got 11"),
    "tracks": ({"tracks": np.zeros((T - 1, 2, 3))}, r"tracks must have shape \(10, tracks, 3\), got \(9, 2, 3\)"),
    "NaN flags": ({"visible": with_nan((T, N), 3)}, r"visible must be bool, got float64 with values other than 0 and 1"),
    "far": ({"points": np.full((T, N, 3), 74e3)}, r"points must lie within 1000 m of the origin, got 74000 m"),
    "far controllers": ({"controllers": np.full((T, C, 3), 1e300)}, r"controllers must lie within 1000 m"),
    "gravity in mm": ({"gravity": [0, 0, 9810]}, r"gravity must be at most 100 m/s\^2, got 9810"),
    "fps in ns": ({"fps": 1e9}, r"fps must be a number from 0.1 to 10000 frames per second, got 1000000000.0"),
    "fps in words": ({"fps": "30"}, r"fps must be a number from 0.1 .* got '30'"),
    "fps beyond all": ({"fps": 10**400}, r"fps must be a number from 0.1 .* got 1000"),
    "half a grip": ({"grips": [0.5, 0]}, r"grips must be integers, got \[0.5, 0.0\]"),
    "infinite tracks": ({"tracks": np.full((T, 2, 3), np.inf)}, r"tracks must lie within 1000 m of the origin, got inf"),
    "object": ({"object": 3}, r"object must be a str, got 3"),
    "timed": ({"timed": 1}, r"timed must be a bool, got 1"),
    "correspond": ({"correspond": None}, r"correspond must be a bool, got None"),
    "motions of clouds": ({"correspond": False}, r"motion_valid must be False where points do not correspond, got 40 motions"),
    "flat actuation": ({"actuation": np.zeros(T)}, r"actuation must have shape \(10, inputs\), got \(10,\)"),
    "NaN actuation": ({"actuation": with_nan((T, 3), 2)}, r"actuation must be finite"),
    "self_collision": ({"self_collision": "no"}, r"self_collision must be a bool, got 'no'"),
    "ragged": ({"surface": [[0, 0, 0], [1]]}, r"surface must be an array of numbers, got \[\[0, 0, 0\], \[1\]\]"),
    "flat tracks": ({"tracks": np.zeros((T, 3))}, r"tracks must have shape"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_wrong_recording_is_refused_when_it_is_built(name):
    changes, message = REFUSED[name]
    with pytest.raises(ValueError, match=message) as caught:
        scenario(**changes)
    assert "(scenario rope)" in str(caught.value)


@pytest.mark.parametrize("train_end", [-1, 0, 1, T + 1])
def test_the_train_range_holds_a_motion_and_ends_within_the_recording(train_end):
    with pytest.raises(ValueError, match=rf"train range of at least 2 frames .* \[0, {train_end}\) of 10 frames"):
        Split(train_end, T)


@given(length=st.integers(2, 50), data=st.data())
def test_a_split_divides_the_frames(length, data):
    split = Split(data.draw(st.integers(2, length)), length)
    assert [*split.train, *split.test] == list(range(length))


POSE, INTRINSICS = np.eye(4), np.array([[50.0, 0, 4], [0, 60, 3], [0, 0, 1]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.eye(4), POSE, 8, 6), r"intrinsics must have shape \(3, 3\), got \(4, 4\)"),
        ((INTRINSICS, np.eye(3), 8, 6), r"camera_to_world must have shape \(4, 4\), got \(3, 3\)"),
        ((INTRINSICS, POSE * np.nan, 8, 6), r"camera_to_world must be finite"),
        ((INTRINSICS.T, POSE, 8, 6), r"intrinsics must be \[\[fx, s, cx\], \[0, fy, cy\], \[0, 0, 1\]\] .* got \[\[50"),
        ((INTRINSICS, POSE * [[-1], [1], [1], [1]], 8, 6), r"camera_to_world must be a rotation and a translation"),
        ((INTRINSICS, POSE * 2, 8, 6), r"camera_to_world must be a rotation and a translation .* got the rows \[\[2.0"),
        ((INTRINSICS, POSE, 8.5, 6), r"camera width and height must be 1 to 16384 pixels, got 8.5 x 6"),
        ((INTRINSICS, POSE, 0, 6), r"camera width and height must be 1 to 16384 pixels, got 0 x 6"),
    ],
)
def test_a_wrong_camera_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Camera(*arguments)


def test_a_camera_projects_as_a_pinhole():
    """x_pixel = fx X/Z + cx, y_pixel = fy Y/Z + cy of the point in camera axes; here the camera stands 2 m back along z."""
    pose = POSE.copy()
    pose[2, 3] = -2
    pixel, depth = Camera(INTRINSICS, pose, 8, 6).project([[0.1, 0.2, 0.0], [0, 0, 2.0]])
    assert np.allclose(pixel, [[50 * 0.1 / 2 + 4, 60 * 0.2 / 2 + 3], [4, 3]]) and np.allclose(depth, [2, 4])


@settings(deadline=None)
@given(angle=st.floats(-3, 3), axis=st.integers(0, 2), seed=st.integers(0, 99))
def test_a_point_made_from_pixel_and_depth_projects_back(angle, axis, seed):
    """The inverse of the projection, written with the inverse matrices instead: X_world = pose (depth K^-1 [u, v, 1])."""
    rng = np.random.default_rng(seed)
    i, j = [k for k in range(3) if k != axis]
    pose = np.eye(4)
    pose[[i, i, j, j], [i, j, i, j]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    pose[:3, 3] = rng.normal(size=3)
    pixel, depth = rng.uniform(0, 8, (5, 2)), rng.uniform(0.2, 3, 5)
    local = depth[:, None] * (np.linalg.inv(INTRINSICS) @ np.c_[pixel, np.ones(5)].T).T
    world = (pose @ np.c_[local, np.ones(5)].T).T[:, :3]
    found, found_depth = Camera(INTRINSICS, pose, 8, 6).project(world)
    assert np.allclose(found, pixel, atol=1e-9) and np.allclose(found_depth, depth)  # rounding of 4 x 4 products


def test_a_ground_has_a_unit_normal_and_a_signed_height():
    with pytest.raises(ValueError, match="unit vector, got length 2"):
        Plane(np.array([0.0, 0, 2]))
    for offset in (np.nan, "0", 1e6):
        with pytest.raises(ValueError, match="ground offset must be a number within 1000 m, got"):
            Plane(np.array([0.0, 0, 1]), offset)
    with pytest.raises(ValueError, match="split must be of integers"):
        Split(2.5, T)
    with pytest.raises(ValueError, match="normal must have shape"):
        Plane(np.zeros(2))
    up_is_minus_z = Plane(np.array([0.0, 0, -1]), 0.1)
    assert up_is_minus_z.height([[5.0, 5, -0.3], [0, 0, 0]]) == pytest.approx([0.2, -0.1])


def test_a_transfer_pair_never_fits_its_target():
    assert TransferPair(["a", "b"], "c").sources == ("a", "b")
    with pytest.raises(ValueError, match="must not be fitted, but a is among its sources"):
        TransferPair(("a", "b"), "a")
    with pytest.raises(ValueError, match="at least one source"):
        TransferPair((), "a")


# --- what it is -----------------------------------------------------------------------------------------------------------


def test_particles_come_as_tracked_surface_interior():
    given_values = values()
    built = Scenario(**given_values)
    assert built.counts == (4, 3, 5) and built.frame_count == T and built.observed_frames == T
    assert np.array_equal(built.structure, np.concatenate([given_values["points"][0], given_values["surface"], given_values["interior"]]))
    assert built.grips.tolist() == [-1, -1], "hands are near the body unless markers are driven"


def test_spacing_is_the_distance_of_neighbours():
    row = np.repeat(np.arange(N)[:, None] * [0.03, 0, 0], 1, axis=1)[None].repeat(T, 0)
    lone = {"surface": np.zeros((0, 3)), "interior": np.zeros((0, 3))}
    assert scenario(points=row, **lone).spacing == pytest.approx(0.03)
    assert scenario(points=row, surface=row[0], interior=np.zeros((0, 3))).spacing == pytest.approx(0.03), "copies are no neighbours"
    assert scenario(points=row * 0, **lone).spacing == 0


def test_a_recording_cannot_be_changed():
    given_values = values()
    built = Scenario(**given_values)
    for field in dataclasses.fields(built):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(built, field.name, None)
        value = getattr(built, field.name)
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value[...] = 0
            assert value.base is None, f"{field.name} is a view of something that could be changed"
    before = built.points.copy()
    given_values["points"][:] = 0
    assert np.array_equal(built.points, before), "it owns its arrays"


def test_another_split_is_another_recording():
    built = scenario()
    other = built.with_split(8)
    assert (other.split.train_end, built.split.train_end) == (8, TRAIN) and other.observed().observed_frames == 8
    with pytest.raises(ValueError, match="train range"):
        built.with_split(1)


@pytest.mark.parametrize("told", [True, False], ids=["with motors and images", "without"])
def test_a_shortened_recording_is_its_first_frames_in_all_that_has_frames(told):
    built = scenario(**({"actuation": np.arange(2.0 * T).reshape(T, 2)} if told else {"images": None, "colors": None, "tracks": None}))
    short = built.shortened(4, 3)
    assert (short.frame_count, short.observed_frames, short.split) == (4, 4, Split(3, 4))
    for name in ("points", "visible", "motion_valid", "colors", "controllers", "actuation", "tracks"):
        whole, cut = getattr(built, name), getattr(short, name)
        assert cut is None if whole is None else np.array_equal(cut, whole[:4])
    assert not told or short.images.frame_count == 4
    assert built.shortened(TRAIN + 1).split == Split(TRAIN, TRAIN + 1)
    seen = built.observed().shortened(4)
    assert type(seen) is Observed and (seen.frame_count, seen.observed_frames) == (4, 4)


def test_what_was_observed_becomes_a_recording_that_knows_nothing_of_what_follows():
    made = Scenario.of(scenario().observed(), 0.9)
    assert made.split == Split(TRAIN - 1, TRAIN) and made.frame_count == len(made.controllers) == TRAIN
    assert [found for found in leaks(made) if isinstance(found, (np.ndarray, float))] == []


# --- what a method may see ------------------------------------------------------------------------------------------------


def test_a_method_sees_the_train_frames_and_all_controllers():
    built = scenario()
    seen = built.observed()
    assert seen.observed_frames == TRAIN and seen.frame_count == T
    for name in ("points", "visible", "motion_valid", "colors"):
        assert np.array_equal(getattr(seen, name), getattr(built, name)[:TRAIN])
    for name in ("controllers", "surface", "interior", "gravity", "grips"):
        assert np.array_equal(getattr(seen, name), getattr(built, name))
    assert type(seen) is Observed and not hasattr(seen, "tracks") and not hasattr(seen, "split")
    assert built.initial().observed_frames == 1 and built.initial().images.frame_count == 1
    assert built.observed(3).observed_frames == 3


@pytest.mark.parametrize("frames", [0, -1, TRAIN + 1, T])
def test_no_more_than_the_train_frames_can_be_asked_for(frames):
    with pytest.raises(ValueError, match=rf"frames must lie in \[1, {TRAIN}\], got {frames}"):
        scenario().observed(frames)


@pytest.mark.parametrize("frames", [1, 3, TRAIN])
def test_images_of_the_test_frames_are_beyond_reach(frames):
    seen = scenario().observed(frames).images
    assert seen.frame_count == frames
    for read in (seen.color, seen.depth, seen.mask, seen.human_mask, seen.until(T).color):
        assert read(0, frames - 1)[0, 0] == frames - 1
        for beyond in range(frames, T):
            with pytest.raises(IndexError):
                read(0, beyond)


def leaks(root):
    """The objects within reach of ``root`` that hold a number of a hidden frame, or are a whole recording or its split."""
    secret = np.float64(HIDDEN).tobytes()
    found = []
    for item in reachable(root):
        buffer = isinstance(item, (np.ndarray, bytes, bytearray)) and secret in (item.tobytes() if isinstance(item, np.ndarray) else item)
        if buffer or isinstance(item, (Scenario, Split)) or (isinstance(item, float) and item == HIDDEN):
            found.append(item)
    return found


def test_the_search_for_leaks_finds_them():
    built = scenario()
    kinds = [type(o) for o in leaks(built)]
    assert kinds.count(np.ndarray) >= 4 and Scenario in kinds and Split in kinds, "points, colors, tracks and images are there to be found"
    view = np.full(6, HIDDEN)[:0]
    assert leaks({"a view of hidden numbers": view})


@pytest.mark.parametrize("frames", [1, 3, TRAIN])
def test_nothing_that_a_method_holds_leads_to_a_test_frame(frames):
    built = scenario()
    seen = built.observed(frames)
    assert leaks(seen) == []
    for field in dataclasses.fields(seen):
        value = getattr(seen, field.name)
        if isinstance(value, np.ndarray):
            assert value.base is None and value.flags.owndata, f"{field.name}.base leads back to the recording"
    # strides cannot be stretched over memory beyond the frames, for the array owns no more than them
    assert seen.points.nbytes == frames * N * 3 * 8


def test_no_copy_or_attribute_brings_test_frames_back():
    built = scenario()
    seen = built.observed()
    assert np.float64(HIDDEN).tobytes() not in pickle.dumps(seen)
    assert leaks(pickle.loads(pickle.dumps(seen))) == []
    assert leaks(dataclasses.replace(seen, name="copy")) == []
    assert leaks([getattr(seen, name) for name in dir(seen) if not name.startswith("__")]) == []
    with pytest.raises(TypeError):
        dataclasses.replace(seen, split=Split(2, T))


def test_a_method_cannot_spoil_the_recording_it_is_scored_on():
    built = scenario()
    before = built.points.copy()
    seen = built.observed()
    for name in ("points", "controllers", "visible", "surface", "interior", "gravity", "grips"):
        array = getattr(seen, name)
        array.flags.writeable = True  # numpy lets the owner of an array do this
        array[...] = 0
        assert not np.shares_memory(array, getattr(built, name)), f"{name} is shared with the recording"
    assert np.array_equal(built.points, before) and built.controllers.any()
