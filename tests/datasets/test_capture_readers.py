"""Raw recordings: what is written comes back to the bit, and whatever is wrong is one error that names it."""

import json
import pickle
import time
from dataclasses import replace
from pathlib import Path

import clips
import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from twinbench.datasets.capture import RawCamera, RawRecording, open_raw
from twinbench.datasets.capture.layout import _KEYS, read_layout, write_layout
from twinbench.datasets.capture.pictures import Held
from twinbench.datasets.capture.timing import measure_timing

SAMPLE = Path(__file__).resolve().parents[2] / "datasets" / "sample" / "plush_lift"
K = [[60.0, 0, 9.5], [0, 60.0, 7.5], [0, 0, 1]]


def camera(name="left", frames=3, *, stamps=None, arrivals=None, pose=None, seed=0, unit=0.001, empty=False):
    rng = np.random.default_rng(seed)
    colors = rng.integers(0, 256, (frames, 16, 20, 3), np.uint8)
    depths = rng.integers(0, 65536, (frames, 16, 20), np.uint16)
    stamps = np.arange(frames) / 30 if stamps is None else stamps
    background = (colors[0], depths[0]) if empty else None
    pose = np.eye(4) if pose is None else pose
    return RawCamera(name, K, pose, 20, 16, stamps, unit, Held(colors, depths, background), arrivals)


def damaged(tmp_path, change):
    """The error that a written recording gives once ``change(about, folder)`` was done to it."""
    folder = write_layout(tmp_path / "take", RawRecording("take", (camera(),)))
    about = json.loads((folder / "recording.json").read_text())
    change(about, folder)
    (folder / "recording.json").write_text(json.dumps(about))
    with pytest.raises(ValueError) as caught:
        open_raw(folder)
    assert str(folder) in str(caught.value)
    return str(caught.value)


@settings(max_examples=20, deadline=None)
@given(
    arrays(np.uint8, st.tuples(st.integers(1, 3), st.just(5), st.just(7), st.just(3))),
    st.floats(1e-4, 0.01),
    st.lists(st.floats(0.001, 1), min_size=3, max_size=3),
    st.integers(0, 2**32 - 1),
)
def test_what_is_written_comes_back_to_the_bit(tmp_path_factory, colors, unit, steps, seed):
    depths = np.random.default_rng(seed).integers(0, 65536, colors.shape[:3], np.uint16)
    stamps = np.cumsum(steps)[: len(colors)]
    one = RawCamera("a.b-1", [[5, 0, 3], [0, 5, 2], [0, 0, 1]], None, 7, 5, stamps, unit, Held(colors, depths))
    folder = tmp_path_factory.mktemp("raw") / "take"
    write_layout(folder, RawRecording("take", (one,)))
    found = read_layout(folder).cameras[0]
    assert found.depth_unit == unit and found.camera_to_world is None and found.frames.background() is None
    assert np.array_equal(found.stamps, stamps) and np.array_equal(found.intrinsics, one.intrinsics)
    for t in range(len(colors)):
        assert np.array_equal(found.frames.color(t), colors[t])
        assert np.array_equal(found.frames.depth(t), depths[t])


def test_calibration_background_and_arrivals_come_back(tmp_path):
    pose = np.eye(4)
    pose[:3, 3] = 1, 2, 3
    one = camera(arrivals=np.arange(3) / 30 + 100, pose=pose, empty=True)
    folder = write_layout(tmp_path / "take", RawRecording("take", (one, replace(one, name="right"))))
    found = open_raw(folder)
    assert [c.name for c in found.cameras] == ["left", "right"]
    assert np.array_equal(found.cameras[0].camera_to_world, pose) and np.array_equal(found.cameras[0].arrivals, one.arrivals)
    for kind in (0, 1):
        assert np.array_equal(found.cameras[0].frames.background()[kind], one.frames.background()[kind])


def test_a_recording_is_not_replaced_and_nothing_is_left_of_a_failure(tmp_path):
    folder = write_layout(tmp_path / "take", RawRecording("take", (camera(),)))
    with pytest.raises(ValueError, match="already exists"):
        write_layout(folder, RawRecording("take", (camera(),)))
    broken = camera()
    broken.frames.depths = broken.frames.depths.astype(np.int64) + 65536
    with pytest.raises(ValueError, match="65535"):
        write_layout(tmp_path / "other", RawRecording("take", (broken,)))
    assert [file.name for file in tmp_path.iterdir()] == ["take"]


