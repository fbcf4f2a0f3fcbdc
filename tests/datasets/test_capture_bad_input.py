"""What can be wrong with a recording: one clear error, or a warning in the report, that names camera and frames; nothing half-written."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from pushed_box import FRAMES, H, W, filmed
from twinbench.datasets.capture import RawRecording, open_raw
from twinbench.datasets.capture.build import BuildOptions, build
from twinbench.datasets.capture.calibration import calibrate
from twinbench.datasets.capture.layout import write_layout
from twinbench.datasets.capture.manifest import manifest, read_manifest, write_manifest
from twinbench.datasets.perception.background import BackgroundMasks


def two(*, stamps, frames=FRAMES):
    """The scene filmed twice from the same place, the second camera's frames stamped as ``stamps`` say."""
    first = filmed(frames).cameras[0]
    second = replace(filmed(len(stamps)).cameras[0], name="side", stamps=np.array(stamps))
    return RawRecording("push", (first, second))


def said_of(recording, out):
    """Warnings of a build, which must also stand in its report."""
    warnings = build(recording, out, BuildOptions(points=400, shape="none")).quality.warnings
    page = (out / "report.html").read_text().replace("&#x27;", "'").replace("&gt;", ">")
    assert all(one in page for one in warnings)
    return " ".join(warnings)


def test_a_camera_that_is_missing(tmp_path):
    with pytest.raises(ValueError, match="recording push: has no camera 'left', only top"):
        build(filmed(), tmp_path / "case", BuildOptions(cameras=("left",)))
    late = two(stamps=np.arange(3) / 30 + 100)
    with pytest.raises(ValueError, match=r"cameras must have at least 2 frames' time in common, got top: .*; side: 100\.000"):
        build(late, tmp_path / "case")
    assert not list(tmp_path.iterdir())


def test_a_camera_that_lacks_frames_is_a_warning_with_their_numbers(tmp_path):
    times = np.delete(np.arange(FRAMES), [3, 4]) / 30
    assert "camera side has no picture of its own for frames 3-4: the nearest stands in" in said_of(two(stamps=times), tmp_path / "case")


def test_each_camera_of_a_case_has_its_own_pictures(tmp_path):
    """The second camera's pictures are 20 levels darker."""
    recording = two(stamps=np.arange(FRAMES) / 30)
    held = recording.cameras[1].frames
    held.colors[:] = [color - np.minimum(color, 20) for color in held.colors]
    built = build(recording, tmp_path / "case", BuildOptions(points=400, shape="none")).scenario
    again = open_raw(tmp_path / "case")
    for camera, raw in zip(again.cameras, recording.cameras, strict=True):
        assert np.array_equal(camera.frames.color(5), raw.frames.color(5)) and np.allclose(camera.metres(5), raw.metres(5))
    assert built.frame_count == FRAMES


def test_cameras_that_are_not_synchronised_are_a_warning(tmp_path):
    """Half a frame apart: 17 ms; nobody wrote arrivals down, so one clock is assumed and said."""
    said = said_of(two(stamps=(np.arange(FRAMES) + 0.45) / 30), tmp_path / "case")
    assert "cameras take a frame 15 ms apart" in said and "nobody wrote arrivals down" in said


UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        # the pose mirrored at the table: it looks from under it, and the box lies above what it sees
        (
            {"camera_to_world": UPSIDE_DOWN @ filmed(1).cameras[0].camera_to_world},
            r"camera top: must stand above the table, got -0\.600 m: is its pose upside down",
        ),
        ({"depth_unit": 0.00025}, r"camera top: .*is depth_unit right\?"),
        ({"depth_unit": 0.01}, "camera top: at most half .* depth_unit right"),
        ({"depth_unit": 0.00001}, r"camera top: depth must be 0\.1 to 10 metres"),
        ({"camera_to_world": None}, "camera top must have camera_to_world: calibrate it first"),
    ],
)
def test_a_pose_or_a_depth_unit_that_is_wrong(tmp_path, change, said):
    recording = RawRecording("push", (replace(filmed().cameras[0], **change),))
    with pytest.raises(ValueError, match=said):
        build(recording, tmp_path / "case")
    assert not (tmp_path / "case").exists()


