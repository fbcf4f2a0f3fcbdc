"""Submissions: scored as the run that they stand for, to the last digit; and every fault of one is said, all at once."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from things import NAMES, scenario, write_things
from twinbench.benchmark.api import studies
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.cli import main
from twinbench.benchmark.opening import Opened, open_recordings
from twinbench.benchmark.results import read_results
from twinbench.benchmark.submissions import check, checked, score, write_template
from twinbench.benchmark.submissions.format import ORDER, Rollout
from twinbench.benchmark.submissions.reading import read_rollout, rollout_rules
from twinbench.benchmark.submissions.rules import DATA_FIELDS, ROLLOUT_FIELDS, SUBMISSION_FIELDS
from twinbench.benchmark.submissions.writing import write_submission
from twinbench.datasets.collection import Collection
from twinbench.datasets.findings import collected
from twinbench.datasets.scenario import Split
from twinbench.methods.appearance.config import PRESETS
from twinbench.methods.base import Diverged, Method, Trajectory, Twin
from twinbench.methods.registry import methods
from twinbench.metrics.base import get_metric

LENGTHS = ("chamfer", "chamfer_l2", "track_error", "coordinate_error")
# what is of the machine and the moment, or of a fit that a submission does not make
ELSEWHERE = {"date", "device", "commit", "code_checksum", "peak_memory_mib", "peak_device_memory_mib", "rollout_seconds"}
DOCS = Path(__file__).resolve().parents[2] / "docs" / "submissions.md"


@pytest.fixture(scope="module")
def things(tmp_path_factory):
    return write_things(tmp_path_factory.mktemp("cases") / "thing")


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Each test in its own working directory with its own cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def cache(tmp_path):
    return Cache(tmp_path / "cache")


@pytest.fixture
def opened(things, cache):
    return open_recordings(str(things), split="published", cache=cache)


@pytest.fixture(scope="module")
def sound(things, tmp_path_factory):
    """A sound submission of the static method."""
    store = Cache(tmp_path_factory.mktemp("sound") / "cache")
    (study,) = studies(str(things), methods=["static"], cache=store.root, quiet=True)
    ((opened, fits),) = study.work
    write_submission(study, opened, fits, store.root / "static")
    return store.root / "static"


@pytest.fixture
def static(sound):
    """The same, to be spoilt."""
    shutil.copytree(sound, "subs/static")
    return Path("subs/static")


def submitted(data, method, capsys, *options):
    assert main(["run", "--quiet", "--methods", method, "--data", str(data), "--metrics", *LENGTHS, "--out", "run", *options]) == 0
    assert main(["submit", "write", "run", "--out", "subs"]) == 0
    capsys.readouterr()
    return Path("subs") / method


def same(ours, theirs):
    """Rows that say the same, to the last digit."""
    assert len(ours) == len(theirs) > 0
    for one, other in zip(ours, theirs, strict=True):
        assert one.keys() == other.keys()
        for name in one.keys() - ELSEWHERE:
            a, b = one[name], other[name]
            assert a == b or (isinstance(a, float) and math.isnan(a) and math.isnan(b)), (one["method"], one["scenario"], name, a, b)


# --- the round trip


@pytest.mark.parametrize("method", ["static", "rigid"])
def test_a_runs_twins_submitted_score_as_the_run_did(things, method, capsys):
    folder = submitted(things, method, capsys, "--seeds", "0", "3")
    assert main(["submit", "check", str(folder), "--data", str(things)]) == 0
    assert main(["submit", "score", str(folder), "--data", str(things), "--metrics", *LENGTHS, "--out", "scored"]) == 0
    ran, scored = read_results("run"), read_results("scored")
    same(ran.rows, scored.rows)
    assert len(scored.rows) == 2 * 2 * (2 + 1)  # seeds, sources, tasks
    assert str(ran) == str(scored)  # the same table


@dataclass(frozen=True)
class Faithless(Twin):
    """Holds frame 0 of N points; what becomes of its roll-out is ``fate``."""

    structure: np.ndarray
    fate: str
    note = "a note\nof two lines"

    def rollout(self, controllers):
        if self.fate == "diverges":
            raise Diverged("a particle is 2 km away", 4)
        kind = float if self.fate == "is double" else np.float32
        positions = np.repeat(self.structure[None].astype(kind) * (1 + 1e-9), len(controllers), 0)
        if self.fate == "is lost late":
            positions[8:, 2] = np.inf
        return Trajectory(positions, (len(self.structure) - 2, 2, 0))

    def retarget(self, target):
        if self.fate == "fails brought over":
            raise KeyError("nothing\nto hold")
        return replace(self, structure=target.structure)

    def save(self, folder):
        np.savez(folder / "twin.npz", structure=self.structure, fate=self.fate)

    @classmethod
    def load(cls, folder):
        with np.load(folder / "twin.npz") as kept:
            return cls(kept["structure"], str(kept["fate"]))


class Holds(Method):
    """Holds frame 0."""

    name, fate, twin_class = "holds", "", Faithless

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        return Faithless(observed[0].structure, self.fate)


class Diverges(Holds):
    name, fate = "diverges", "diverges"


class LostLate(Holds):
    name, fate = "lost-late", "is lost late"


class Double(Holds):
    name, fate = "double", "is double"


class Fails(Holds):
    name, fate = "fails", "fails brought over"


class Stays(Holds):
    name, skip_transfer = "stays", "it stays where it is"


class Picky(Holds):
    name = "picky"

    def skip(self, scenario):
        return "it does not like the second" if scenario.name == NAMES[1] else None


@pytest.mark.long
@pytest.mark.parametrize(
    "kind", [LostLate, Fails, Picky, *(pytest.param(k, marks=pytest.mark.slow) for k in (Holds, Diverges, Double, Stays))]
)
def test_whatever_becomes_of_a_roll_out_is_submitted_and_scored_so(things, tmp_path, cache, kind):
    (study,) = studies(str(things), methods=[kind], metrics=LENGTHS, cache=cache.root, quiet=True)
    ran = study.run()
    ((opened, fits),) = study.work
    write_submission(study, opened, fits, tmp_path / "made")
    assert not [finding for finding in check(tmp_path / "made", opened, cache) if finding.severity == "error"]
    scored = score(tmp_path / "made", opened, {name: get_metric(name) for name in LENGTHS}, cache=cache)
    same(ran.rows, scored.rows)
    ends = {row["status"] for row in ran.rows}
    assert ends == {Holds: {"ok"}, Double: {"ok"}, Diverges: {"diverged"}, Fails: {"ok", "failed"}}.get(kind, ends) and ends != {"failed"}
    if kind in (LostLate, Stays, Picky):
        assert len(ends) == 2
    again = score(tmp_path / "made", opened, {name: get_metric(name) for name in LENGTHS}, cache=cache)
    same(scored.rows, again.rows)


# what a fit may do here: the round trip does not care how good a twin is
SMALL = dict(iterations=1, population=3, epochs=1, recordings=1, frames=6, anchors=24, opacity_steps=2, width=64, batch=2)
BUILT_IN = sorted(name for name, found in methods().items() if found.room == "methods")


def small(config, **changes):
    least = SMALL | changes
    return replace(config, **{field.name: least[field.name] for field in fields(config) if field.name in least})


def there_and_back(method, monkeypatch, *metrics):
    """The rows of a method on the sample, run and submitted, which must be the same."""
    kind = methods()[method].kind
    for one in (kind, methods()[kind.builds_on].kind if kind.builds_on else kind):
        if hasattr(one, "presets"):
            monkeypatch.setattr(one, "presets", {name: small(config) for name, config in one.presets.items()})
    monkeypatch.setitem(PRESETS, "quick", small(PRESETS["quick"], iterations=20))
    assert main(["run", "--quiet", "--methods", method, "--metrics", *metrics, "--out", "run"]) == 0
    assert main(["submit", "write", "run", "--out", "subs"]) == 0
    assert main(["submit", "score", f"subs/{method}", "--metrics", *metrics, "--out", "scored"]) == 0
    ran = read_results("run").rows
    same(ran, read_results("scored").rows)
    return ran


@pytest.mark.slow
@pytest.mark.parametrize("method", BUILT_IN)
def test_every_built_in_method_submitted_scores_as_it_ran(method, monkeypatch):
    rows = there_and_back(method, monkeypatch, *LENGTHS)
    assert any(row["status"] == "ok" for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rigid", "spring-gaus-as-published"])
def test_images_of_what_was_submitted_are_those_of_the_run(method, monkeypatch):
    # the appearance of a recording is shared, with the quirks that the method is shown with, so its images are the same to the last pixel
    rows = there_and_back(method, monkeypatch, "iou_corrected")
    assert {row["appearance"] for row in rows} == {"as-published" if "published" in method else "corrected"}
    assert all(row["iou_corrected"] > 0 for row in rows if row["status"] == "ok")


def test_images_are_rendered_by_the_shared_appearance_or_a_reason_stands_there(things, static, opened, cache):
    found = score(static, opened, {name: get_metric(name) for name in ("chamfer", "iou")}, cache=cache)
    assert {row["iou_reason"] for row in found.rows} == {"the recording has no images"}
    assert all(row["chamfer"] > 0 and math.isnan(row["iou"]) for row in found.rows)


def test_where_it_came_from_goes_into_the_results(things, static, capsys):
    assert main(["submit", "score", str(static), "--data", str(things), "--metrics", "chamfer", "--out", "scored"]) == 0
    about = read_results("scored").origin["submission"]
    said = json.loads((static / "submission.json").read_text())
    assert {name: about[name] for name in said if name not in ("rollouts", "format")} == {
        name: value for name, value in said.items() if name not in ("rollouts", "format")
    }
    assert re.fullmatch(r"[0-9a-f]{64}", about["sha256"])


# --- what can be wrong


def spoil(folder, change):
    """``change(values)`` of submission.json."""
    file = folder / "submission.json"
    values = json.loads(file.read_text())
    change(values)
    file.write_text(json.dumps(values))


def put(*path, value):
    def change(values):
        for part in path[:-1]:
            values = values[part]
        values[path[-1]] = value

    return change


def drop(*path):
    def change(values):
        for part in path[:-1]:
            values = values[part]
        del values[path[-1]]

    return change


def said(folder, opened, cache):
    found = check(folder, opened, cache)
    assert all("\n" not in str(finding) and str(folder) in str(finding.file) for finding in found)
    return [f"{finding.severity}: {finding.said}" for finding in found]


METADATA = {
    "method must be the method's name in tables": put("method", value="a\x1b[31m"),
    "method is missing: it must be": drop("method"),
    "authors must be who submits": put("authors", value=" "),
    "date must be the day on which the roll-outs were computed, as YYYY-MM-DD, got '2026-02-30'": put("date", value="2026-02-30"),
    "code must be a link that begins with https": put("code", value="javascript:alert(1)"),
    "versions must be an object of at most 50 versions by package": put("versions", value={"torch": 2}),
    "test_frames_unseen must be true": put("test_frames_unseen", value="true"),
    "other_data must be what it was trained on": put("other_data", value=3),
    "appearance must be": put("appearance", value="pretty"),
    "tasks must be a list of some of resimulation, prediction, transfer, each once": put("tasks", value=["prediction", "prediction"]),
    "format must be 1, the format of this file, got 2": put("format", value=2),
    "'autors' is no field here; did you mean 'authors'?": put("autors", value="me"),
    "data must be an object with collection, split and recordings": put("data", value=[]),
    "data.split must be one of published, clean": put("data", "split", value="other"),
    "data.recordings must be an object of checksums": put("data", "recordings", NAMES[0], value="12"),
    "data.recordings lacks the checksum of lift_once, which is": drop("data", "recordings", NAMES[0]),
    "the roll-outs were made for another recording, or one of them was changed": put("data", "recordings", NAMES[0], value="0" * 64),
    "rollouts must be a list": put("rollouts", value={}),
    "rollouts[1] must be an object, got 'x'": put("rollouts", 1, value="x"),
    "rollouts[1].fitted_on must be a list of the recordings": put("rollouts", 1, "fitted_on", value="lift_once"),
    "rollouts[1].seed must be a whole number >= 0, got -1": put("rollouts", 1, "seed", value=-1),
    "rollouts[1].status must be one of ok, diverged, skipped, failed": put("rollouts", 1, "status", value=["ok"]),
    "rollouts[1].fit_seconds must be seconds >= 0, or null, got -1": put("rollouts", 1, "fit_seconds", value=-1),
    "must name its file, or have another status": drop("rollouts", 1, "file"),
    'must have no file where its status is "skipped"': put("rollouts", 1, "status", value="skipped"),
    "rollouts[1].file must be a path of an .npz file in the folder": put("rollouts", 1, "file", value="../../static/rollouts/1.npz"),
    "rollouts[0].file must be a path of an .npz file": put("rollouts", 0, "file", value="/etc/passwd.npz"),
    "unknown recording 'lift_onec'; did you mean 'lift_once'?": put("rollouts", 0, "recording", value="lift_onec"),
    "rollouts lack the roll-out of lift_once, seed 0": drop("rollouts", 0),
    "the roll-out of lift_once, seed 0 once, got it 2 times": lambda values: values["rollouts"].append(dict(values["rollouts"][0])),
    "must name each file once, got": lambda values: values["rollouts"][1].update(file=values["rollouts"][0]["file"]),
    "rollouts lack the roll-out of lift_once by the twin fitted on lift_twice, seed 7": put("rollouts", 0, "seed", value=7),
    "is not asked for: the roll-out of lift_twice by the twin fitted on lift_once": put("tasks", value=["prediction"]),
}


@pytest.mark.parametrize("rule", METADATA)
def test_every_fault_of_the_metadata_is_said(static, opened, cache, rule):
    spoil(static, METADATA[rule])
    errors = [line for line in said(static, opened, cache) if line.startswith("error")]
    assert any(rule in line for line in errors), errors
    with pytest.raises(ValueError, match=r"submission\.json: "):
        checked(static, opened, cache)
    assert main(["submit", "score", str(static), "--data", opened.path, "--out", "scored"]) == 2


def arrays_of(folder, number=0):
    file = folder / json.loads((folder / "submission.json").read_text())["rollouts"][number]["file"]
    with np.load(file) as found:
        return file, dict(found)


ROLLOUTS = {
    "positions must have the recording's 10 frames, from frame 0 on, got 3: as many as are tested": lambda p, c: (p[7:], c),
    "got 9: is frame 0 missing?": lambda p, c: (p[1:], c),
    "are frames and particles exchanged?": lambda p, c: (p.transpose(1, 0, 2), (10, 0, 0)),
    "positions must have shape (frames, particles, 3), got (10, 36)": lambda p, c: (p.reshape(10, 36), c),
    "positions must be of type float32 or float64, got float16": lambda p, c: (p.astype(np.float16), c),
    "positions must be of type float32 or float64, got int64": lambda p, c: (p.astype(int), c),
    "NaN or infinity in 2 frames, first in frame 8": lambda p, c: (np.where(np.arange(10)[:, None, None] < 8, p, np.nan), c),
    "in frame 0, which was recorded 0.1": lambda p, c: (p * 1000, c),
    "it looks like millimetres": lambda p, c: (p * 1000, c),
    "it looks like centimetres": lambda p, c: (p * 100, c),
    "must begin where the recording does, in its axes": lambda p, c: (p[..., [2, 0, 1]], c),
    "must lie within 1000 m of the origin, got 5000 m": lambda p, c: (np.where(np.arange(10)[:, None, None] < 9, p, 5000), c),
    "in the order of the recording's points, got point 0 at particle 11": lambda p, c: (p[:, ::-1], c),
    "counts must be three whole numbers >= 0 of tracked, surface and interior particles, 12 in all": lambda p, c: (p, (12, 1, 0)),
    "12 in all, got [13, -1, 0]": lambda p, c: (p, (13, -1, 0)),
    "12 in all, got [12.0, 0.0, 0.0]": lambda p, c: (p, (12.0, 0.0, 0.0)),
    "counts must have at least one tracked or surface particle": lambda p, c: (p, (0, 0, 12)),
    "counts must have shape (3,), got (2,)": lambda p, c: (p, (12, 0)),
    "positions must hold numbers, got Python objects": lambda p, c: (p.astype(object), c),
}


@pytest.mark.parametrize("rule", ROLLOUTS)
def test_every_fault_of_a_roll_out_is_said(static, opened, cache, rule):
    file, arrays = arrays_of(static)
    positions, counts = ROLLOUTS[rule](arrays["positions"], arrays["counts"])
    np.savez_compressed(file, positions=positions, counts=counts)
    errors = [line for line in said(static, opened, cache) if line.startswith("error")]
    assert len(errors) == 1 and rule in errors[0], errors


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (
            lambda p, c: (p[:, 1:], (11, 0, 0)),
            "counts has 11 tracked particles, and the recording 12 points: coordinate_error has no value",
        ),
        (
            lambda p, c: (p + np.float32(0.05) * np.sin(np.arange(12))[:, None], c),
            "begin beside the recorded body|not the recording's points",
        ),
    ],
)
def test_what_costs_a_metric_alone_is_a_warning(static, opened, cache, change, rule):
    file, arrays = arrays_of(static)
    positions, counts = change(arrays["positions"], arrays["counts"])
    np.savez_compressed(file, positions=positions.astype(np.float32), counts=counts)
    warnings = [line for line in said(static, opened, cache) if "positions" in line or "counts" in line]
    assert len(warnings) == 1 and re.match(f"warning: .*({rule})", warnings[0])
    rows = score(static, opened, {"coordinate_error": get_metric("coordinate_error")}, cache=cache).rows
    assert all(row["status"] == "ok" for row in rows)


def test_all_faults_are_said_at_once(static, opened, cache):
    files = [arrays_of(static, k)[0] for k in range(4)]
    files[0].unlink()
    files[1].write_bytes(b"PK")
    np.savez(files[2], positions=np.full((10, 12, 3), np.nan), counts=[12, 0, 0])
    np.savez(static / "rollouts" / "left.npz", positions=np.zeros(3))
    spoil(static, put("authors", value=""))
    spoil(static, put("data", "recordings", NAMES[1], value="0" * 64))
    lines = said(static, opened, cache)
    for rule in ("authors must be", "missing", "is not named in submission.json", "the roll-outs were made for another recording"):
        assert any(rule in line for line in lines), (rule, lines)
    assert any("NaN or infinity in 10 frames" in line for line in lines) and any("not a complete .npz" in line for line in lines)
    assert sum(line.startswith("error") for line in lines) == 5


def test_recordings_of_another_data_set_are_one_error_that_says_what_to_do(static, capsys):
    assert main(["submit", "check", str(static)]) == 1  # the sample is what is looked for where --data names nothing
    said = "and the recordings of sample are ['plush_drag', 'plush_lift']: --data names the folder that they are in"
    assert capsys.readouterr().out.count("error  ") == 1 and said in str(check(static, sample(), Cache(Path("cache")))[-1])


def test_recordings_that_the_data_set_has_not_are_named(static, opened, cache):
    spoil(static, put("data", "recordings", "push_9", value="0" * 64))
    (line,) = [line for line in said(static, opened, cache) if line.startswith("error")]
    assert "data.recordings has the unknown recording 'push_9'; " in line
    listed = json.loads((static / "submission.json").read_text())["rollouts"]
    spoil(static, put("rollouts", value=[one | {"recording": "push_9", "fitted_on": ["push_9"]} for one in listed[:1]]))
    (line,) = [line for line in said(static, opened, cache) if line.startswith("error")]
    assert "rollouts are of ['push_9'], and the recordings of " in line


def sample():
    return open_recordings("sample", split="published", cache=Cache(Path("cache")))


def test_a_link_that_leads_out_of_the_folder_is_not_followed(static, opened, cache, tmp_path):
    file, arrays = arrays_of(static)
    np.savez(tmp_path / "outside.npz", **arrays)
    file.unlink()
    file.symlink_to(tmp_path / "outside.npz")
    assert [line for line in said(static, opened, cache) if line.startswith("error")] == [
        "error: must lie in the folder of the submission, got a link that leads out of it"
    ]


def test_a_roll_out_that_diverged_is_scored_until_then(static, opened, cache):
    # diverged in frame 8: the frames 1 to 6 are scored as ever, the test frames 7 to 9 and transfers are not
    file, arrays = arrays_of(static)
    arrays["positions"][8] = np.nan
    np.savez(file, **arrays)
    spoil(static, put("rollouts", 0, "diverged_frame", value=8))
    rows = score(static, opened, {"chamfer": get_metric("chamfer")}, cache=cache).rows
    first = {row["task"]: row for row in rows if row["sources"] == row["scenario"] == NAMES[0]}
    assert first["resimulation"]["status"] == "ok"
    assert (first["prediction"]["status"], first["prediction"]["diverged_frame"]) == ("diverged", 8)
    spoil(static, put("rollouts", 0, "diverged_frame", value=10))
    assert any("must be one of the recording's frames 0 to 9, got 10" in line for line in said(static, opened, cache))


def test_changed_content_is_scored_anew(static, opened, cache):
    metrics = {"track_error": get_metric("track_error")}
    before = score(static, opened, metrics, cache=cache)
    file, arrays = arrays_of(static)
    np.savez(file, positions=arrays["positions"] + np.float32(0.001), counts=arrays["counts"])
    after = score(static, opened, metrics, cache=cache)
    assert before.rows[0]["track_error"] != after.rows[0]["track_error"]
    assert before.origin["submission"]["sha256"] != after.origin["submission"]["sha256"]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_whatever_metadata_say_they_are_read_or_refused(static, opened, cache, data):
    file = static / "submission.json"
    whole = file.read_text()
    values = json.loads(whole)
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.sampled_from(["top", "data", "rollouts"]))
        inside = {"top": values, "data": values.get("data"), "rollouts": values.get("rollouts")}[place]
        if place == "rollouts" and isinstance(inside, list) and inside:
            inside = inside[data.draw(st.integers(0, len(inside) - 1))]
        if isinstance(inside, dict):
            inside[data.draw(st.sampled_from([*inside, "other"]))] = data.draw(JSON)
    try:
        file.write_text(json.dumps(values))
        said(static, opened, cache)
    finally:
        file.write_text(whole)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(1, 12), st.integers(0, 3), st.integers(0, 3), st.sampled_from(["<f4", ">f4", "<f8"]), st.integers(0, 2**32 - 1))
def test_a_roll_out_reads_as_it_was_written(tmp_path, tracked, surface, interior, kind, seed):
    # whatever the particles are; the reader changes neither a bit nor the type
    positions = np.random.default_rng(seed).normal(size=(10, tracked + surface + interior, 3)).astype(kind)
    np.savez_compressed(tmp_path / "a.npz", positions=positions, counts=np.array([tracked, surface, interior], np.int32))
    found = read_rollout(tmp_path, Rollout("x", ("x",), file="a.npz"))
    np.testing.assert_array_equal(found.positions, positions)
    assert found.counts == (tracked, surface, interior) and found.positions.dtype == np.dtype(kind).newbyteorder("=")
    collected(rollout_rules(tmp_path, Rollout("x", ("x",), file="a.npz"), scenario(0)))  # and any beside any recording, without a fault


# --- the template


def test_the_template_is_filled_in_by_its_own_example(things, static, opened, cache, tmp_path):
    # its example holds frame 0: it must score as the method static does
    rollouts = write_template(tmp_path / "fresh", opened, cache=cache)
    assert [str(one) for one in rollouts][:2] == [
        "the roll-out of lift_once, seed 0",
        "the roll-out of lift_twice by the twin fitted on lift_once, seed 0",
    ]
    code = re.search(r"^```python\n(.*?)^```$", (tmp_path / "fresh" / "README.md").read_text(), re.M | re.S)[1]
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path / "fresh", check=True)
    errors = [line for line in said(tmp_path / "fresh", opened, cache) if line.startswith("error")]
    assert {line.split()[1] for line in errors} == {"method", "authors", "date", "code", "other_data", "test_frames_unseen"}
    filled = {"method": "mine", "authors": "me", "date": "2026-01-31", "code": "none", "other_data": "none", "test_frames_unseen": True}
    spoil(tmp_path / "fresh", lambda values: values.update(filled))
    metrics = {name: get_metric(name) for name in LENGTHS}
    mine, ours = (score(folder, opened, metrics, cache=cache).rows for folder in (tmp_path / "fresh", static))
    assert [[row[name] for name in LENGTHS] for row in mine] == [[row[name] for name in LENGTHS] for row in ours]


def test_nothing_of_the_test_frames_is_in_the_template(tmp_path, cache):
    # every array that the two folders hold, beside the recording: train frames alone, frame 0 alone; what is known of all frames is the
    # way of the controllers. The test frames are made recognisable: they hold the number 7.25 everywhere
    whole = scenario(0)
    marked = {name: getattr(whole, name).copy() for name in ("points", "tracks")}
    for values in marked.values():
        values[7:] = 7.25
    one = replace(whole, name="one", split=Split(7, 10), tracks=marked["tracks"], points=marked["points"])
    two = replace(one, name="two")
    made = Collection("made", {"one": partial(lambda s: s, one), "two": partial(lambda s: s, two)}, ("one", "two"))
    write_template(tmp_path / "fresh", Opened(made), cache=cache)
    for folder, frames in {"observed": 7, "initial": 1}.items():
        for name in ("one", "two"):
            with np.load(tmp_path / "fresh" / folder / f"{name}.npz") as found:
                assert {"tracks", "split"}.isdisjoint(found) and found["controllers"].shape == (10, 4, 3)
                assert all(len(found[key]) == frames for key in ("points", "visible", "motion_valid"))
                assert not any((found[key] == 7.25).any() for key in found.files)
    assert b"7.25" not in (tmp_path / "fresh" / "recordings.json").read_bytes()
    needed = json.loads((tmp_path / "fresh" / "recordings.json").read_text())["one"]
    assert (needed["frames"], needed["train_frames"], needed["counts"]["tracked"]) == (10, 7, 12)


# --- the command line, and the page that documents it


def test_the_commands_say_how_they_ended(things, static, capsys):
    assert main(["submit", "check", str(static), "--data", str(things)]) == 0
    assert "can be scored" in capsys.readouterr().out
    os.truncate(arrays_of(static)[0], 100)
    assert main(["submit", "check", str(static), "--data", str(things)]) == 1
    out = capsys.readouterr().out
    assert "one error" in out and "not a complete .npz file" in out
    assert main(["submit", "score", str(static), "--data", str(things)]) == 2
    assert "not a complete .npz file" in capsys.readouterr().err
    assert main(["submit", "new", "fresh", "--data", str(things), "--tasks", "prediction", "--seeds", "0", "1"]) == 0
    assert "asks for 4 roll-outs" in capsys.readouterr().out
    for arguments, rule in {
        ("submit", "new", "fresh", "--data", str(things)): "fresh: is there already; nothing is written over",
        ("submit", "check", "nowhere"): "no submission at nowhere: no such folder",
        ("submit", "chek"): "unknown command 'chek'; did you mean 'check'? known: new, check, score, write",
        ("submit", "new", "other", "--tasks", "predict"): "unknown task 'predict'; did you mean 'prediction'?",
        ("submit", "write", "nowhere", "--out", "x"): "no results in nowhere",
    }.items():
        assert main(list(arguments)) == 2
        assert rule in capsys.readouterr().err, arguments


def test_a_run_that_left_recordings_out_is_not_submitted(things, capsys):
    assert main(["run", "--quiet", "--methods", "static", "--data", str(things), "--metrics", "chamfer", "--scenarios", NAMES[0]]) == 0
    assert main(["submit", "write", "results/thing", "--out", "subs"]) == 2
    assert "the run was of some recordings only, and a submission covers all: run without --scenarios" in capsys.readouterr().err
    assert not list(Path("subs").glob("*"))
    assert main(["run", "--quiet", "--methods", "static", "--data", str(things), "--metrics", "chamfer"]) == 0
    assert main(["submit", "write", "results/thing", "--out", "subs", "--methods", "statik"]) == 2
    assert "unknown method 'statik'; did you mean 'static'?" in capsys.readouterr().err
    Path("subs/static").mkdir()
    (Path("subs/static") / "mine.txt").touch()
    assert main(["submit", "write", "results/thing", "--out", "subs"]) == 2
    assert "subs/static: is there already; nothing is written over" in capsys.readouterr().err


def test_the_page_names_every_field():
    text = DOCS.read_text(encoding="utf-8")
    named = set(re.findall(r"^\| `([\w.]+)` \|", text, re.M))
    assert tuple(SUBMISSION_FIELDS) == ORDER
    assert {*SUBMISSION_FIELDS, *ROLLOUT_FIELDS, *(f"data.{name}" for name in DATA_FIELDS)} <= named
    assert {"positions", "counts"} <= named