def test_a_folder_of_pngs_of_another_program_is_described_where_it_lies(tmp_path):
    (tmp_path / "rgb").mkdir()
    (tmp_path / "d").mkdir()
    for t in range(7, 12):  # zeros or not, and not from 0
        cv2.imwrite(str(tmp_path / "rgb" / f"img_{t:03d}_c.png"), np.full((4, 6, 3), (1, 2, t), np.uint8))
        np.save(tmp_path / "d" / f"{t}.npy", np.full((4, 6), 100 + t, np.int32))
    about = {"size": [6, 4], "intrinsics": [[5, 0, 3], [0, 5, 2], [0, 0, 1]], "depth_unit": 0.00025, "fps": 15}
    about |= {"color": "rgb/img_{}_c.png", "depth": "d/{}.npy"}
    (tmp_path / "recording.json").write_text(json.dumps({"cameras": {"phone": about}}))
    found = open_raw(tmp_path).cameras[0]
    assert found.frame_count == 5 and np.allclose(np.diff(found.stamps), 1 / 15)
    assert found.frames.color(3)[0, 0].tolist() == [10, 2, 1]  # RGB
    assert found.metres(3)[0, 0] == np.float32(0.0275)


def test_the_raw_files_of_a_case_are_read_as_the_case_reader_reads_them():
    from twinbench.datasets.phystwin import read_case

    raw, case = open_raw(SAMPLE), read_case(SAMPLE)
    assert len(raw.cameras) == len(case.cameras) == 3
    for number, (one, camera) in enumerate(zip(raw.cameras, case.cameras, strict=True)):
        assert one.frame_count == case.frame_count and np.array_equal(one.intrinsics, camera.intrinsics)
        assert np.array_equal(one.camera_to_world, camera.camera_to_world)
        assert np.array_equal(one.frames.color(5), case.images.color(number, 5))
        assert np.allclose(one.metres(5), case.images.depth(number, 5), rtol=2e-7)  # rounding of single precision


