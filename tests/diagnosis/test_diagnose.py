"""`twinbench diagnose` from end to end, on a sheet of 20 points: what it writes, what it refuses, and what it never looks at."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
import twinbench
from twinbench.benchmark.cli import main
from twinbench.datasets.phystwin import write_case
from twinbench.diagnosis import inquiry
from twinbench.diagnosis.springs import NAMES
from twinbench.diagnosis.verdict import ASTRAY, KINDS, MEASUREMENT, NONE, OTHER, Calibration, context
from twinbench.physics.terms.gravity_tilt import GravityTilt

PARTS = ("baseline", "extended", "noise_floor", "last_residual", "learned_residual")
FRAMES, TRAIN = 24, 16
# a decision that always names the best, whatever it is worth
NAMING = Calibration({"train": 1.0}, {NONE: -50.0, OTHER: -50.0}, {}, named=0.0)


pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture(scope="module")
def recordings(tiny, quick):
    """(case, transfer): gravity leans in both, the hands go opposite ways; 0.2 mm of noise."""
    given = dict(terms=[GravityTilt], values={"tilt_x": 4.0}, frames=FRAMES, train_end=TRAIN, noise=2e-4)
    return tiny.concealing(**given, name="swing"), tiny.concealing(**given, name="back", way=-0.06)


@pytest.fixture(scope="module")
def folders(recordings, tmp_path_factory):
    """The folder that holds both, in the published layout."""
    folder = tmp_path_factory.mktemp("recordings")
    for one in recordings:
        write_case(folder / one.name, one)
    return folder


@pytest.fixture(scope="module")
def named(recordings):
    """A diagnosis that names something."""
    return twinbench.diagnose(recordings[0], twin="springs", transfer=[recordings[1]], weights=NAMING)


def number(value, *, none=False):
    return (none and value is None) or (isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value))


def check(result, *, points, transfer):
    """The published interface: keys, types, names, ranges."""
    assert list(result) == [
        *("schema", "verdict", "effect", "alternatives", "probabilities", "where", "when", "parameters"),
        *("fit", "detectable", "experiment", "evidence", "seconds"),
    ]
    assert result["schema"] == 1
    assert result["verdict"] in ("adequate", "missing", "ambiguous", "unknown", "measurement", "cannot_tell")
    named = result["verdict"] in ("missing", "ambiguous", "measurement")
    assert (result["effect"] in NAMES) if named else result["effect"] is None
    assert set(result["alternatives"]) <= set(NAMES) - {result["effect"]}
    assert (result["effect"] in MEASUREMENT) == (result["verdict"] == "measurement") or result["verdict"] == "ambiguous"
    assert set(result["probabilities"]) <= {*NAMES, NONE, OTHER} >= {NONE, OTHER}
    assert all(0 <= p <= 1 for p in result["probabilities"].values())
    assert sum(result["probabilities"].values()) == pytest.approx(1, abs=1e-3)  # rounded to four places
    if where := result["where"]:
        assert named and set(where) == {"points", "centroid", "radius"}
        assert all(isinstance(p, int) and 0 <= p < points for p in where["points"])
        assert len(where["centroid"]) == 3 and all(map(number, where["centroid"])) and where["radius"] > 0
    assert named == (result["when"] is not None) or result["effect"] == "track_drift"
    if when := result["when"]:
        first, last = when["frames"]
        assert set(when) == {"frames"} and isinstance(first, int) and 0 <= first < last <= FRAMES
    for name, one in result["parameters"].items():
        assert named and re.fullmatch("[a-z][a-z0-9_]*", name) and set(one) == {"value", "unit", "interval90"}
        low, high = one["interval90"]
        assert number(one["value"]) and low <= one["value"] <= high and one["unit"]
    assert set(result["fit"]) == {"train", "heldout", *(["transfer"] if transfer else [])}
    for part, one in result["fit"].items():
        assert tuple(one) == PARTS
        assert number(one["baseline"]) and number(one["noise_floor"]) and one["noise_floor"] > 0
        assert number(one["extended"], none=not named or result["effect"] == "track_drift")
        assert number(one["last_residual"], none=part != "heldout") and number(one["learned_residual"])
    assert set(result["detectable"]) == set(NAMES)
    assert all(number(v, none=True) and (v is None or v >= 0) for v in result["detectable"].values())
    assert result["experiment"] is None or isinstance(result["experiment"], str)
    assert isinstance(result["evidence"], dict) and number(result["seconds"]) and result["seconds"] > 0


def test_the_effects_are_those_of_the_interface():
    assert len(NAMES) == len(set(NAMES)) == 30
    assert {t.effect.name for t in inquiry.hypotheses_for.__globals__["catalogue"]()} <= set(NAMES)
    assert set(MEASUREMENT) == {"controller_delay", "camera_pose", "track_drift", "grip_points"} < set(NAMES)


@pytest.mark.long
def test_the_command_writes_the_interface_and_an_offline_report(folders, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["diagnose", str(folders / "swing"), "--twin", "springs", "--transfer", str(folders / "back"), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert f"Written to {out}: diagnosis.json, report.html" in printed and len(printed.splitlines()) >= 2
    assert sorted(p.name for p in out.iterdir()) == ["diagnosis.json", "report.html", "tracks.npz"]  # and no temporary file

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    result = json.loads((out / "diagnosis.json").read_text(), parse_constant=refuse)
    check(result, points=20, transfer=True)
    assert [(r["name"], r["role"], r["frames"]) for r in result["evidence"]["recordings"]] == [
        ("swing", "case", FRAMES),
        ("back", "transfer", FRAMES),
    ]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.lstrip().lower().startswith("<!doctype html>") and page.rstrip().endswith("</html>")
    assert not re.search(r"""(?:src|href|action)\s*=\s*["']?(?!#|data:)\w""", page)
    assert not re.search(r"@import|url\(\s*[\"']?(?!data:)|\bfetch\(|XMLHttpRequest|WebSocket|import\(", page)