def test_a_board_that_is_not_seen():
    with pytest.raises(ValueError, match=r"camera top: the board is in no picture .*; frame 0 must show at least 8 corners"):
        calibrate(filmed())


def test_masks_that_are_empty(tmp_path, monkeypatch):
    masks = BackgroundMasks.masks

    def nothing(self, clip):
        found = masks(self, clip)
        return replace(found, object=np.zeros_like(found.object))

    monkeypatch.setattr(BackgroundMasks, "masks", nothing)
    with pytest.raises(
        ValueError, match=r"camera top: the mask of the object is empty in frame 0 \(background\), of 8 frames in 0 it is not"
    ):
        build(filmed(), tmp_path / "case")
    assert not (tmp_path / "case").exists()


def test_an_object_at_the_border_of_the_picture_is_a_warning_with_its_frames(tmp_path):
    """Each frame is moved by 40 pixels to the left: the box, which began 40 pixels from the border, touches it from frame 0 on."""
    raw = filmed()
    held = raw.cameras[0].frames
    for t in range(4, FRAMES):
        for pictures in (held.colors, held.depths):
            pictures[t] = np.roll(pictures[t], -40 - 3 * t, axis=1)
    said = said_of(raw, tmp_path / "case")
    assert "camera top: the object touches the border of the picture in frames 4-7" in said


