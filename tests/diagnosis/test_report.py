"""The report: one file that says what the diagnosis says, needs nothing else, and lets nothing of its input act."""

import base64
import copy
import json
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pages import Document
from twinbench.datasets.collection import open_collection
from twinbench.diagnosis.page.arrays import thin, view
from twinbench.diagnosis.page.tables import facts
from twinbench.diagnosis.page.words import EFFECTS, VERDICTS, extent, headline, improvement, less, number
from twinbench.diagnosis.report import write_report

HOSTILE = "</script><img src=x onerror=alert(1)>&\"'<!--"


def errors(predicted, scenario):
    """Mean distance [m] of visible points by frame, None where none is visible."""
    apart = np.where(scenario.visible, np.linalg.norm(predicted - scenario.points, axis=2), np.nan)
    return [float(np.nanmean(row)) if np.isfinite(row).any() else None for row in apart]


def recording(scenario, index, *, rate):
    """Arrays, curves and points of a recording whose twin sags on one side by up to ``rate`` m, and by 0.3 of it when extended."""
    reach = scenario.points[0, :, 0]
    side = np.clip((reach - np.median(reach)) / (reach.max() - np.median(reach)), 0, 1)
    ramp = np.clip((np.arange(scenario.frame_count) - 12) / 20, 0, 1)
    lag = ramp[:, None, None] * side[None, :, None] * (rate * scenario.gravity / np.linalg.norm(scenario.gravity))
    wobble = np.random.default_rng(index).normal(0, 1e-3, scenario.points.shape)
    baseline, extended = scenario.points + lag + wobble, scenario.points + 0.3 * lag + wobble
    arrays = {
        f"observed_{index}": np.where(scenario.visible[..., None], scenario.points, np.nan).astype(np.float32),
        f"baseline_{index}": baseline,
        f"extended_{index}": extended,
        f"force_{index}": -300 * lag,
        f"controllers_{index}": scenario.controllers,
    }
    curves = {"baseline": errors(baseline, scenario), "extended": errors(extended, scenario), "noise_floor": 1.6e-3}
    return arrays, curves, np.flatnonzero(side > 0.5)


@pytest.fixture(scope="module")
def diagnosed():
    """A diagnosis in the published interface, with the arrays of two recordings of the sample."""
    sample = open_collection("sample")
    drag, lift = sample.load("plush_drag"), sample.load("plush_lift")
    arrays, curves, points = recording(drag, 0, rate=0.03)
    more, other, _ = recording(lift, 1, rate=0.05)
    del more["force_1"]
    centre = drag.points[0, points].mean(0)
    place = {"points": points.tolist(), "centroid": centre.tolist(), "radius": 0.04}
    names = ("baseline", "extended", "noise_floor", "last_residual", "learned_residual")
    tried = [
        ("added_mass", "physics", 0.58, 0.61, 0.55, 0.12, 0.052, "kg", 0.81, "gains on every split; the place repeats over seeds"),
        ("hidden_tether", "physics", 0.52, 0.31, -0.24, 0.2, 14.0, "N/m", 0.12, "fits the training frames, but makes the transfer worse"),
        ("camera_pose", "measurement", 0.11, 0.06, None, 0.62, 0.004, "m", 0.03, "the error moves with the body, not with the camera"),
        ("learned_residual", "baseline", 0.66, 0.55, 0.2, None, None, None, None, "no name to carry over"),
        ("last_residual", "baseline", None, 0.2, 0.02, None, None, None, None, ""),
        ("baseline", "baseline", 0.0, 0.0, 0.0, None, None, None, 0.04, ""),
    ]
    keys = ("effect", "kind", "train_gain", "heldout_gain", "transfer_gain", "absorbed", "amplitude", "unit", "probability", "why")
    result = {
        "schema": 1,
        "verdict": "missing",
        "effect": "added_mass",
        "alternatives": ["hidden_tether"],
        "probabilities": {"added_mass": 0.81, "hidden_tether": 0.12, "camera_pose": 0.03},
        "where": place,
        "when": {"frames": [12, 31]},
        "parameters": {"added_mass": {"value": 0.052, "unit": "kg", "interval90": [0.047, 0.058]}},
        "fit": {
            "train": dict(zip(names, (0.0081, 0.0034, 0.0016, None, 0.0027), strict=True)),
            "heldout": dict(zip(names, (0.0123, 0.0048, 0.0016, 0.0098, 0.0055), strict=True)),
            "transfer": dict(zip(names, (0.0201, 0.009, 0.0016, 0.0197, 0.016), strict=True)),
        },
        "detectable": {"added_mass": 0.006, "hidden_tether": 2.1, "wind": None, "camera_pose": 0.0011, "torsion": None},
        "experiment": None,
        "evidence": {
            "hypotheses": [dict(zip(keys, one, strict=True)) for one in tried],
            "clusters": [{**place, "frames": [12, 48], "strength": 31.4, "p": 0.001}],
            "noise_floor": 0.0016,
            "notes": ["Two tracks were left out: they drift away from their neighbours."],
            "recordings": [
                {"name": "plush_drag", "role": "case", "frames": 48, "train_end": 33, "points": drag.points.shape[1]},
                {"name": "plush_lift", "role": "transfer", "frames": 48, "train_end": 33, "points": lift.points.shape[1]},
            ],
            "curves": {"plush_drag": curves, "plush_lift": other},
        },
        "seconds": 83.2,
    }
    ground = np.append(drag.ground.normal, drag.ground.offset)
    return result, {**arrays, **more, "up": -drag.gravity / np.linalg.norm(drag.gravity), "ground": ground}


