"""The leaderboard: means and intervals worked out by hand, published figures apart, LaTeX that compiles."""

import csv
import math
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.benchmark.leaderboard import boards, half_width, leaderboard_csv, leaderboard_latex, leaderboard_markdown, write_leaderboard
from twinbench.benchmark.results import Results
from twinbench.benchmark.table import blocks, escape
from twinbench.datasets.catalogue import CITED, PUBLISHED, cited_from

NEVER = {"reason": "", "diverged_frame": None, "note": ""}


def row(method, scenario, chamfer, *, seed=0, iou=0.5, frames=10, unscorable=0, task="prediction", **other):
    values = {"chamfer": chamfer, "chamfer_unscorable": 0, "iou": iou, "iou_unscorable": unscorable}
    identity = {"collection": "made", "scenario": scenario, "sources": scenario, "method": method, "task": task, "seed": seed}
    return {**NEVER, **identity, "status": "ok", **values, "frames": frames, "fit_seconds": 2.0, **other}


def table(*rows, published=None):
    units, directions = {"chamfer": "m", "iou": ""}, {"chamfer": "lower", "iou": "higher"}
    return Results(rows, units, directions, {"made": published or {}}, pooled=("iou",))


def interval(results, method, metric):
    (board,) = boards(results)
    return board.over, board.intervals[method, metric]


def test_intervals_are_students_t_over_recordings_with_seeds_averaged():
    # recordings' means over seeds: 10, 20, 30 mm; s = 10 mm, t(0.975, 2) = 4.302653 (any table), half = t s / sqrt(3) = 24.841 mm
    rows = [
        row("a", name, m + spread, seed=k)
        for name, m in zip("xyz", (0.01, 0.02, 0.03), strict=True)
        for k, spread in enumerate((-0.004, 0.004))
    ]
    over, found = interval(table(*rows), "a", "chamfer")
    assert (over, found.groups) == ("recordings", 3)
    assert found.half == pytest.approx(4.302653 * 0.01 / math.sqrt(3), rel=1e-6)


def test_with_fewer_than_three_recordings_intervals_are_over_seeds():
    # means over the two recordings by seed: 11, 12, 13 mm; half = 4.302653 * 1 mm / sqrt(3)
    rows = [row("a", name, m + 0.001 * k, seed=k) for name, m in zip("xy", (0.001, 0.021), strict=True) for k in range(3)]
    over, found = interval(table(*rows), "a", "chamfer")
    assert (over, found.groups) == ("seeds", 3)
    assert found.half == pytest.approx(4.302653e-3 / math.sqrt(3), rel=1e-6)
    assert boards(table(*(r for r in rows if r["seed"] == 0)))[0].over == ""


def test_a_pooled_metric_weighs_recordings_by_their_frames():
    # weights 10, 20, 30 - 10 unscorable = 20; x = 0.2, 0.4, 0.6: m = 22/50 = 0.44
    # var = 3/2 * ((10 * 0.24)^2 + (20 * 0.04)^2 + (20 * 0.16)^2) / 50^2
    rows = [row("a", "x", 0.1, iou=0.2), row("a", "y", 0.1, iou=0.4, frames=20), row("a", "z", 0.1, iou=0.6, frames=30, unscorable=10)]
    found = interval(table(*rows), "a", "iou")[1]
    assert found.half == pytest.approx(4.302653 * math.sqrt(1.5 * (2.4**2 + 0.8**2 + 3.2**2)) / 50, rel=1e-6)
    assert blocks(table(*rows))[0].lines[0].means["iou"] == pytest.approx(0.44)


@settings(deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30), st.floats(0.1, 10))
def test_equal_weights_give_the_interval_of_scipy(values, weight):
    # independent source: scipy.stats' t interval of a mean; rounding of the mean is 1e-13 of values up to 1e3
    from scipy import stats

    expected = stats.t.ppf(0.975, len(values) - 1) * stats.sem(values)
    assert half_width([(weight, x) for x in values]) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_an_interval_covers_the_mean_as_often_as_it_says():
    # 95 % of 4000 intervals over five normal recordings; the binomial standard deviation is 0.34 %
    random = np.random.default_rng(0)
    samples = random.normal(size=(4000, 5))
    covered = np.mean([abs(np.mean(s)) <= half_width([(1, x) for x in s]) for s in samples])
    assert abs(covered - 0.95) < 4 * 0.0034