@pytest.mark.parametrize("striped", [(60, 130, 230), (30, 60, 120)])
def test_an_object_without_texture_is_a_warning(tmp_path, striped):
    """The box in one colour, and in stripes, which say nothing of motion along them: in that direction the gradient is 0."""
    raw = filmed()
    said = said_of(raw, tmp_path / "textured")
    assert "little texture" not in said
    held = raw.cameras[0].frames
    for t, color in enumerate(held.colors):
        blue = (held.depths[t] < 580) & (color[..., 2] > color[..., 0])
        color[blue] = (60, 130, 230)
        color[blue & (np.arange(W) // 3 % 2 == 0)] = striped
    assert "camera top: the object has little texture (0.0 grey levels a pixel" in said_of(raw, tmp_path / "plain")


def test_what_one_camera_does_not_see_is_said(tmp_path):
    """From straight above a box 75 mm x 45 mm, 40 mm high, shows its top: of the surface, sides and bottom included, less than a third."""
    quality = build(filmed(), tmp_path / "case").quality
    assert 0.5 < quality.unseen < 0.9
    said = f"one camera: the far side was never seen ({100 * quality.unseen:.0f} % of the surface was seen by no camera, and is guessed)"
    assert any(one.startswith(said) for one in quality.warnings)


def video(folder, frames):
    """The scene with its colour as one video."""
    write_layout(folder, filmed())
    writer = cv2.VideoWriter(str(folder / "top.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30, (W, H))
    for t in range(frames):
        writer.write(filmed(FRAMES).cameras[0].frames.color(t)[..., ::-1])
    writer.release()
    about = read_manifest(manifest(folder))
    about["cameras"]["top"]["color"] = "top.mp4"
    write_manifest(manifest(folder), about)
    return folder


def test_a_video_that_is_damaged_or_too_short(tmp_path):
    folder = video(tmp_path / "take", FRAMES)
    assert open_raw(folder).cameras[0].frame_count == FRAMES
    whole = (folder / "top.mp4").read_bytes()
    for damaged in (whole[:200], b"\0" * 5000, whole[: len(whole) // 2]):
        (folder / "top.mp4").write_bytes(damaged)
        with pytest.raises(ValueError, match=r"top\.mp4: not a video that can be decoded"):
            open_raw(folder)
    with pytest.raises(ValueError, match="camera top must have as many depth pictures as colour pictures, got 8 and 5"):
        open_raw(video(tmp_path / "short", 5))


def test_a_picture_that_is_damaged_in_the_middle_leaves_nothing(tmp_path):
    folder = write_layout(tmp_path / "take", filmed())
    picture = folder / "top" / "color" / "000005.png"
    picture.write_bytes(picture.read_bytes()[:-40])
    with pytest.raises(ValueError, match=r"000005\.png"):
        build(open_raw(folder), tmp_path / "case")
    assert not (tmp_path / "case").exists()


# --- other cameras' folders ---------------------------------------------------------------------------------------------------------

PHONE = """
# a phone: depth of 20 x 12 pixels where colour has 200 x 120
gravity: [0, 0, 9.8]
cameras:
  phone:
    size: [200, 120]
    depth_size: [20, 12]
    intrinsics: [[200, 0, 99.5], [0, 200, 59.5], [0, 0, 1]]
    depth_unit: 1e-3
    distortion: [0.1, 0, 0, 0]
    color: rgb/{}.jpg
    depth: depth/{}.png
    fps: 60
"""


def phone(folder, text=PHONE, frames=2):
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    for t in range(frames):
        cv2.imwrite(str(folder / "rgb" / f"{t}.jpg"), np.full((120, 200, 3), 40 + t, np.uint8))
        cv2.imwrite(str(folder / "depth" / f"{t}.png"), np.arange(240, dtype=np.uint16).reshape(12, 20) + 500)
    (folder / "recording.yaml").write_text(text)
    return folder


def test_a_phone_is_described_by_a_few_lines_of_yaml(tmp_path):
    """Depth pixel (r, c) covers colour's rows 10 r to 10 r + 9; the lens moves nothing at its centre, and 10 % of r^2 at r: by the model
    x' = x (1 + k1 r^2) a pixel at x = 0.4 is looked up at 0.4064, 1.28 pixels further out."""
    pytest.importorskip("yaml")
    found = open_raw(phone(tmp_path / "take")).cameras[0]
    assert found.frame_count == 2 and found.depth_unit == 0.001 and np.allclose(found.stamps, [0, 1 / 60])
    depth = found.frames.depth(0)
    assert depth.shape == (120, 200) and depth[60, 100] == 500 + 6 * 20 + 10 and depth[57, 99] == 500 + 5 * 20 + 9
    assert depth[60, 178] == 500 + 6 * 20 + 17 and depth[60, 179] == 500 + 6 * 20 + 18  # 178 + 1.2, 179 + 1.26
    assert abs(int(found.frames.color(1)[60, 100, 0]) - 41) <= 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("depth_size: [20, 12]", "depth_size: [20]"), r"depth_size of camera phone must be \[width, height\]"),
        (("depth_size: [20, 12]", "depth_size: [40, 24]"), None),
        (("distortion: [0.1, 0, 0, 0]", "distortion: [0.1]"), "distortion of camera phone must be 4, 5 or 8 numbers"),
        (("fps: 60", "fps: [60"), r"recording\.yaml: not a YAML file that can be read"),
        (("fps: 60", "fps: !!python/name:os.system"), r"recording\.yaml: not a YAML file that can be read"),
        (("fps: 60", "fps: &a 60\n    x: *a"), r"aliases \(\*name\) are not read"),
        (("gravity:", "7:"), "must hold names and values"),
        (("fps: 60", "frames: 60"), "may have"),
    ],
)
def test_what_is_wrong_in_yaml_is_named(tmp_path, change, said):
    pytest.importorskip("yaml")
    folder = phone(tmp_path / "take", PHONE.replace(*change))
    with pytest.raises(ValueError, match=said or r"depth/0\.png: pictures of camera phone must be 40 x 24 pixels, got 20 x 12"):
        open_raw(folder).cameras[0].frames.depth(0)


def test_poses_are_put_into_yaml_as_into_json(tmp_path):
    from twinbench.datasets.capture.layout import put_poses

    pytest.importorskip("yaml")
    folder, pose = phone(tmp_path / "take"), np.eye(4)
    pose[0, 3] = 1e-5
    put_poses(folder, {"phone": pose}, filmed(1))
    assert np.array_equal(open_raw(folder).cameras[0].camera_to_world, pose)