def without(result, *names):
    result = copy.deepcopy(result)
    for name in names:
        result[name] = None
    return result


def written(tmp_path, result, evidence):
    path = tmp_path / "report.html"
    write_report(result, evidence, path)
    return Document(path.read_text(encoding="utf-8"))


def variants(result):
    """One diagnosis of each verdict, as far from complete as that verdict is."""
    yield result
    yield {**result, "verdict": "ambiguous", "experiment": "Lift it by the other end, and hold it for two seconds."}
    yield {**without(result, "effect"), "verdict": "unknown", "alternatives": [], "parameters": {}}
    yield {**result, "verdict": "measurement", "effect": "controller_delay"}
    nothing = without(result, "effect", "where", "when")
    yield {**nothing, "verdict": "adequate", "alternatives": [], "parameters": {}, "probabilities": {}}
    yield {"schema": 1, "verdict": "cannot_tell"}


@pytest.mark.parametrize("verdict", range(len(VERDICTS)))
def test_every_verdict_has_a_report(diagnosed, tmp_path, verdict):
    result, evidence = diagnosed
    result = list(variants(result))[verdict]
    document = written(tmp_path, result, evidence)
    assert headline(result) in document.text and VERDICTS[result["verdict"]] in document.text
    assert json.loads(document.scripts["diagnosis"]) == result
    ids = [attrs["id"] for _, attrs in document.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert {attrs["href"][1:] for tag, attrs in document.elements if tag == "a"} <= set(ids)
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]  # nothing temporary is left
    assert (tmp_path / "report.html").stat().st_size < 3_000_000


def test_each_verdict_has_words_of_its_own(diagnosed):
    results = list(variants(diagnosed[0]))
    assert [one["verdict"] for one in results] == ["missing", "ambiguous", "unknown", "measurement", "adequate", "cannot_tell"]
    assert {one["verdict"] for one in results} == set(VERDICTS)
    assert len({headline(one) for one in results}) == len(VERDICTS)


def test_the_page_says_what_the_diagnosis_says(diagnosed, tmp_path):
    text = " ".join(written(tmp_path, *diagnosed).text.split())
    # From the figures above: 12.3 -> 4.8 mm is 1 - 4.8 / 12.3 = 61 % less, 20.1 -> 9 mm is 55 % less;
    # of what could be closed on held-out frames, (12.3 - 4.8) / (12.3 - 1.6) = 70 %.
    assert "from 12.3 mm to 4.80 mm (61% less)" in text and "from 20.1 mm to 9.00 mm (55% less)" in text
    assert "70%" in text
    assert "0.052 kg (90 % interval: 0.047 to 0.058)" in text
    assert "frames 12 to 30" in text and "within 40 mm" in text
    assert EFFECTS["hidden_tether"] in text and "makes the transfer worse" in text and "-24%" in text
    assert "untested" in text and "83.2 s" in text and "Two tracks were left out" in text


def test_an_interval_that_is_open_below_says_how_far_up_it_goes(diagnosed):
    open_below = {"ground_raise": {"value": -0.0002, "unit": "m", "interval90": [None, 0.0003]}}
    assert "-0.0002 m (90 % interval: up to 0.0003)" in facts({**diagnosed[0], "parameters": open_below})


