"""The paper's preset: what is said before it starts, and the published figures beside ours as published and corrected."""

import csv
import re
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from twinbench.benchmark.announcement import announcement
from twinbench.benchmark.api import studies
from twinbench.benchmark.cli import main
from twinbench.benchmark.measured import FIT_SECONDS
from twinbench.benchmark.opening import open_recordings
from twinbench.benchmark.presets import PRESETS, Preset
from twinbench.benchmark.published import Figure, Ours, compared, write_published
from twinbench.benchmark.results import Results
from twinbench.datasets.catalogue import CASES
from twinbench.datasets.phystwin import write_case
from twinbench.datasets.scenario import Scenario, Split
from twinbench.methods.static import Static

UNITS, DIRECTIONS = {"chamfer": "m", "iou": ""}, {"chamfer": "lower", "iou": "higher"}
PAPER = {
    ("prediction", "phystwin", "chamfer"): 0.012,
    ("prediction", "phystwin", "iou"): 0.725,
    ("prediction", "gs-dynamics", "chamfer"): 0.041,
    ("transfer", "phystwin", "iou"): 0.7218,
}


def row(method, chamfer, iou=float("nan"), *, task="prediction", name="one"):
    scores = {"chamfer": chamfer, "chamfer_unscorable": 0, "iou": iou, "iou_unscorable": 0}
    about = {"collection": "made", "scenario": name, "sources": name, "method": method, "task": task, "seed": 0}
    return {**about, "status": "ok", "reason": "", "diverged_frame": None, "note": "", "frames": 10, "fit_seconds": 1.0, **scores}


def results(*rows):
    return Results(rows, UNITS, DIRECTIONS, {"made": PAPER})


FOUR = results(
    row("phystwin-as-published", 0.0122, 0.7248),
    row("phystwin-as-published", 0.0132, 0.7358, name="two"),
    row("phystwin", 0.0098, 0.7),
    row("phystwin", 0.0118, name="two"),
    row("phystwin-as-published", 0.01, 0.72184, task="transfer"),
)


def test_differences_are_those_of_the_printed_digits():
    found = {(one.task, one.metric): one for one in compared(FOUR) if one.method == "phystwin"}
    chamfer, iou, transfer = found["prediction", "chamfer"], found["prediction", "iou"], found["transfer", "iou"]
    # means: 12.7 mm, printed 13, less 12; 10.8, printed 11; IoU 0.7303, printed 0.730, less 0.725; transfer IoU has four decimals
    assert [chamfer.difference(mode) for mode in (chamfer.as_published, chamfer.corrected)] == [Decimal("0.001"), Decimal("-0.001")]
    assert iou.difference(iou.as_published) == Decimal("0.005") and transfer.difference(transfer.as_published) == 0
    assert (iou.corrected.count, iou.corrected.rows) == (1, 2) and transfer.corrected is None
    assert {one.method for one in compared(FOUR)} == {"phystwin"}, "what was not run is not compared"


def test_the_tables_are_written_as_markdown_csv_and_latex(tmp_path):
    write_published(FOUR, tmp_path)
    lines = (tmp_path / "published.md").read_text().splitlines()
    assert r"| phystwin | chamfer \[mm\] | 12 | 13 | +1 | 11 | -1 |" in lines
    assert "| phystwin | iou | 0.725 | 0.730 | +0.005 | 0.700 (n=1) | -0.025 |" in lines
    assert "| phystwin | iou | 0.7218 | 0.7218 | 0.0000 | - | - |" in lines
    first = next(csv.DictReader((tmp_path / "published.csv").open()))
    assert (first["published"], first["as_published_difference"], first["corrected_n"]) == ("0.012", "0.001", "2")
    assert float(first["as_published"]) == pytest.approx(0.0127)
    text = (tmp_path / "published.tex").read_text()
    for rows in re.findall(r"\\toprule\n(.*?)\\bottomrule", text, re.S):
        assert {len(re.findall(r"(?<!\\)&", line)) for line in rows.splitlines() if line.endswith(r"\\")} == {6}


