"""What is reported of clouds: slow frames by v^2 < 0.003 g L, and Chamfer distances against worked-out ones."""

import csv
from types import SimpleNamespace

import numpy as np
import pytest
from clips import FRAMES, write
from twinbench.benchmark import cloud_twins
from twinbench.datasets.collection import open_collection


@pytest.fixture
def clip(tmp_path):
    write(tmp_path / "clips")
    return open_collection(tmp_path / "clips").load("fold_red")


def test_frames_are_slow_where_hands_are(clip):
    # a cloth of 0.393 m across (twice that as the diagonal of its box, 0.557 m): v < sqrt(0.003 * 9.81 * 0.557) = 0.128 m/s; at 10 Hz the
    # gripper goes sqrt(0.1^2 + 0.2^2) / 8 = 28 mm a frame
    assert not cloud_twins.quasi_static(clip).any()
    slowed = SimpleNamespace(**{n: getattr(clip, n) for n in ("structure", "known", "gravity", "fps")}, controllers=0.4 * clip.controllers)
    assert cloud_twins.quasi_static(slowed).all()


def test_chamfers_are_those_of_the_metric(clip):
    moved = SimpleNamespace(surface=np.where(clip.visible[..., None], clip.points, 9.0) + [0.003, 0.004, 0.0])
    frames = np.arange(1, FRAMES)
    assert cloud_twins.chamfers(moved, clip, frames, 2) == pytest.approx(0.005, rel=0.5)  # or less, where another point is nearer
    assert (cloud_twins.chamfers(moved, clip, frames, 1) <= 0.007 + 1e-12).all()


def test_rows_are_written_for_each_method(tmp_path, clip, monkeypatch, capsys):
    monkeypatch.setattr(cloud_twins, "METHODS", ("static", "rigid"))
    cloud_twins.main([str(tmp_path / "clips"), "--out", str(tmp_path / "out.csv")])
    with (tmp_path / "out.csv").open(newline="") as file:
        rows = {row["method"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["static", "rigid"] and "fold_red" in capsys.readouterr().out
    for row in rows.values():
        assert row["test_frames"] == "3" and row["slow_frames"] == "0" and row["euclidean_slow_mm"] == ""
        assert float(row["euclidean_mm"]) == float(row["euclidean_fast_mm"]) < float(row["published_mm"])