def test_likely_readings_are_said_where_something_is_missing():
    # the four likeliest, none below one in twenty; where nothing is said to be missing, or one reading is all, they are not
    chances = {"adequate": 0.06, "wind": 0.3, "creep": 0.26, "hidden_tether": 0.04, "pressure": 0.12, "unknown": 0.22}
    page = facts({"verdict": "unknown", "probabilities": chances})
    said = ["wind <code>wind</code> (30%)", "<code>creep</code> (26%)", "no name here (22%)", "<code>pressure</code> (12%)"]
    assert "how likely" in page and [page.index(one) for one in said] == sorted(page.index(one) for one in said)
    assert "nothing is missing" not in page and "hidden_tether" not in page
    assert "nothing is missing (60%)" in facts({"verdict": "unknown", "probabilities": {"adequate": 0.6, "unknown": 0.4}})
    for verdict, told in (("adequate", chances), ("cannot_tell", chances), ("missing", {"wind": 0.99, "unknown": 0.01})):
        assert "how likely" not in facts({"verdict": verdict, "probabilities": told})


def test_nothing_is_fetched_and_no_other_script_may_run(diagnosed, tmp_path):
    document = written(tmp_path, *diagnosed)
    source = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", source)
    assert not any({"src", "srcset", "action"} & set(attrs) for _, attrs in document.elements)
    assert not any(tag in ("link", "iframe", "object", "img", "base") for tag, _ in document.elements)
    policy = next(attrs["content"] for _, attrs in document.elements if attrs.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'") and "script-src 'sha256-" in policy


def test_hostile_text_stays_text(diagnosed, tmp_path):
    result = copy.deepcopy(diagnosed[0])
    said = result["evidence"]
    result["effect"] = result["experiment"] = HOSTILE
    result["alternatives"] = [HOSTILE]
    result["parameters"] = {HOSTILE: {"value": 1.0, "unit": HOSTILE, "interval90": [0.0, 2.0]}}
    result["detectable"] = {HOSTILE: 1.0}
    said["notes"] = [HOSTILE]
    said["recordings"][0]["name"] = said["recordings"][1]["role"] = HOSTILE
    said["hypotheses"][0].update(effect=HOSTILE, kind=HOSTILE, unit=HOSTILE, why=HOSTILE)
    plain, hostile = written(tmp_path, *diagnosed), written(tmp_path, result, diagnosed[1])
    assert json.loads(hostile.scripts["diagnosis"]) == result
    assert hostile.text.count(HOSTILE) >= 9
    kinds = {tag for tag, _ in plain.elements}
    assert {tag for tag, _ in hostile.elements} <= kinds
    assert sum(tag == "script" for tag, _ in hostile.elements) == sum(tag == "script" for tag, _ in plain.elements) == 3
    assert not any(name.startswith("on") for _, attrs in hostile.elements for name in attrs)


def test_what_is_not_a_number_is_null(diagnosed, tmp_path):
    result = copy.deepcopy(diagnosed[0])
    result["fit"]["heldout"]["extended"] = math.nan
    result["seconds"] = np.float32(math.inf)
    result["where"]["points"] = np.arange(3)
    result["evidence"]["curves"]["plush_drag"]["baseline"][5] = np.float64("nan")
    back = json.loads(written(tmp_path, result, diagnosed[1]).scripts["diagnosis"])
    assert back["fit"]["heldout"]["extended"] is None and back["seconds"] is None
    assert back["where"]["points"] == [0, 1, 2]
    assert back["evidence"]["curves"]["plush_drag"]["baseline"][5] is None
    assert back["evidence"]["curves"]["plush_drag"]["baseline"][6] == result["evidence"]["curves"]["plush_drag"]["baseline"][6]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"verdict": "misssing"}, "verdict must be one of adequate, missing, .*got 'misssing'"),
        ({"seconds": object()}, "got object"),
    ],
)
def test_a_wrong_diagnosis_is_refused_and_the_old_report_stays(diagnosed, tmp_path, change, message):
    path = tmp_path / "report.html"
    path.write_text("the report before")
    with pytest.raises(ValueError, match=message):
        write_report({**diagnosed[0], **change}, diagnosed[1], path)
    assert path.read_text() == "the report before" and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("baseline_0", np.zeros((48, 3, 3)), r"baseline_0 must have shape \(48, 175, 3\), got \(48, 3, 3\)"),
        ("controllers_1", np.zeros((4, 30, 3)), r"controllers_1 must have shape \(48, any, 3\)"),
        ("observed_0", np.zeros((48, 175)), r"observed_0 must have shape \(any, any, 3\)"),
        ("up", np.zeros(2), "up must be 3 finite numbers"),
        ("ground", [0, 0, 1, np.nan], "ground must be 4 finite numbers"),
    ],
)
def test_wrong_arrays_are_refused_by_name(diagnosed, tmp_path, name, array, message):
    with pytest.raises(ValueError, match=message):
        write_report(diagnosed[0], {**diagnosed[1], name: array}, tmp_path / "report.html")
    assert not list(tmp_path.iterdir())