def test_a_name_comes_with_its_parameters_place_and_time(named):
    check(json.loads(json.dumps(named.result, default=float)), points=20, transfer=True)
    # beside another name where both do the same to these frames: a level wind and a tilt are nearly one pull
    assert named.result["verdict"] == ("ambiguous" if named.result["alternatives"] else "missing")
    assert named.result["effect"] and named.result["parameters"]
    assert named.result["fit"]["train"]["extended"] < named.result["fit"]["train"]["baseline"]


@pytest.fixture(scope="module")
def asked_once():
    """The inquiry, which knows of no weights, made for the first of several decisions."""
    made = {}

    def asked(case, transfer=(), fitted_on=(), **options):
        names = tuple(one.name for one in (case, *transfer, *fitted_on))
        if names not in made:
            made[names] = inquiry.inquire(case, transfer, fitted_on, **options)
        return made[names]

    return asked


@pytest.mark.long
@pytest.mark.parametrize(
    ("weights", "verdict"),
    [
        (Calibration({"train": 1.0}, {NONE: -50.0, OTHER: -50.0}, {}, named=1.1, both=0.0), "ambiguous"),
        (Calibration({}, {NONE: 50.0}, {}), "adequate"),
        (Calibration({}, {OTHER: 50.0}, {}), "unknown"),
        (Calibration({}, {}, {}, named=1.1, both=1.1, sure=dict.fromkeys(KINDS, 1.1)), "cannot_tell"),
    ],
)
def test_every_verdict_is_written_in_the_same_interface(recordings, tmp_path, monkeypatch, asked_once, weights, verdict):
    monkeypatch.setattr("twinbench.diagnosis.springs.inquire", asked_once)
    found = twinbench.diagnose(recordings[0], twin="springs", weights=weights)
    found.write(tmp_path)
    result = json.loads((tmp_path / "diagnosis.json").read_text())
    check(result, points=20, transfer=False)
    assert result["verdict"] == verdict
    assert any("No transfer recording" in note for note in result["evidence"]["notes"])


def spoiled(scenario, first):
    """The same recording, with other positions from frame ``first`` on: torn away, noisy, in part not seen."""
    rng = np.random.default_rng(3)
    points, seen = scenario.points.copy(), scenario.visible.copy()
    points[first:] += rng.normal(0, 0.03, points[first:].shape) + [0.1, -0.2, 0.3]
    seen[first:] &= rng.uniform(size=seen[first:].shape) < 0.7
    return replace(scenario, points=points, visible=seen)


