"""The curve of the error over the number of recordings: its means, what it shows, and what it refuses."""

import numpy as np
import pytest
from twinbench.benchmark import curve
from twinbench.benchmark.cli import main
from twinbench.benchmark.curve import curves
from twinbench.benchmark.results import Results, write_results
from twinbench.benchmark.table import blocks


def row(method, scenario, value, status="ok", task="transfer"):
    scored = {"chamfer": value, "chamfer_unscorable": 0, "frames": 9, "reason": "" if status == "ok" else "too few"}
    about = {"collection": "DLO1", "sources": "train/1", "seed": 0, "fit_seconds": 1.0, "diverged_frame": None}
    return about | scored | {"method": method, "scenario": scenario, "task": task, "status": status}


@pytest.fixture
def results():
    rows = [row("rigid", "x", 0.04), row("rigid", "y", 0.06)]
    for count, x, y in ((10, 0.01, 0.02), (1, 0.03, 0.05), (2, 0.02, np.nan)):
        name = f"gs-dynamics ({count} clip{'s' if count > 1 else ''})"
        rows += [row(name, "x", x), row(name, "y", y, "ok" if np.isfinite(y) else "diverged")]
        rows.append(row(name, "x", 0.01 * count, task="prediction"))
    rows += [row("gs-dynamics (30 clips)", "x", np.nan, "skipped")]
    published = {"DLO1": {("transfer", "DEFORM (published)", "chamfer"): 0.0101}}
    return Results(rows, {"chamfer": "m"}, {"chamfer": "lower"}, published, {"DLO1": "someone"})


def test_means_by_number_of_recordings_in_order(results):
    block = next(block for block in blocks(results) if block.task == "transfer")
    found = curves(block, "chamfer")
    assert {method: [(count, round(line.means["chamfer"], 6)) for count, line in lines] for method, lines in found.items()} == {
        "rigid": [(None, 0.05)],
        "gs-dynamics": [(1, 0.04), (2, 0.02), (10, 0.015)],  # a mean over what was scored, and nothing where nothing was
        "DEFORM (published)": [(None, 0.0101)],
    }


@pytest.mark.parametrize("out", [None, "deep/er.svg"])
def test_the_command_draws_a_panel_for_each_task(tmp_path, capsys, results, out):
    pytest.importorskip("matplotlib")
    write_results(results, tmp_path)
    assert main(["curve", str(tmp_path), *(["--out", str(tmp_path / out)] if out else [])]) == 0
    path = tmp_path / (out or "chamfer.png")
    printed, err = capsys.readouterr()
    assert str(path) in printed and err == "" and path.read_bytes()[:5] == (b"<?xml" if out else b"\x89PNG\r")
    if out:  # letters are drawn as outlines, but matplotlib leaves the text beside them
        text = path.read_text()
        panels = [f"chamfer [mm], DLO1, {task}" for task in ("transfer", "prediction")]
        for words in (*panels, "gs-dynamics", "rigid", "1 of 2", "recordings fitted on"):
            assert f"<!-- {words} -->" in text


def test_wrong_input_is_refused(tmp_path, capsys, results):
    pytest.importorskip("matplotlib")
    write_results(results, tmp_path)
    few = Results([one for one in results.rows if one["method"] == "rigid"], results.units, results.directions)
    write_results(few, tmp_path / "few")
    for arguments, message in (
        ([str(tmp_path / "none")], "rows.parquet is missing"),
        ([str(tmp_path), "--metric", "chamfr"], "did you mean 'chamfer'"),
        ([str(tmp_path), "--out", "here.pgn"], "must end in one of"),
        ([str(tmp_path / "few")], "no chamfer of twins of different numbers of recordings: twinbench run --ablation clips"),
    ):
        assert main(["curve", *arguments]) == 2
        assert message in capsys.readouterr().err


def test_bars_are_the_leaderboards_intervals_and_wide_means_are_logarithmic(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    values = {1: (0.03, 0.05, 0.07), 5: (0.003, 0.004, 0.008)}
    rows = [row(f"gs-dynamics ({n} clip{'s' * (n > 1)})", s, v) for n, own in values.items() for s, v in zip("xyz", own, strict=True)]
    drawn = []
    monkeypatch.setattr(curve, "save", lambda figure, path: drawn.append(figure))
    curve.draw_curves(Results(rows, {"chamfer": "m"}, {"chamfer": "lower"}), "chamfer", tmp_path / "c.png")
    (panel,) = drawn[0].axes
    assert panel.get_yscale() == "log"  # means of 50 and 5 mm
    bars = [segment[:, 1] for collection in panel.collections for segment in collection.get_segments()]
    for own, (low, high) in zip(values.values(), bars, strict=True):
        half = 4.302653 * np.std(own, ddof=1) / np.sqrt(3) * 1e3  # Student's t with 2 degrees of freedom, 97.5 %
        assert (low, high) == pytest.approx((1e3 * np.mean(own) - half, 1e3 * np.mean(own) + half), rel=1e-5)