def test_a_disk_that_refuses_leaves_the_old_report(diagnosed, tmp_path, monkeypatch):
    path = tmp_path / "report.html"
    path.write_text("the report before")

    def full(self, text, **options):
        self.write_bytes(text[:1000].encode())
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space left"):
        write_report(*diagnosed, path)
    assert path.read_bytes() == b"the report before" and list(tmp_path.iterdir()) == [path]


def unpacked(packed):
    """The page's ``unpack``, written again: code 65535 is missing, the others run from low to high."""
    codes = np.frombuffer(base64.b64decode(packed["data"]), "<u2").reshape(packed["shape"]).astype(float)
    low, high = np.array(packed["low"]), np.array(packed["high"])
    return np.where(codes == 65535, np.nan, low + codes / 65534 * (high - low))


def test_arrays_survive_the_page(diagnosed, tmp_path):
    result, evidence = diagnosed
    scene = json.loads(written(tmp_path, result, evidence).scripts["scene-data"])
    for index, one in enumerate(scene["recordings"]):
        assert one["frames"] == list(range(48)) and one["of"] == len(one["points"])  # the sample is small enough to be kept whole
        for name, packed in one["arrays"].items():
            array = np.asarray(evidence[f"{name}_{index}"], float)
            # half a step of 65534 over the range of an axis
            step = (np.nanmax(array, (0, 1)) - np.nanmin(array, (0, 1))) / 65534
            assert (np.nan_to_num(abs(unpacked(packed) - array)) <= 0.5 * step + 1e-9).all()
            assert (np.isnan(unpacked(packed)) == np.isnan(array)).all()
    assert "force" not in scene["recordings"][1]["arrays"]


def test_long_recordings_are_thinned_to_three_megabytes(tmp_path):
    rng = np.random.default_rng(0)
    count, frames, points = 8, 400, 900
    records = [{"name": f"r{i}", "role": "case" if i == 0 else "fitted_on", "frames": frames, "train_end": 300} for i in range(count)]
    evidence = {}
    for i in range(count):
        evidence[f"observed_{i}"] = rng.normal(size=(frames, points, 3))
        evidence[f"baseline_{i}"] = evidence[f"observed_{i}"] + 0.01
    curves = {one["name"]: {"baseline": rng.random(frames).tolist()} for one in records}
    marked = list(range(5, 900, 30))
    result = {"verdict": "unknown", "where": {"points": marked}, "evidence": {"recordings": records, "curves": curves}}
    document = written(tmp_path, result, evidence)
    assert 2_000_000 < (tmp_path / "report.html").stat().st_size < 3_000_000
    views = json.loads(document.scripts["scene-data"])["recordings"]
    assert all(one["frames"][0] == 0 and one["frames"][-1] == frames - 1 for one in views)
    assert set(marked) <= set(views[0]["points"])
    sizes = [len(one["frames"]) * len(one["points"]) for one in views]
    assert sizes[0] > 3 * max(sizes[1:])  # the case has four times the weight
    kept = unpacked(views[0]["arrays"]["observed"])
    truth = evidence["observed_0"][np.ix_(views[0]["frames"], views[0]["points"])]
    assert abs(kept - truth).max() < 1e-4  # a range of some 10 m in 65534 steps


def test_a_prediction_that_blew_up_costs_no_resolution():
    observed = np.random.default_rng(0).random((4, 5, 3))
    baseline = observed + 0.01
    baseline[3] = 1e9
    one = thin([view({"observed_0": observed, "baseline_0": baseline}, 0, {"role": "case"}, ())], 10_000)[0]
    assert np.isnan(unpacked(one["arrays"]["baseline"])[3]).all()
    assert abs(unpacked(one["arrays"]["baseline"])[:3] - baseline[:3]).max() < 2e-5


def test_a_wheel_holds_the_page():
    root = Path(__file__).resolve().parents[2]
    patterns = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["twinbench.diagnosis.page"]
    files = [file for file in (root / "diagnosis" / "page").iterdir() if file.is_file() and file.suffix != ".py"]
    assert len(files) == 7 and all(any(file.match(pattern) for pattern in patterns) for file in files)