@pytest.mark.parametrize(
    ("published", "unit", "ours", "shown"),
    [
        (0.05, "m", 0.0504, ("50", "50", "0")),
        (0.0087, "m", 0.00864, ("8.7", "8.6", "-0.1")),
        (0.94, "", 0.9405, ("0.940", "0.941", "+0.001")),
        (28.214, "dB", 27.9996, ("28.214", "28.000", "-0.214")),
    ],
)
def test_as_many_digits_as_were_printed(published, unit, ours, shown):
    one, mean = Figure("c", "prediction", "m", "x", unit, published, None, None), Ours(ours, 1, 1)
    found = (one.shown(one.rounded(published)), one.shown(one.rounded(ours)), one.shown(one.difference(mean), sign=True))
    assert found == shown


def test_nothing_is_written_where_nothing_published_was_run(tmp_path):
    assert write_published(results(row("static", 0.1)), tmp_path) == [] and not list(tmp_path.iterdir())


def test_the_figure_shows_every_number(tmp_path):
    pytest.importorskip("matplotlib")
    from twinbench.benchmark.picture import blank_figure
    from twinbench.benchmark.published_figure import _panel

    panel = blank_figure(2, 2).subplots()
    _panel(panel, [one for one in compared(FOUR) if (one.task, one.metric) == ("prediction", "chamfer")], title="", ylabel="")
    heights = {marks.get_label(): [float(y) for _, y in marks.get_offsets()] for marks in panel.collections}
    assert heights == {"published": [12.0], "as published": [pytest.approx(12.7)], "corrected": [pytest.approx(10.8)]}
    write_published(FOUR, tmp_path)
    assert (tmp_path / "published.png").read_bytes().startswith(b"\x89PNG")


# --- the command


def scenario(seed):
    """A body that is carried 10 mm a frame along z by four hands."""
    random = np.random.default_rng(seed)
    shift = np.zeros((10, 1, 3))
    shift[:, 0, 2] = -0.01 * np.arange(10)
    points = random.uniform(-0.1, 0.1, size=(12, 3)) + np.array([0, 0, -0.3]) + shift
    seen = np.ones((10, 12), bool)
    hands = points[:, :4] + 0.01
    given = dict(points=points, visible=seen, motion_valid=seen, controllers=hands, split=Split(7, 10), tracks=points[:, :3])
    return Scenario(name="", object="thing", **given)


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cases") / "thing"
    for seed, name in enumerate(("lift_once", "lift_twice")):
        write_case(folder / name, scenario(seed))
    return folder


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Each test in its own working directory with its own cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))


class AsPublished(Static):
    """The static twin under the name that a comparison looks for."""

    name = "static-as-published"


@pytest.fixture
def paper(cases, monkeypatch):
    """A preset on two small recordings whose published figures are given: the static twin's Chamfer 30 mm, and its track error."""
    from twinbench.benchmark import options
    from twinbench.methods import registry

    found = registry.methods()
    few = {"static-as-published": AsPublished, "static": found["static"]}
    monkeypatch.setattr(registry, "methods", lambda: few)
    monkeypatch.setattr(options, "chosen_methods", lambda names: {name: few[name] for name in names})
    monkeypatch.setattr("twinbench.benchmark.api.chosen_methods", lambda names: {name: few[name] for name in names})
    published = {("resimulation", "static", "chamfer"): 0.03, ("resimulation", "static", "track_error"): 0.035}

    def opened(*arguments, **options):
        found = open_recordings(*arguments, **options)
        return replace(found, collection=replace(found.collection, published=published))

    monkeypatch.setattr("twinbench.benchmark.opening.open_recordings", opened)
    preset = Preset("quick", (str(cases),), ("static-as-published", "static"), announced=True)
    monkeypatch.setitem(PRESETS, "paper", preset)
    return cases


