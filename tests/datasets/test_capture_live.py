"""Recording with cameras: two devices of librealsense without hardware are recorded, looked at and read again."""

import json
import sys
import types
import urllib.error
import urllib.request
from contextlib import ExitStack

import cv2
import numpy as np
import pytest
from software_cameras import UNIT, H, SoftwareCamera, W
from twinbench.benchmark.cli import main
from twinbench.datasets.capture import live, open_raw
from twinbench.datasets.capture.live import LiveOptions
from twinbench.datasets.capture.preview import Preview, picture_of
from twinbench.datasets.capture.taking import files_of, take

SMALL = LiveOptions(W, H, 30, "none")


def taken(cameras, out, options=SMALL, *, frames=12, **how):
    """A take that ends when every camera has delivered so many ``frames``, however slow the machine is."""
    came = []
    with ExitStack() as stack:
        for camera in cameras:
            stack.enter_context(camera)
        until = {"watch": lambda running: came.__setitem__(slice(None), running), "seconds": 60}
        until["stopped"] = lambda: bool(came) and min(camera.frames for camera in came) >= frames
        return take([camera.device for camera in cameras], out, options, **(until | how))


@pytest.mark.long
def test_two_cameras_are_recorded_and_come_back_exact(tmp_path):
    """Frame t has depth 4000 + t in every pixel: what is read says which frames were recorded; 5 and 6 of the second never came."""
    pytest.importorskip("pyrealsense2")
    cameras = [SoftwareCamera("left"), SoftwareCamera("right", lost=(5, 6))]
    result = taken(cameras, tmp_path / "take")
    assert result.dropped == {"left": 0, "right": 4} and min(result.frames.values()) >= 12  # two frames of two streams
    assert sorted(p.name for p in tmp_path.iterdir()) == ["take", "take.realsense"]
    recording = open_raw(tmp_path / "take")
    assert [c.name for c in recording.cameras] == ["left", "right"] and recording.cameras[0].camera_to_world is None
    for camera in recording.cameras:
        assert abs(camera.depth_unit - UNIT) < 1e-9 and camera.intrinsics[0, 2] == 31.5 and camera.arrivals is not None
        numbers = [int(np.unique(camera.frames.depth(t)).item()) - 4000 for t in range(camera.frame_count)]
        assert np.allclose(camera.stamps, np.array(numbers) / 30, atol=1e-6)
        assert all((camera.frames.color(t) == n % 256).all() for t, n in enumerate(numbers))
    assert 5 not in numbers and 6 not in numbers and result.timing.clocks[1].dropped
    again = open_raw(files_of(tmp_path / "take"))
    assert np.array_equal(again.cameras[0].arrivals, recording.cameras[0].arrivals)


@pytest.mark.long
def test_colour_is_never_put_beside_the_depth_of_another_time(tmp_path):
    """librealsense hands out a colour whose depth is missing with the depth that comes next, 33 ms later: that frame is left out."""
    pytest.importorskip("pyrealsense2")
    taken([SoftwareCamera("left", without_depth=(0, 6))], tmp_path / "take")
    camera = open_raw(tmp_path / "take").cameras[0]
    numbers = np.array([int(np.unique(camera.frames.depth(t)).item()) - 4000 for t in range(camera.frame_count)])
    assert len(numbers) >= 8 and not {0, 6} & set(numbers) and np.allclose(camera.stamps, numbers / 30, atol=1e-6)
    assert all((camera.frames.color(t) == n).all() for t, n in enumerate(numbers))


def test_nothing_is_written_without_a_folder_and_a_folder_that_is_there_is_kept(tmp_path):
    pytest.importorskip("pyrealsense2")
    result = taken([SoftwareCamera("left")], None)
    assert result.files == () and result.frames["left"] > 0
    (tmp_path / "take").mkdir()
    with pytest.raises(ValueError, match="take: already exists"):
        taken([SoftwareCamera("left")], tmp_path / "take")
    assert list(tmp_path.iterdir()) == [tmp_path / "take"]


@pytest.mark.long
def test_a_camera_that_cannot_or_does_not_deliver_is_named(tmp_path):
    pytest.importorskip("pyrealsense2")
    with pytest.raises(ValueError, match=r"camera left: must deliver colour and depth of 640 x 480 at 30 a second, has neither"):
        taken([SoftwareCamera("left")], tmp_path / "a", LiveOptions(640, 480, 30, "none"))
    with pytest.raises(ValueError, match=r"camera left: must deliver .*, has depth"):
        taken([SoftwareCamera("left", streams=("depth",))], tmp_path / "a")
    assert list(tmp_path.iterdir()) == []  # refused before anything was recorded
    silent = SoftwareCamera("right", lost=range(10_000))
    with pytest.raises(ValueError, match="camera right: delivered no frame of colour"):
        taken([SoftwareCamera("left"), silent], tmp_path / "b", seconds=3)
    assert not (tmp_path / "b").exists() and open_raw(tmp_path / "b.realsense" / "left.db3").cameras[0].frame_count > 0