def test_numbers_in_words():
    assert [number(x) for x in (0.0, 0.012345, 12.345, 1234.5, -31234.0, 3e7)] == ["0", "0.0123", "12.3", "1,230", "-31,200", "3e+07"]
    assert less(0.010, 0.004) == "60% less" and less(0.010, 0.012) == "20% more" and less(0.0, 1.0) is None and less(None, 1.0) is None
    assert extent([3, 4]) == "frame 3" and extent([3, 5]) == "frames 3 to 4" and extent(None) == "no single time"
    fit = {"heldout": {"baseline": 0.01, "extended": 0.002}}
    assert "80% less" in improvement({"effect": "wind", "fit": fit}) and "is 10.0 mm." in improvement({"effect": None, "fit": fit})
    assert improvement({}) == "" and improvement({"effect": "wind", "fit": {"heldout": {"baseline": 0.01, "extended": None}}}) == ""
    parts = [{"fitted": fitted, "representation": far} for fitted, far in ((True, 20.0), (False, 3.0), (False, 4.5))]  # mm
    assert improvement({"effect": None, "fit": fit, "budget": parts}).endswith(
        "Sound twins, which lack nothing, stray by up to 4.50 mm there."
    )


# The page in a browser ------------------------------------------------------------------------------------------------


def opened_with(browser, tmp_path, result, evidence, *, probe=""):
    """The state of the written page, what it said on the console, and its document; ``probe`` is script that runs after its own."""
    path = tmp_path / "report.html"
    write_report(result, evidence, path)
    root, said, document = browser(path, probe)
    return root.get("data-state"), said, document


def test_the_page_draws_without_error(diagnosed, tmp_path, browser):
    state, said, document = opened_with(browser, tmp_path, *diagnosed)
    assert state == "drawn" and said == []
    assert "plush_lift (transfer)" in document.text and "Mean track error at frame" in document.text


def test_the_browser_test_notices_an_error(diagnosed, tmp_path, browser):
    state, said, _ = opened_with(browser, tmp_path, *diagnosed, probe="missing.part()")
    assert state.startswith("error: ") and said


def test_every_control_works(diagnosed, tmp_path, browser):
    probe = """
    const press = (id, key) => document.getElementById(id).dispatchEvent(new KeyboardEvent('keydown', { key, cancelable: true }));
    for (const key of ['ArrowLeft', 'ArrowUp', '+', '-', '0', ' ', ' ']) press('scene', key);
    document.getElementById('scene').dispatchEvent(new WheelEvent('wheel', { deltaY: -100, cancelable: true }));
    for (const input of document.querySelectorAll('#panel input')) input.click();
    const select = document.getElementById('recording');
    select.value = '1';
    select.dispatchEvent(new Event('change'));
    document.querySelector('[data-cluster]').click();
    document.getElementById('frame').value = 20;
    document.getElementById('frame').dispatchEvent(new Event('input'));
    document.documentElement.dataset.frame = document.getElementById('now').textContent;
    """
    state, said, document = opened_with(browser, tmp_path, *diagnosed, probe=probe)
    assert state == "drawn" and said == []
    assert document.elements[0][1]["data-frame"] == "20 / 47"


@pytest.mark.parametrize("lost", ["extended", "baseline", "controllers", "force", "observed", "curves", "recordings", "up", "ground"])
def test_the_page_draws_what_is_left(diagnosed, tmp_path, browser, lost):
    result, evidence = without(diagnosed[0], "where", "when", "effect"), dict(diagnosed[1])
    result["evidence"].pop(lost, None)
    evidence = {name: array for name, array in evidence.items() if not name.startswith(lost)}
    state, said, _ = opened_with(browser, tmp_path, result, evidence)
    assert state == "drawn" and said == []


def test_the_page_draws_hostile_and_missing_values(diagnosed, tmp_path, browser):
    result = copy.deepcopy(diagnosed[0])
    result["evidence"]["recordings"][0]["name"] = HOSTILE
    result["evidence"]["recordings"][1]["train_end"] = None
    result["evidence"]["curves"] = {HOSTILE: {"baseline": [None] * 48, "extended": None, "noise_floor": None}}
    evidence = {**diagnosed[1], "baseline_0": np.full((48, 175, 3), np.nan), "force_0": np.zeros((48, 175, 3))}
    state, said, _ = opened_with(browser, tmp_path, result, evidence)
    assert state == "drawn" and said == []