def test_one_group_has_no_interval():
    assert math.isnan(half_width([(1, 2.0)])) and math.isnan(half_width([]))


THREE = [
    row(method, name, value + m) for method, value in (("a", 0.01), ("b", 0.02)) for name, m in (("x", 0.0), ("y", 0.001), ("z", 0.002))
]
FIGURES = {("prediction", "a", "chamfer"): 0.0001, ("transfer", "a", "chamfer"): 0.5}


def test_markdown_marks_the_best_and_keeps_published_figures_apart():
    text = leaderboard_markdown(table(*THREE, published=FIGURES), says="which is better")
    lines = text.splitlines()
    # s = 1 mm: half = 4.302653 / sqrt(3) = 2.484 mm
    assert "| a | **11.00** ± 2.48 | **0.500** ± 0.000 | 3 | 2.0 |" in lines
    assert "| b | 21.00 ± 2.48 | **0.500** ± 0.000 | 3 | 2.0 |" in lines
    assert "| *a (published)* | *0.1* | *-* |  |  |" in lines
    assert "which is better" in text and "Student's t over the recordings" in text
    assert "500" not in text.replace("0.500", "")  # the task was not run


def test_the_papers_figures_stand_apart_where_the_recordings_are_others():
    text = leaderboard_markdown(table(*THREE))
    ours, theirs = text.split("## Published figures of other recordings")
    assert "published" not in ours and "cannot be compared" in theirs
    assert "| phystwin (published) | 12 | 0.725 |" in theirs  # future prediction: Chamfer .012 m, IoU 72.5 %
    assert "resimulation" not in theirs  # was not run
    assert "cannot be compared" not in leaderboard_markdown(table(*THREE, published=FIGURES))
    assert "cannot be compared" not in leaderboard_markdown(table(*THREE), published=())
    few = leaderboard_markdown(table(*THREE), published=("phystwin-zero",))
    assert "| phystwin-zero (published) | 14 |" in few and "| phystwin (published)" not in few


def test_later_work_is_cited_below_the_papers_figures_and_said_not_to_be_run_here():
    # NeuSpring, future prediction: Chamfer 8.7 mm; it has no IoU here. The paper's rows come first, and no cited row can be the best
    found = replace(table(*THREE, published=PUBLISHED | CITED), citations={"made": f"The paper. {cited_from()}"})
    text = leaderboard_markdown(found)
    lines = text.splitlines()
    assert "| *neuspring (cited, not run here)* | *8.7* | *-* |  |  |" in lines
    paper, later = "| *phystwin (published)* | *12* | *0.725* |  |  |", "| *matphys (cited, not run here)* | *8* | *-* |  |  |"
    assert lines.index(paper) < lines.index(later)
    assert "neuspring: Q. Xu et al., NeuSpring, arXiv:2511.08310" in text and "protocols that may differ" in text
    assert "| a | **11.00**" in text and {task for task, _, _ in CITED} == {"prediction"}
    cited = [row for row in csv.DictReader(leaderboard_csv(found).splitlines()) if "not run here" in row["method"]]
    assert len(cited) == 6 and {row["published"] for row in cited} == {"True"} and {row["best"] for row in cited} == {"False"}
    assert "not run here" not in leaderboard_markdown(table(*THREE)), "only beside the recordings that they are of"


def test_published_names_are_those_of_methods():
    from twinbench.methods.registry import methods

    assert {method for _, method, _ in PUBLISHED} <= set(methods())