def test_a_case_with_colour_as_video_only(tmp_path):
    about = {"intrinsics": [K], "WH": [32, 16], "fps": 30}
    (tmp_path / "metadata.json").write_text(json.dumps(about))
    (tmp_path / "calibrate.pkl").write_bytes(pickle.dumps([np.eye(4)]))
    (tmp_path / "color").mkdir()
    (tmp_path / "depth" / "0").mkdir(parents=True)
    writer = cv2.VideoWriter(str(tmp_path / "color" / "0.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30, (32, 16))
    for t in range(5):
        writer.write(np.full((16, 32, 3), 40 * t + 20, np.uint8))
        np.save(tmp_path / "depth" / "0" / f"{t}.npy", np.full((16, 32), t, np.uint16))
    writer.release()
    frames = open_raw(tmp_path).cameras[0].frames
    grey = [float(frames.color(t).mean()) for t in (4, 0, 2)]  # also backwards
    assert np.allclose(grey, [180, 20, 100], atol=6)  # lossy: a few levels
    with pytest.raises(ValueError, match="mp4: there are frames 0 to 4"):
        frames.color(5)


def test_clouds_are_a_recording_without_pictures(tmp_path):
    raw = open_raw(clips.write(tmp_path, "fold"))
    assert not raw.cameras and len(raw.clouds) == clips.FRAMES and not raw.timed and raw.gravity[2] < 0
    assert np.allclose(raw.controllers[:, 0], clips.path_of("fold"))
    for cloud, written in zip(raw.clouds, clips.hanging("fold"), strict=True):  # drawn with replacement, read once each
        assert np.allclose(np.sort(cloud, 0), np.sort(np.unique(written, axis=0), 0), atol=1e-9)


# --- what can be wrong --------------------------------------------------------------------------------------------------------------

WRONG = {
    "no cameras": (lambda about, folder: about.update(cameras={}), "must hold cameras"),
    "unknown key": (lambda about, folder: about["cameras"]["left"].update(flux=1), "may have"),
    "missing key": (lambda about, folder: about["cameras"]["left"].pop("depth_unit"), "must have"),
    "unit": (lambda about, folder: about["cameras"]["left"].update(depth_unit=1.0), "depth_unit of camera left must be 1e-06 to 0.1"),
    "intrinsics": (lambda about, folder: about["cameras"]["left"].update(intrinsics=[[1, 0], [0, 1]]), "intrinsics of camera left"),
    "inverse scale": (
        lambda about, folder: about["cameras"]["left"].update(camera_to_world=(2 * np.eye(4)).tolist()),
        "camera_to_world of camera",
    ),
    "stamps fall": (lambda about, folder: about["cameras"]["left"].update(stamps=[0, 2, 1]), "must rise"),
    "stamps too few": (lambda about, folder: about["cameras"]["left"].update(stamps=[0, 1]), "one for each of 3 pictures"),
    "both times": (lambda about, folder: about["cameras"]["left"].update(fps=30), "either stamps or fps"),
    "outside": (lambda about, folder: about["cameras"]["left"].update(color="../x/{}.png"), "within the folder"),
    "frame gone": (lambda about, folder: (folder / "left/depth/000001.png").unlink(), "missing: 1"),
    "colour gone": (lambda about, folder: (folder / "left/color/000002.png").unlink(), "as many depth pictures"),
    "gravity": (lambda about, folder: about.update(gravity=[0, 0]), "gravity must be three numbers"),
    "ground": (lambda about, folder: about.update(ground={"normal": [0, 0, 2], "offset": 0}), "unit vector"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_named(tmp_path, case):
    change, said = WRONG[case]
    assert said in damaged(tmp_path, change)


@pytest.mark.parametrize(
    "arrivals, said", [([0.0, 0.1, 0.1], None), ([0.0, 0.2, 0.1], "arrivals of camera left must not fall, got 0.2 s and then 0.1 s")]
)
def test_frames_of_a_full_queue_arrive_at_one_time(tmp_path, arrivals, said):
    """Stamps rise; arrivals need not, as a driver that counts milliseconds hands out waiting frames within one."""
    folder = write_layout(tmp_path / "take", RawRecording("take", (camera(arrivals=np.arange(3.0)),)))
    about = json.loads((folder / "recording.json").read_text())
    about["cameras"]["left"]["arrivals"] = arrivals
    (folder / "recording.json").write_text(json.dumps(about))
    if said is None:
        assert open_raw(folder).cameras[0].arrivals.tolist() == arrivals
    else:
        with pytest.raises(ValueError, match=said):
            open_raw(folder)


@pytest.mark.parametrize("file", ["color/000001.png", "depth/000001.png"])
def test_damaged_pictures_are_named(tmp_path, file):
    folder = write_layout(tmp_path / "take", RawRecording("take", (camera(),)))
    picture = folder / "left" / file
    picture.write_bytes(picture.read_bytes()[:-30])
    frames = open_raw(folder).cameras[0].frames
    with pytest.raises(ValueError, match=str(picture)):
        frames.color(1) if "color" in file else frames.depth(1)


def test_what_is_no_recording_says_what_was_looked_for(tmp_path):
    with pytest.raises(ValueError, match=r"recording\.json"):
        open_raw(tmp_path)
    with pytest.raises(ValueError, match="no such recording"):
        open_raw(tmp_path / "nothing")
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(ValueError, match=r"\.db3"):
        open_raw(tmp_path / "a.txt")


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=150, deadline=None)
@example("stamps", None)
@given(st.sampled_from(["cameras", "gravity", "ground", *sorted(_KEYS)]), JSON)
def test_whatever_a_field_holds_it_is_read_or_refused(tmp_path_factory, key, value):
    folder = tmp_path_factory.getbasetemp() / "any"
    if not folder.exists():
        write_layout(folder, RawRecording("any", (camera(empty=True, arrivals=np.arange(3.0)),)))
        (folder / "whole.json").write_text((folder / "recording.json").read_text())
    about = json.loads((folder / "whole.json").read_text())
    (about if key in ("cameras", "gravity", "ground") else about["cameras"]["left"])[key] = value
    (folder / "recording.json").write_text(json.dumps(about))
    try:
        recording = open_raw(folder)
    except ValueError as refused:
        assert str(folder) in str(refused)
    else:
        assert recording.cameras[0].frame_count == 3


# --- time ---------------------------------------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(st.floats(-5, 5), st.floats(0, 0.015), st.integers(0, 2**32 - 1))
def test_clocks_are_brought_together_by_arrivals(offset, phase, seed):
    """Stamps are true times minus an offset, arrivals true times plus 5 ms and noise of 1 ms: offsets agree to its median's error."""
    rng = np.random.default_rng(seed)
    true = [np.arange(60) / 30, np.arange(60) / 30 + phase]
    cameras = [
        camera(name, 60, stamps=t - o, arrivals=t + 0.005 + 0.001 * rng.uniform(0, 1, 60), seed=1)
        for name, t, o in (("a", true[0], 0.0), ("b", true[1], offset))
    ]
    timing = measure_timing(RawRecording("take", tuple(cameras)))
    assert abs((timing.clocks[1].offset - timing.clocks[0].offset) - offset) < 0.001  # the noise's range
    assert np.abs(timing.lags[1] - phase).max() < 0.001 and not timing.missing.any()
    assert np.allclose(timing.fps, 30)


def test_a_dropped_frame_is_missed_and_drift_is_measured():
    keep = np.delete(np.arange(300), 40)
    true = np.arange(300) / 30
    slow = camera("b", 299, stamps=true[keep] * (1 + 200e-6), arrivals=true[keep] + 0.005, seed=1)
    timing = measure_timing(RawRecording("take", (camera("a", 300, arrivals=true + 0.005), slow)))
    assert timing.clocks[1].dropped == (40,) and timing.clocks[0].dropped == ()
    assert np.flatnonzero(timing.missing[1]).tolist() == [40]
    assert abs(timing.clocks[1].drift - 200) < 1  # ppm; there is no jitter
    assert abs(timing.clocks[0].drift) < 1


def test_cameras_that_never_ran_together_are_refused():
    late = camera("b", 3, stamps=np.arange(3) / 30 + 10)
    with pytest.raises(ValueError, match=r"in common.*b: 10\.000 to"):
        measure_timing(RawRecording("take", (camera("a"), late)))
    sparse = camera("b", 4, stamps=[0.0, 0.03, 0.9, 0.97])
    with pytest.raises(ValueError, match="camera b must have taken at least half"):
        measure_timing(RawRecording("take", (camera("a", 30), sparse)))


# --- RealSense ----------------------------------------------------------------------------------------------------------------------


def test_a_realsense_file_comes_back_exact_in_depth(tmp_path):
    pytest.importorskip("pyrealsense2", reason="pip install twinbench[capture]; needs libusb-1.0", exc_type=ImportError)
    from realsense_files import record

    rng = np.random.default_rng(3)
    colors, depths = rng.integers(0, 256, (6, 16, 32, 3), np.uint8), rng.integers(0, 65536, (6, 16, 32), np.uint16)
    file = record(tmp_path / "cam.db3", colors, depths, focal=30.0, unit=0.0005)
    found = open_raw(file).cameras[0]
    assert found.name == "cam" and found.frame_count == 6 and abs(found.depth_unit - 0.0005) < 1e-9
    assert np.allclose(found.intrinsics, [[30, 0, 15.5], [0, 30, 7.5], [0, 0, 1]])
    assert np.allclose(np.diff(found.stamps), 1 / 30, atol=1e-4)  # stamps are written in ms
    for t in range(6):
        assert np.array_equal(found.frames.depth(t), depths[t]) and np.array_equal(found.frames.color(t), colors[t])


def test_a_realsense_file_loses_no_frame_where_its_reader_has_to_wait(tmp_path, monkeypatch):
    # the reader's thread stands still for ten frames of the clock after playback began, as on a busy machine
    rs = pytest.importorskip("pyrealsense2", reason="pip install twinbench[capture]; needs libusb-1.0", exc_type=ImportError)
    from realsense_files import record

    class Late(rs.pipeline):
        def start(self, config):
            profile = super().start(config)
            time.sleep(0.3)
            return profile

    stamps = np.arange(6) / 30
    file = record(tmp_path / "cam.db3", np.zeros((6, 16, 32, 3), np.uint8), np.ones((6, 16, 32), np.uint16), focal=30.0, unit=0.001)
    monkeypatch.setattr(rs, "pipeline", Late)
    assert np.allclose(open_raw(file).cameras[0].stamps, stamps, atol=1e-3)  # stamps are written in ms


def test_what_is_no_realsense_file_is_named(tmp_path):
    pytest.importorskip("pyrealsense2", reason="pip install twinbench[capture]; needs libusb-1.0", exc_type=ImportError)
    (tmp_path / "x.db3").write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"x\.db3: cannot be opened"):
        open_raw(tmp_path / "x.db3")