@pytest.mark.long
def test_held_out_frames_and_transfer_recordings_are_never_fitted(recordings, named):
    case, other = recordings
    twin = named.result["evidence"]["twin"]
    for cases in ((spoiled(case, TRAIN), other), (case, spoiled(other, 1))):
        found = twinbench.diagnose(cases[0], twin="springs", transfer=[cases[1]], weights=NAMING)
        assert found.result["evidence"]["twin"] == twin  # to the last bit
        spoilt = found.result["fit"]["heldout" if cases[1] is other else "transfer"]
        assert spoilt["baseline"] > 5 * found.result["fit"]["train"]["baseline"]  # what was spoiled does count where it is compared


@pytest.mark.slow
def test_amplitudes_do_not_depend_on_held_out_frames(recordings, named):
    case, other = recordings
    again = twinbench.diagnose(spoiled(case, TRAIN), twin="springs", transfer=[other], weights=NAMING)

    def linear(found):
        return {(s.hypothesis.effect, *sorted(s.hypothesis.values.items())): s.amplitude.tolist() for s in found.inquiry.scores}

    assert linear(named) == linear(again)


@pytest.mark.long
def test_a_twin_that_was_fitted_on_other_recordings(recordings, named, tiny):
    # the twin comes from recordings without the lean, so the lean of the case is what is left to name
    clean = tiny.concealing(frames=FRAMES, train_end=TRAIN, noise=2e-4, name="calm", rate=0.7)
    case, other = recordings
    found = twinbench.diagnose(case, twin="springs", transfer=[other], fitted_on=[clean])
    check(json.loads(json.dumps(found.result, default=float)), points=20, transfer=True)
    assert [r["role"] for r in found.result["evidence"]["recordings"]] == ["case", "transfer", "fitted_on"]
    # what was fitted elsewhere has not bent itself to the case's lean
    assert found.result["fit"]["train"]["baseline"] > named.result["fit"]["train"]["baseline"]
    assert found.result["evidence"]["twin"] == twinbench.diagnose(case, twin="springs", fitted_on=[clean]).result["evidence"]["twin"]


@pytest.mark.long
def test_a_twin_is_at_ease_where_it_was_fitted_and_not_where_it_runs_astray(tiny):
    clean = tiny.concealing(frames=FRAMES, train_end=TRAIN, noise=2e-4, name="calm", rate=0.7)
    asked = twinbench.diagnose(clean, twin="springs", fitted_on=[clean]).inquiry
    free = asked.base.free.values()
    assert min(free) <= asked.astray <= max(free)  # the same free run: its mean over all frames lies between those of its two parts
    assert context(asked, [])["fine"] == 1.0
    lost = context(replace(asked, astray=0.9 * max(free) / ASTRAY), [])
    assert (lost["fine"], lost["astray"]) == (0.0, 1.0)
    assert context(replace(asked, astray=None), [])["fine"] == 1.0  # of a twin that was fitted here nobody knows it


def one_line(capsys, *arguments):
    """The one line on standard error with which the command ends, with exit code 2."""
    assert main(["diagnose", *map(str, arguments)]) == 2
    out, error = capsys.readouterr()
    assert out == "" and error.startswith("twinbench: ") and error.count("\n") == 1
    return error


def test_bad_input_is_one_line_and_nothing_is_written(folders, tmp_path, recordings, capsys):
    case, out, nowhere = folders / "swing", tmp_path / "out", tmp_path / "far" / "from" / "others"
    assert "unknown preset 'qick'; did you mean 'quick'" in one_line(capsys, case, "--preset", "qick", "--out", out)
    assert "unknown device 'gpu'" in one_line(capsys, case, "--device", "gpu", "--out", out)
    assert f"no recording at {nowhere}: " in one_line(capsys, nowhere, "--out", out)
    assert f"no recording at {nowhere}: " in one_line(capsys, case, "--transfer", nowhere, "--out", out)
    assert "swing" in one_line(capsys, folders, "--out", out)  # holds two: the line names them
    assert not out.exists()
    write_case(tmp_path / "short", recordings[0].with_split(6))
    said = one_line(capsys, tmp_path / "short", "--twin", "springs", "--out", out)
    assert "short: a diagnosis needs at least 8 frames that may be fitted, got 6" in said
    assert not out.exists() or not list(out.iterdir())


def test_python_refuses_what_the_command_refuses(recordings):
    with pytest.raises(ValueError, match=r"unknown preset 'fast'; .*known: quick, full"):
        twinbench.diagnose(recordings[0], twin="springs", preset="fast")
    with pytest.raises(ValueError, match="swing: a diagnosis needs at least 8 frames that may be fitted, got 7"):
        twinbench.diagnose(recordings[0].with_split(7), twin="springs")