@pytest.mark.long
def test_the_preset_says_what_it_will_do_and_compares_what_it_did(paper, capsys):
    assert main(["run", "--preset", "paper", "--metrics", "chamfer", "track_error", "--out", "o"]) == 0
    out, err = capsys.readouterr()
    said = err.splitlines()
    assert said[0].startswith("On cpu: ") and said[1].startswith("- main table: static-as-published, static; 2 recordings of thing in")
    assert "- static: 2 fits; how long one takes was not measured on this kind of device" in said
    assert "- thing: no image columns (no images or cameras) for lift_once, lift_twice" in said
    assert said.index("Missing:") < next(i for i, line in enumerate(said) if "scored after" in line)
    # frames 1..6 at 10 mm a frame, the body as it was: mean 35 mm of the tracks
    lines = Path("o/latest/published.md").read_text().splitlines()
    assert r"| static | track_error \[mm\] | 35 | 35 | 0 | 35 | 0 |" in lines
    assert "thing, resimulation: published and ours, n = 2" in out and "published.csv" in out
    assert main(["run", "--preset", "paper", "--metrics", "chamfer", "track_error", "--out", "o"]) == 0
    said = capsys.readouterr().err.splitlines()
    assert "- static: all 2 twins are in the cache, if neither code nor recordings changed" in said and "Missing:" not in said
    assert main(["run", "--preset", "paper", "--metrics", "chamfer", "--out", "o", "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_without_matplotlib_a_sentence_says_why_there_is_no_picture(paper, capsys, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main(["run", "--preset", "paper", "--metrics", "chamfer", "--tasks", "resimulation", "--out", "o"]) == 0
    assert "No picture of these figures: a picture needs matplotlib" in capsys.readouterr().out
    assert {file.suffix for file in Path("o/latest").glob("published.*")} == {".md", ".csv", ".tex"}


@pytest.mark.long
def test_times_are_those_of_the_cache_or_as_measured(paper, monkeypatch):
    asked = dict(preset="paper", metrics="chamfer", scenarios="lift_once", tasks="resimulation")
    (study,) = studies(**asked)
    monkeypatch.setitem(FIT_SECONDS, "cpu", {"static": 100.0, "static-as-published": 40.0})
    full = replace(study, budget="full")
    said = announcement([full])
    assert "- static: 1 fit of about 1.7 min (results/full_size.md)" in said
    assert any("About 2.3 min for these fits;" in line for line in said)
    assert not any("results/full_size.md" in line for line in announcement([study])), "measured at full size"
    study.run()
    (both,) = studies(**(asked | {"scenarios": None}))
    found = [line for line in announcement([both]) if line.startswith("- static: ")]
    assert (
        len(found) == 1
        and "1 fit of about" in found[0]
        and "(the mean of 1 in the cache)" in found[0]
        and "1 more in the cache" in found[0]
    )


def test_what_is_missing_is_named_by_table(tmp_path):
    write_case(tmp_path / "d" / "single_push_rope_4", replace(scenario(0), tracks=None))
    (study,) = studies(tmp_path / "d", methods=["static", "spring-gaus"], metrics=["chamfer", "track_error"], cache=tmp_path / "cache")
    said = " ".join(announcement([study]))
    for text in (
        f"21 of the paper's {len(CASES)} recordings are not here",
        "no track error (no ground-truth tracks) for single_push_rope_4",
        "no two recordings show one object: no transfer table",
        "spring-gaus skips single_push_rope_4: ",
    ):
        assert text in said


def test_variants_that_make_one_twin_are_counted_once(cases, monkeypatch):
    from twinbench.benchmark.ablations import Ablation
    from twinbench.methods.variants import Variant

    alike = Ablation("looks", ("static", Variant("again", "static", look="as-published")), metrics=("chamfer",))
    for module in ("api", "experiment"):
        monkeypatch.setattr(f"twinbench.benchmark.{module}.ABLATIONS", {"alike": alike})
    found = [studies(str(cases), methods="static")[0], studies(str(cases), ablation="alike")[0]]
    assert [line for line in announcement(found) if "fits" in line and line.startswith("- ")] == [
        "- static: 2 fits; how long one takes was not measured on this kind of device"
    ]


def test_what_no_twin_is_fitted_of_is_said_once_a_method(cases):
    (study,) = studies(str(cases), ablation="clips-as-published", metrics=["chamfer"], tasks=["prediction"])
    said = [line for line in announcement([study]) if "no twin" in line]
    # an object that was recorded twice: five, ten and thirty recordings of it are not there
    assert said == [
        f"- thing: gs-dynamics-as-published ({n} clips): no twin for 2 recordings: the object was recorded 2 times" for n in (5, 10, 30)
    ]


@dataclass(frozen=True)
class Breaks:
    """A method that cannot be made."""

    def __call__(self):
        raise RuntimeError("no such package")


def test_a_method_that_cannot_be_made_is_said(cases):
    (study,) = studies(str(cases), methods={"broken": Breaks()}, metrics=["chamfer"])
    assert "- thing: broken cannot be run: no such package" in announcement([study])
