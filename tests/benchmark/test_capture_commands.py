"""Point by point what can be wrong with a folder of pictures, from the command line: one line that says so, and no case; or a warning."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pushed_box import FRAMES, H, W, filmed
from twinbench.benchmark.cli import main
from twinbench.datasets.capture import RawRecording
from twinbench.datasets.capture.layout import write_layout
from twinbench.datasets.capture.pictures import Held

TIMES = np.arange(FRAMES) / 30


def pair(stamps=TIMES, arrivals=None, second=None, **changed):
    """The pushed box, filmed twice from the same place; the ``second`` Held and what is ``changed`` are the camera's named side."""
    first = filmed().cameras[0]
    held = second or filmed(len(stamps)).cameras[0].frames
    return RawRecording("push", (first, replace(first, name="side", stamps=np.asarray(stamps), frames=held, **changed)))


def with_frames(change):
    """``pair`` whose second camera's pictures went through ``change(colors, depths)``."""
    held = filmed().cameras[0].frames
    colors, depths = (np.array(pictures) for pictures in (held.colors, held.depths))
    change(colors, depths)
    return pair(second=Held(list(colors), list(depths)))


def described(folder, change):
    file = folder / "recording.json"
    about = json.loads(file.read_text())
    change(about)
    file.write_text(json.dumps(about))


def built(recording, tmp_path, capsys, *more, damage=lambda folder: None):
    """(exit status, what was said on stderr, on stdout) of ``twinbench build``."""
    folder = write_layout(tmp_path / "raw", recording)
    damage(folder)
    status = main(["build", str(folder), "--out", str(tmp_path / "case"), "--shape", "none", *more])
    said = capsys.readouterr()
    return status, said.err, said.out


def hide(colors, depths):
    """Nothing but the table from the beginning."""
    colors[:], depths[:] = 150, 600


def leave(colors, depths):
    colors[5:], depths[5:] = 150, 600


def upside_down(about):
    about["cameras"]["side"]["camera_to_world"] = (np.diag([1.0, -1.0, -1.0, 1.0]) @ filmed(1).cameras[0].camera_to_world).tolist()


def cut(file, part=0.5):
    whole = file.read_bytes()
    file.write_bytes(whole[: int(part * len(whole))])


REFUSED = {  # name: (the recording, what is done to its folder, more of the command, what is said)
    "a camera that is asked for is not there": (pair, None, ("--cameras", "left"), "has no camera 'left', only top, side"),
    "a camera's pictures are not there": (
        pair,
        lambda folder: [file.unlink() for file in (folder / "side" / "color").iterdir()],
        (),
        "side",
    ),
    "cameras that never ran together": (lambda: pair(TIMES + 100), None, (), "side: 100.000 to 100.233 s: one clock?"),
    "half of the frames are not there": (lambda: pair(TIMES[[0, 6, 7]]), None, (), "camera side must have taken at least half"),
    "upside down": (
        pair,
        lambda folder: described(folder, upside_down),
        (),
        "camera side: must stand above the table, got -0.600 m: is its pose upside down?",
    ),
    "depth in another unit": (lambda: pair(depth_unit=0.01), None, (), "camera side: at most half of what it measured in frame 0"),
    "an empty mask": (lambda: with_frames(hide), None, (), "camera side: nothing stands on the table in frame 0"),
    "a damaged picture of colour": (pair, lambda folder: cut(folder / "side/color/000005.png"), (), "side/color/000005.png"),
    "a damaged picture of depth": (pair, lambda folder: cut(folder / "side/depth/000003.png"), (), "side/depth/000003.png"),
    "a damaged description": (pair, lambda folder: cut(folder / "recording.json"), (), "recording.json"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_is_said_in_one_line_and_no_case_is_written(name, tmp_path, capsys):
    made, damage, more, said = REFUSED[name]
    status, error, _ = built(made(), tmp_path, capsys, *more, damage=damage or (lambda folder: None))
    last = error.strip().splitlines()[-1]
    assert status == 2 and said in last and "Traceback" not in error
    assert not (tmp_path / "case").exists()
    left = [file for file in tmp_path.rglob("*") if file.name.startswith(".") and file.name != ".case.build"]
    assert not left  # no temporary file; .case.build has whole stages of what was done before


WARNED = {  # name: (the recording, what is said)
    "frames that a camera lacks": (
        lambda: pair(np.delete(TIMES, [3, 4])),
        "camera side has no picture of its own for frames 3-4: the nearest stands in",
    ),
    "frames that the first camera lacks": (
        lambda: RawRecording("push", (replace(filmed(7).cameras[0], stamps=np.delete(TIMES, 4)),)),
        "camera top dropped frames before its frames 4: the case goes on as if no time had passed",
    ),
    "cameras that are not synchronised": (
        lambda: pair((np.arange(FRAMES) + 0.45) / 30),
        "cameras take a frame 15 ms apart (later than top: side by +15 ms): images of other cameras",
    ),
    "the object leaves the picture": (lambda: with_frames(leave), "camera side sees nothing of the object in frames 5-7"),
}


@pytest.mark.parametrize("name", WARNED)
def test_what_is_a_warning_names_camera_and_frames_in_output_and_report(name, tmp_path, capsys):
    made, said = WARNED[name]
    status, _, output = built(made(), tmp_path, capsys)
    assert status == 0 and f"warning: {said}" in output
    assert said in (tmp_path / "case" / "report.html").read_text()


def test_a_board_that_is_not_seen_leaves_the_poses_as_they_are(tmp_path, capsys):
    folder = write_layout(tmp_path / "board", filmed())
    before = (folder / "recording.json").read_text()
    assert main(["calibrate", str(folder), "--apply", str(folder)]) == 2
    assert "camera top: the board is in no picture" in capsys.readouterr().err
    assert (folder / "recording.json").read_text() == before and filmed().cameras[0].height == H and W > H