def test_a_method_scored_on_fewer_recordings_says_so_and_is_not_the_best():
    rows = [*THREE, row("c", "x", 0.001), *(row("c", n, math.nan, status="diverged", reason="exploded", diverged_frame=3) for n in "yz")]
    text = leaderboard_markdown(table(*rows))
    assert "| c | 1.00 | 0.500 | 1 of 3 | 2.0 |" in text and "| a | **11.00**" in text
    assert "- made, prediction: c diverged in 2 (not in the means): y at frame 3, z at frame 3: exploded" in text


def test_csv_has_every_number_in_si_units():
    rows = list(csv.DictReader(leaderboard_csv(table(*THREE, published=FIGURES)).splitlines()))
    assert len(rows) == 2 * 2 + 1
    first, published = rows[0], rows[-1]
    assert (first["method"], first["metric"], first["unit"], first["best"], first["rows"], first["interval_over"]) == (
        "a",
        "chamfer",
        "m",
        "True",
        "3",
        "3 recordings",
    )
    assert float(first["mean"]) == pytest.approx(0.011) and float(first["interval95"]) == pytest.approx(2.484e-3, rel=1e-3)
    assert (published["published"], published["mean"], published["best"], published["interval95"]) == ("True", "0.0001", "False", "")


AWKWARD = r"tw_in & 50% #1 {x} ~ ^ \ $ <a> | b ± c"


def awkward():
    rows = [row(AWKWARD, name, 0.01) for name in ("x_1", "y&2", "z")] + [
        row("b", "z", math.nan, status="failed", reason=f"KeyError: {AWKWARD}")
    ]
    return table(*rows, published={("prediction", AWKWARD, "chamfer"): 0.01})


NO_WIDER = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"


def test_latex_escapes_everything():
    for text in (leaderboard_latex(awkward(), says=AWKWARD), leaderboard_latex(table(*THREE))):
        body = "\n".join(line for line in text.splitlines() if not line.startswith("%")).replace(NO_WIDER, "{")
        bare = re.sub(r"\\[\\_%&#${}]", "", body)  # without what is escaped
        for character in "_#^~<>|±%":
            assert character not in bare.replace("$\\pm$", ""), character
        assert bare.count("{") == bare.count("}") and bare.replace(r"$\pm$", "").count("$") == 0
        for environment in ("table", "tabular", "itemize"):
            assert body.count(rf"\begin{{{environment}}}") == body.count(rf"\end{{{environment}}}") > 0
    # every row has as many cells as its table has columns
    for columns, rows in re.findall(r"\\begin\{tabular\}\{(\w+)\}\n(.*?)\\end\{tabular\}", leaderboard_latex(awkward()), re.S):
        lines = [line for line in rows.splitlines() if line.endswith(r"\\")]
        assert len(lines) > 1
        for line in lines:
            assert len(re.findall(r"(?<!\\)&", line)) == len(columns) - 1


def test_latex_compiles(tmp_path):
    if shutil.which("pdflatex") is None:
        pytest.skip("pdflatex is not installed")
    for name, results in {"awkward": awkward(), "three": table(*THREE)}.items():
        body = leaderboard_latex(results, says=AWKWARD)
        source = f"\\documentclass{{article}}\\usepackage{{booktabs,graphicx}}\\begin{{document}}\n{body}\n\\end{{document}}\n"
        (tmp_path / f"{name}.tex").write_text(source)
        command = ["pdflatex", "-halt-on-error", "-interaction=nonstopmode", f"{name}.tex"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-2000:]
        assert "Overfull" not in done.stdout  # nothing reaches beyond the page


def test_escaping_is_idempotent_for_plain_text():
    assert escape("phystwin 1.5 (a, b): c; d/e") == "phystwin 1.5 (a, b): c; d/e"


def test_the_files_are_written(tmp_path):
    written = write_leaderboard(table(*THREE), tmp_path)
    assert [path.name for path in written] == ["leaderboard.md", "leaderboard.csv", "leaderboard.tex"]
    assert written[0].read_text() == leaderboard_markdown(table(*THREE)) and sorted(tmp_path.iterdir()) == sorted(written)