def test_the_first_camera_triggers_the_others(tmp_path):
    """librealsense: mode 1 is the master, 2 a slave."""
    rs = pytest.importorskip("pyrealsense2")
    cameras = [SoftwareCamera("left", triggered=True), SoftwareCamera("right", triggered=True)]
    taken(cameras, None, LiveOptions(W, H, 30, "hardware"), frames=1)
    assert [camera.sensor.get_option(rs.option.inter_cam_sync_mode) for camera in cameras] == [1, 2]
    with pytest.raises(ValueError, match="camera right: cannot be triggered by a cable"):
        taken([cameras[0], SoftwareCamera("right")], None, LiveOptions(W, H, 30, "hardware"))
    with pytest.raises(ValueError, match="sync must be software, hardware or none, got 'gps'"):
        LiveOptions(sync="gps")


def test_the_preview_shows_each_camera_and_its_button_stops(tmp_path):
    pytest.importorskip("pyrealsense2")
    seen = []
    with Preview() as preview:

        def watch(cameras):
            preview.show(cameras)
            if cameras[0].frames < 5 or preview.stopped:
                return
            page = urllib.request.urlopen(preview.url, timeout=5).read().decode()
            stream = urllib.request.urlopen(preview.url + "left.mjpg", timeout=5)
            data = stream.read(60_000 if stream.length else 20)
            seen.extend([page, data])
            urllib.request.urlopen(urllib.request.Request(preview.url + "stop", method="POST"), timeout=5)

        taken([SoftwareCamera("left")], None, watch=watch, stopped=lambda: preview.stopped, seconds=30)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(preview.url + "right.mjpg", timeout=5)
        with pytest.raises(ValueError, match=r"preview port .* cannot be opened"):
            Preview(int(preview.url.rsplit(":", 1)[1].strip("/")))
    assert "src='left.mjpg'" in seen[0] and "<script" not in seen[0] and "Stopped" not in seen[0]
    assert seen[1].startswith(b"--frame")


def test_a_preview_picture_has_colour_depth_and_counts():
    color, depth = np.full((H, W, 3), 90, np.uint8), np.zeros((H, W), np.uint16)
    depth[:, : W // 2] = 2000  # 0.5 m: 2/3 of the scale, left half; nothing measured in the right
    camera = types.SimpleNamespace(name="left", color=color, depth=depth, depth_unit=UNIT, frames=3, dropped=1)
    picture = picture_of(camera)
    assert picture.shape == (H, 2 * W, 3) and (picture[H - 1, :W] == 90).all()
    expected = cv2.applyColorMap(np.array([[170]], np.uint8), cv2.COLORMAP_TURBO)[0, 0, ::-1]
    assert np.abs(picture[H - 1, W + 3].astype(int) - expected).max() <= 6 and (picture[H - 1, -3:] == 0).all()


def test_without_cameras_or_librealsense_there_is_one_clear_error(monkeypatch, capsys, tmp_path):
    pytest.importorskip("pyrealsense2")
    assert main(["capture", str(tmp_path / "take"), "--seconds", "1"]) == 2
    assert "no RealSense camera is plugged in" in capsys.readouterr().err
    monkeypatch.setattr(
        live, "imported", lambda: types.SimpleNamespace(context=Context, camera_info=types.SimpleNamespace(serial_number=0))
    )
    assert main(["capture", str(tmp_path / "take"), "--cameras", "7"]) == 2
    assert "no camera 7 is plugged in, only 12, 34" in capsys.readouterr().err
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    assert main(["capture"]) == 2
    assert "pip install twinbench[capture]" in capsys.readouterr().err and not list(tmp_path.iterdir())


class Context:
    def query_devices(self):
        return [types.SimpleNamespace(get_info=lambda _, n=name: n) for name in ("34", "12")]


LIBREALSENSE = types.SimpleNamespace(context=Context, camera_info=types.SimpleNamespace(serial_number=0))


@pytest.mark.long
def test_the_command_records_what_the_devices_deliver(monkeypatch, capsys, tmp_path):
    pytest.importorskip("pyrealsense2")
    camera = SoftwareCamera("left", lost=(2,))
    monkeypatch.setattr(live, "find_devices", lambda serials: [camera.device])
    with camera:
        arguments = ["capture", str(tmp_path / "take"), "--width", str(W), "--height", str(H), "--seconds", "4", "--preview", "0"]
        assert main(arguments) == 0
    said = capsys.readouterr()
    assert "left: " in said.out and "2 dropped" in said.out and "preview: http://127.0.0.1:" in said.err and "2 frames dropped" in said.err
    assert open_raw(tmp_path / "take").cameras[0].frame_count > 5


@pytest.mark.parametrize("about", [{"stamps": [0, 1]}, {"stamps": [1, 0], "arrivals": [1, 2]}, {"stamps": [0, 1], "arrivals": [0]}])
def test_wrong_arrivals_are_named(tmp_path, about):
    from twinbench.datasets.capture.realsense import _arrivals

    (tmp_path / "left.arrivals.json").write_text(json.dumps(about))
    with pytest.raises(ValueError, match=r"left\.arrivals\.json: must hold stamps"):
        _arrivals(tmp_path / "left.db3", np.arange(2.0))
