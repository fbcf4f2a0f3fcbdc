"""Poses mended on what the table looks like, against the studio's true poses."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.capture_geometry import relative_error, shaken
from twinbench.benchmark.cli import main
from twinbench.datasets.capture import RawRecording, open_raw
from twinbench.datasets.capture.layout import write_layout
from twinbench.datasets.capture.pictures import Held
from twinbench.datasets.capture.refining import refine
from twinbench.datasets.synthetic.studio import studio_cameras
from twinbench.datasets.synthetic.studio_board import film_board, true_pose

TRUE = [true_pose(camera) for camera in studio_cameras(424)]


def posed(recording, poses):
    return replace(recording, cameras=tuple(replace(r, camera_to_world=p) for r, p in zip(recording.cameras, poses, strict=True)))


@pytest.fixture(scope="module")
def touched():
    """A board on the table, and cameras that were touched after their calibration: half a degree and 5 mm each."""
    rng = np.random.default_rng(5)
    return posed(film_board(424, seed=5, frames=1), [shaken(pose, rng) for pose in TRUE])


@pytest.mark.long
def test_cameras_that_were_touched_are_mended(touched, tmp_path, capsys):
    """Asked for: 0.2 degrees and 2 mm between cameras. A pixel is 2.2 mm wide, some 200 points are followed by a tenth of it."""
    before = relative_error([raw.camera_to_world for raw in touched.cameras], TRUE)
    folder = write_layout(tmp_path / "take", touched)
    assert main(["calibrate", str(folder), "--refine", "--apply", str(folder)]) == 0
    assert "points of the table" in capsys.readouterr().out
    mended = open_raw(folder)
    after = relative_error([raw.camera_to_world for raw in mended.cameras], TRUE)
    assert before[0] > 0.3 and before[1] > 4 and after[0] < 0.2 and after[1] < 2
    for raw, pose in zip(mended.cameras, TRUE, strict=True):  # the world's origin is held by the present poses, 5 mm off each
        assert np.linalg.norm(raw.camera_to_world[:3, 3] - pose[:3, 3]) < 0.01


def test_what_cannot_be_mended_is_said(touched):
    with pytest.raises(ValueError, match="recording board: poses are mended between cameras, and there are fewer than 2"):
        refine(RawRecording("board", touched.cameras[:1]))
    with pytest.raises(ValueError, match="recording board: camera camera1 must have camera_to_world"):
        refine(posed(touched, [TRUE[0], None, TRUE[2]]))
    with pytest.raises(ValueError, match="recording board: poses are mended on the table"):
        refine(replace(touched, ground=None))
    plain = []
    for raw in touched.cameras:
        grey = np.full_like(raw.frames.colors[0], 128)
        plain.append(replace(raw, frames=Held([grey], raw.frames.depths)))
    with pytest.raises(ValueError, match="recording board: camera camera1 must share at least 30 points of the table's texture"):
        refine(replace(touched, cameras=tuple(plain)))
