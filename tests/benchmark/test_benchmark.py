"""The runner, its cache and the tables, on small made collections and with methods that misbehave on purpose."""

import csv
import json
import math
import os
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.benchmark.cache import Cache, replacing
from twinbench.benchmark.checksum import checksum
from twinbench.benchmark.opening import Opened, listing, open_recordings
from twinbench.benchmark.plan import Evaluation, Fit, frames, plan
from twinbench.benchmark.provenance import peak_memory, reset_peak_memory
from twinbench.benchmark.results import Results, read_results, write_results
from twinbench.benchmark.runner import Runner, Settings
from twinbench.benchmark.table import blocks, latex, markdown, notes, terminal
from twinbench.datasets.collection import Collection
from twinbench.datasets.scenario import Camera, Observed, Scenario, Split, TransferPair
from twinbench.methods.base import Diverged, Method, Trajectory, Twin
from twinbench.methods.registry import methods
from twinbench.metrics.base import metrics

FRAMES, TRAIN = 10, 7
calls = Counter()
seen = []


@pytest.fixture(autouse=True)
def forget():
    calls.clear()
    seen.clear()


def made(name, *, seed=0, speed=0.01, train_end=TRAIN, recorded=FRAMES):
    """A body that follows its four hands along x, ``speed`` metres a frame."""
    random = np.random.default_rng(seed)
    shift = np.zeros((recorded, 1, 3))
    shift[:, 0, 0] = speed * np.arange(recorded)
    points = random.normal(size=(8, 3)) + shift
    return Scenario(
        name=name,
        points=points,
        visible=np.ones((recorded, 8), bool),
        motion_valid=np.ones((recorded, 8), bool),
        controllers=random.normal(size=(4, 3)) + shift,
        split=Split(train_end, recorded),
        tracks=points[:, :2],
        object="thing",
    )


def collection(**scenarios):
    scenarios = scenarios or {"drag": made("drag"), "lift": made("lift", seed=1)}

    def loader(name):
        def load():
            calls[f"load {name}"] += 1
            return scenarios[name]

        return load

    names = tuple(scenarios)
    pairs = (TransferPair((names[0],), names[1]),) if len(names) > 1 else ()
    published = {("prediction", "PhysTwin", "chamfer"): 0.012}
    return Collection("made", {name: loader(name) for name in names}, in_domain=names[:1], pairs=pairs, published=published)


@dataclass(frozen=True)
class Echo(Twin):
    """A twin that stays where it is, and misbehaves when told to."""

    start: list
    fault: str = ""

    def rollout(self, controllers):
        calls["rollout"] += 1
        positions = np.broadcast_to(np.array(self.start), (len(controllers), len(self.start), 3)).copy()
        if self.fault == "diverges":
            raise Diverged("too fast", frame=4)
        if self.fault == "nan late":
            positions[TRAIN + 1] = np.nan
        if self.fault == "too short":
            positions = positions[:-1]
        return Trajectory(positions, (positions.shape[1], 0, 0))

    def retarget(self, target):
        seen.append(target)
        return replace(self, start=target.structure.tolist())

    def save(self, folder):
        if self.fault == "killed":
            (Path(folder) / "first.json").write_text("{}")
            signal.raise_signal(signal.SIGKILL)
        (Path(folder) / "twin.json").write_text(json.dumps([self.start, self.fault]))

    @classmethod
    def load(cls, folder):
        return cls(*json.loads((Path(folder) / "twin.json").read_text()))


class EchoMethod(Method):
    name = "echo"
    twin_class = Echo
    fault = ""

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        calls["fit"] += 1
        seen.extend(observed)
        progress("looking", 0.5)
        if self.fault == "fit raises":
            raise KeyError("stiffness")
        if self.fault == "fit diverges":
            raise Diverged("exploded while fitting", frame=2)
        return Echo(observed[0].structure.tolist(), self.fault)

    def skip(self, scenario):
        return "no hands" if self.fault == "skips" else None


def faulty(kind):
    return type("Faulty", (EchoMethod,), {"name": "faulty", "fault": kind})


def run(tmp_path, found=None, *, use=None, progress=None, **options):
    found = found or collection()
    use = use or {"echo": EchoMethod}
    common = Settings(use, options.pop("metrics", metrics()), options.pop("preset", "quick"))
    fits = plan(found, methods=use, **options)
    runner = Runner(Opened(found), common, Cache(tmp_path / "cache"))
    return runner.run(fits, **({"progress": progress} if progress else {}))


def by_task(rows):
    return {row["task"]: row for row in rows}


# --- what is planned


def test_plan_shares_one_fit_between_all_its_evaluations():
    fits = plan(collection(), methods=["static"], seeds=[0, 1])
    evaluations = (Evaluation("resimulation", "drag"), Evaluation("prediction", "drag"), Evaluation("transfer", "lift"))
    assert fits == [Fit("static", ("drag",), seed, evaluations) for seed in (0, 1)]


def test_plan_keeps_the_rows_scored_on_chosen_recordings():
    assert [fit.evaluations for fit in plan(collection(), methods=["static"], scenarios=["lift"])] == [(Evaluation("transfer", "lift"),)]
    assert plan(collection(), methods=["static"], scenarios=["lift"], tasks=["prediction"]) == []


def test_plan_refuses_unknown_names():
    with pytest.raises(ValueError, match="unknown task 'predict'; did you mean 'prediction'"):
        plan(collection(), methods=["static"], tasks=["predict"])
    with pytest.raises(ValueError, match="unknown scenario 'drog' in made; did you mean 'drag'"):
        plan(collection(), methods=["static"], scenarios=["drog"])


def test_frames_of_tasks():
    # Frame 0 is given, so it is never scored; the tasks of one recording do not overlap.
    assert [list(frames(task, Split(3, 5))) for task in ("resimulation", "prediction", "transfer")] == [[1, 2], [3, 4], [1, 2, 3, 4]]


# --- what is computed


def test_rows_are_the_worked_out_numbers(tmp_path):
    # The body moves 10 mm a frame along x and the twin stays: in frame t every point is 10 t mm from its particle.
    rows = by_task(run(tmp_path, use={"static": methods()["static"]}))
    for task, scored in {"resimulation": range(1, 7), "prediction": range(7, 10), "transfer": range(1, 10)}.items():
        row = rows[task]
        assert (row["status"], row["frames"]) == ("ok", len(scored))
        assert row["track_error"] == pytest.approx(0.01 * np.mean(scored), abs=1e-6)  # single-precision positions of order 1
        assert row["coordinate_error"] == pytest.approx(0.01 * np.mean(scored) / 3, abs=1e-6)
    assert (rows["transfer"]["sources"], rows["transfer"]["scenario"]) == ("drag", "lift")


def test_the_rigid_twin_of_a_rigid_motion_is_exact(tmp_path):
    for row in run(tmp_path, use={"rigid": methods()["rigid"]}):
        assert row["track_error"] < 1e-6


def test_rows_carry_their_provenance(tmp_path):
    row = run(tmp_path)[0]
    for column in ("commit", "device", "python", "numpy", "twinbench", "date", "data_checksum", "code_checksum", "preset", "split"):
        assert isinstance(row[column], str) and row[column], column
    assert row["peak_memory_mib"] > 10 and row["fit_seconds"] >= 0 and row["rollout_seconds"] > 0


def test_methods_only_see_what_is_observed(tmp_path):
    run(tmp_path)
    source, target = seen
    assert type(source) is Observed and type(target) is Observed  # no split, no tracks
    assert (source.observed_frames, source.frame_count) == (TRAIN, FRAMES)
    assert (target.observed_frames, target.frame_count) == (1, FRAMES)


def test_one_fit_and_one_roll_out_serve_both_tasks_of_a_recording(tmp_path):
    run(tmp_path)
    assert (calls["fit"], calls["rollout"]) == (1, 2)  # in domain, and transfer


def test_progress_only_grows(tmp_path):
    told = []
    run(tmp_path, seeds=(0, 1), progress=lambda label, fraction: told.append((label, fraction)))
    fractions = [fraction for _, fraction in told]
    assert fractions == sorted(fractions) and (fractions[0], fractions[-1]) == (0, 1)
    assert {("echo on drag: looking", 0.25), ("echo on drag: scoring lift", 0.5), ("echo on drag: looking", 0.75)} <= set(told)


def test_a_twin_may_be_fitted_on_several_recordings(tmp_path):
    found = collection(a=made("a"), b=made("b", seed=1), c=made("c", seed=2))
    found = replace(found, in_domain=(), pairs=(TransferPair(("c", "a"), "b"),))
    (only,) = run(tmp_path, found)
    assert (only["sources"], only["scenario"], only["task"]) == ("c+a", "b", "transfer")
    assert [observed.name for observed in seen] == ["c", "a", "b"]  # two to fit on, then the target to be placed in


# --- what goes wrong


@pytest.mark.parametrize(
    ("kind", "status", "reason", "frame"),
    [
        ("fit raises", "failed", "KeyError: 'stiffness' (test_benchmark.py:", None),
        ("fit diverges", "diverged", "exploded while fitting", 2),
        ("diverges", "diverged", "too fast", 4),
        ("skips", "skipped", "no hands", None),
        ("too short", "failed", "ValueError: the roll-out has 9 frames, the controllers have 10", None),
    ],
)
def test_what_goes_wrong_is_a_row_and_the_others_still_come(tmp_path, kind, status, reason, frame):
    rows = run(tmp_path, use={"faulty": faulty(kind), "echo": EchoMethod})
    assert Counter(row["status"] for row in rows) == {status: 3, "ok": 3}
    for row in rows[:3]:
        assert (row["method"], row["status"], row["diverged_frame"]) == ("faulty", status, frame)
        assert row["reason"].startswith(reason)
        assert all(math.isnan(row[metric]) for metric in metrics())


def test_a_late_blow_up_spares_the_frames_before(tmp_path):
    rows = by_task(run(tmp_path, use={"faulty": faulty("nan late")}))
    assert rows["resimulation"]["status"] == "ok" and rows["resimulation"]["chamfer"] > 0
    for task in ("prediction", "transfer"):
        assert (rows[task]["status"], rows[task]["diverged_frame"]) == ("diverged", TRAIN + 1)
        assert math.isnan(rows[task]["chamfer"])


def test_failed_rows_are_tried_again_and_diverged_ones_are_not(tmp_path):
    for _ in range(2):
        run(tmp_path, use={"faulty": faulty("fit raises")})
    assert calls["fit"] == 2
    for _ in range(2):
        run(tmp_path, use={"faulty": faulty("fit diverges")})
    assert calls["fit"] == 3


def test_a_recording_without_test_frames_has_no_prediction(tmp_path):
    rows = by_task(run(tmp_path, collection(whole=made("whole", train_end=FRAMES))))
    assert rows["resimulation"]["status"] == "ok"
    assert (rows["prediction"]["status"], rows["prediction"]["reason"]) == ("skipped", "the recording has no frames for prediction")


def test_a_recording_that_cannot_be_read_is_known_before_any_fit_and_the_others_are_scored(tmp_path):
    def broken():
        calls["broken"] += 1
        assert calls["fit"] == 0
        raise ValueError("final_data.pkl: object_points is missing")

    found = collection(a=made("a"), b=made("b", seed=1), c=made("c", seed=2))
    pairs = (TransferPair(("a",), "b"), TransferPair(("a",), "c"), TransferPair(("b",), "c"), TransferPair(("c", "b"), "a"))
    found = replace(found, scenarios={**found.scenarios, "b": broken}, in_domain=("a", "b", "c"), pairs=pairs)
    rows = run(tmp_path, found, use={"echo": EchoMethod, "static": methods()["static"]})
    said = {(row["method"], row["task"], row["sources"], row["scenario"]): (row["status"], row["reason"]) for row in rows}
    assert len(said) == len(rows) == 2 * (3 * 2 + 4)
    for (_, _, sources, scenario), (status, reason) in said.items():
        lost = "b" in (*sources.split("+"), scenario)
        assert (status, reason) == (("unreadable", "b cannot be read: final_data.pkl: object_points is missing") if lost else ("ok", ""))
    assert calls["broken"] == 1  # once is enough
    results = Results.of(rows, metrics(), [found])
    assert notes(results)[0] == "made: 10 rows not scored (not in the means): b cannot be read: final_data.pkl: object_points is missing"
    assert "| echo |" in markdown(results) and "| 2 of 3 |" in markdown(results)


def test_a_recording_that_is_lost_on_the_way_is_a_row_too(tmp_path):
    found = collection()
    loads = found.scenarios["lift"]

    def once():
        if calls["load lift"]:
            raise FileNotFoundError(2, "No such file or directory", "lift/final_data.pkl")
        return replace(loads())  # which nobody else holds

    rows = by_task(run(tmp_path, replace(found, scenarios={**found.scenarios, "lift": once})))
    assert {task: row["status"] for task, row in rows.items()} == {"resimulation": "ok", "prediction": "ok", "transfer": "unreadable"}
    assert "lift/final_data.pkl" in rows["transfer"]["reason"]


def test_a_transfer_to_what_was_fitted_is_refused_by_name(tmp_path):
    found = collection(drag=made("drag"), copy=replace(made("copy"), session="another"), lift=made("lift", seed=1))
    found = replace(found, pairs=(TransferPair(("lift", "drag"), "copy"), TransferPair(("lift",), "copy")))
    rows = run(tmp_path, found, tasks=["transfer"])
    said = "a transfer recording must be another interaction, got the same as drag (scenario copy)"
    assert [(row["status"], row["reason"]) for row in rows] == [("failed", said), ("ok", "")] and calls["fit"] == 1


# --- what is remembered


def test_a_second_run_computes_nothing_and_says_the_same(tmp_path):
    first, second = run(tmp_path), run(tmp_path)
    assert (calls["fit"], calls["rollout"]) == (1, 2)
    assert [json.dumps(row) for row in first] == [json.dumps(row) for row in second]  # NaN is equal to itself as text


def test_more_tasks_use_the_twin_that_is_there(tmp_path):
    run(tmp_path, tasks=["prediction"])
    run(tmp_path)
    assert (calls["fit"], calls["rollout"]) == (1, 3)


@pytest.mark.parametrize(
    "change",
    [
        {"seeds": (5,)},
        {"preset": "full"},
        {"found": collection(drag=made("drag", speed=0.02), lift=made("lift", seed=1))},
        {"found": collection(drag=made("drag", train_end=6), lift=made("lift", seed=1))},
        {"use": {"echo": type("Echo2", (EchoMethod,), {"name": "echo2"}), "another": EchoMethod}},
    ],
    ids=["seed", "preset", "data", "split", "method"],
)
def test_other_circumstances_are_other_twins(tmp_path, change):
    run(tmp_path)
    before = calls["fit"]
    run(tmp_path, change.pop("found", None), **change)
    assert calls["fit"] > before


@dataclass(frozen=True)
class Pictures:
    """Images of 2 x 2 pixels; ``changed`` is the (kind, camera, frame) of one that differs. Counts what is read."""

    frame_count: int
    changed: tuple = ()

    def _read(self, kind, camera, frame):
        calls[f"read {kind}"] += 1
        if not 0 <= frame < self.frame_count:
            raise IndexError(f"frame {frame} is not within reach")
        return np.full((2, 2), self.changed == (kind, camera, frame))

    def __getattr__(self, kind):
        if kind not in ("color", "depth", "mask", "human_mask"):
            raise AttributeError(kind)
        return lambda camera, frame: self._read(kind, camera, frame)

    def until(self, frame_count):
        return replace(self, frame_count=min(frame_count, self.frame_count))


def pictured(changed=()):
    cameras = (Camera(np.eye(3), np.eye(4), 2, 2),) * 2
    return collection(drag=replace(made("drag"), images=Pictures(FRAMES, changed), cameras=cameras), lift=made("lift", seed=1))


@pytest.mark.parametrize(
    ("changed", "fits"),
    [
        (("mask", 0, 1), 2),
        (("mask", 1, TRAIN - 1), 2),  # no appearance looks there
        (("mask", 0, TRAIN), 1),  # not observed
        (("human_mask", 0, 1), 1),  # the method does not look at it
        (("depth", 1, 0), 1),
    ],
)
def test_a_twin_of_a_method_that_reads_images_is_known_by_those_it_may_see(tmp_path, changed, fits):
    looking = type("Looking", (EchoMethod,), {"name": "looking", "reads_images": ("mask",)})
    lengths = {"chamfer": metrics()["chamfer"]}
    for found in (pictured(), pictured(), pictured(changed)):
        run(tmp_path, found, use={"looking": looking}, metrics=lengths)
    assert calls["fit"] == fits


def test_images_that_no_method_and_no_metric_looks_at_are_not_read(tmp_path):
    run(tmp_path, pictured(), metrics={"chamfer": metrics()["chamfer"]})
    assert not [name for name in calls if name.startswith("read ")]


def test_another_version_of_a_metric_scores_again_without_fitting(tmp_path):
    found = metrics()
    run(tmp_path)
    changed = type("Changed", (type(found["chamfer"]),), {"version": 99})()
    run(tmp_path, metrics={**found, "chamfer": changed})
    assert (calls["fit"], calls["rollout"]) == (1, 4)


def test_other_method_code_is_another_twin(tmp_path, monkeypatch):
    run(tmp_path)
    monkeypatch.setattr("twinbench.benchmark.runner.SOURCES.files", lambda *modules: {"edited.py": "0"})
    run(tmp_path)
    assert calls["fit"] == 2


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b.replace(b"e", b"a"), lambda b: b"\xff" + b])
def test_damaged_entries_are_computed_again(tmp_path, damage):
    good = run(tmp_path)
    for file in (tmp_path / "cache").rglob("*.json"):
        file.write_bytes(damage(file.read_bytes()))
    again = run(tmp_path)
    assert calls["fit"] == 2
    for old, new in zip(good, again, strict=True):
        assert json.dumps([old[m] for m in metrics()]) == json.dumps([new[m] for m in metrics()])  # NaN is equal to itself as text
    run(tmp_path)
    assert calls["fit"] == 2  # and what was computed again is there


def test_a_twin_with_a_lost_file_is_fitted_again(tmp_path):
    run(tmp_path, tasks=["prediction"])
    next((tmp_path / "cache" / "fits").glob("*/content/twin.json")).unlink()
    run(tmp_path)
    assert calls["fit"] == 2


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=100, deadline=None)
@given(value=st.dictionaries(st.text(max_size=5), json_values, max_size=4), at=st.integers(0), flip=st.integers(1, 255))
def test_an_entry_comes_back_whole_or_not_at_all(tmp_path_factory, value, at, flip):
    cache = Cache(tmp_path_factory.getbasetemp() / "entries")
    cache.write("rows", "ab1", value)
    assert json.dumps(cache.read("rows", "ab1")) == json.dumps(value)
    (file,) = cache.root.rglob("ab1.json")
    damaged = bytearray(file.read_bytes())
    damaged[at % len(damaged)] ^= flip
    file.write_bytes(damaged)
    assert json.dumps(cache.read("rows", "ab1"), sort_keys=True) in (json.dumps(None), json.dumps(value, sort_keys=True))


def test_two_runs_may_store_the_same_twin(tmp_path):
    cache = Cache(tmp_path)
    for about in ({"run": 1}, {"run": 2}):
        cache.write_folder("fits", "key", lambda folder: (folder / "twin.json").write_text("{}"), about)
    folder, about = cache.read_folder("fits", "key")
    assert about == {"run": 1} and (folder / "twin.json").read_text() == "{}" and not list((tmp_path / "tmp").iterdir())


CHILD = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
import test_benchmark as t
from twinbench.benchmark.cache import replacing
{body}
"""


def child(body):
    source = CHILD.format(tests=str(Path(__file__).parent), body=body)
    return subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, timeout=60)


def test_a_run_killed_while_it_stores_a_twin_goes_on(tmp_path):
    died = child(f"t.run(Path({str(tmp_path)!r}), use={{'echo': t.EchoMethod, 'faulty': t.faulty('killed')}})")
    assert died.returncode == -signal.SIGKILL, died.stderr
    entries = list((tmp_path / "cache" / "fits").iterdir())
    assert len(entries) == 1 and list((tmp_path / "cache" / "tmp").iterdir())  # echo's twin; the other is not among the entries
    rows = run(tmp_path, use={"faulty": faulty("")})
    assert [row["status"] for row in rows] == ["ok"] * 3


FULL = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))  # every write beyond 200 bytes fails, as on a full disk
"""


def test_a_full_disk_is_one_error_and_leaves_nothing_half_written(tmp_path):
    attempt = f"t.run(Path({str(tmp_path)!r}), use={{'static': t.methods()['static']}})"
    said = child(f"{FULL}\ntry:\n    {attempt}\nexcept OSError as error:\n    print('REFUSED', error)")
    assert "REFUSED" in said.stdout and "cannot be written" in said.stdout, said.stdout + said.stderr
    assert not list((tmp_path / "cache").rglob("*.npz")) and not list((tmp_path / "cache" / "tmp").iterdir())
    assert [row["status"] for row in run(tmp_path, use={"static": methods()["static"]})] == ["ok"] * 3


def test_results_survive_a_full_disk(tmp_path):
    results = Results.of(run(tmp_path), metrics(), [collection()])
    write_results(results, tmp_path / "out")
    before = {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()}
    body = f"r = t.read_results(Path({str(tmp_path / 'out')!r}))\n{FULL}\n"
    body += f"try:\n    t.write_results(r, Path({str(tmp_path / 'out')!r}))\nexcept OSError:\n    print('REFUSED')"
    said = child(body)
    assert said.stdout.endswith("REFUSED\n"), said.stdout + said.stderr
    assert {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()} == before


def test_replacing_keeps_the_old_file_when_the_writer_fails(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("old")
    with pytest.raises(RuntimeError), replacing(file) as temporary:
        temporary.write_text("half of the n")
        raise RuntimeError
    assert file.read_text() == "old" and list(tmp_path.iterdir()) == [file]


# --- how recordings are known


def test_checksum_depends_on_every_array_and_not_on_the_name():
    one = made("one")
    assert checksum(one) == checksum(replace(one, name="two")) == checksum(made("three"))
    changed = [
        {"points": one.points + 1e-9},
        {"visible": ~one.visible},
        {"motion_valid": ~one.motion_valid},
        {"controllers": one.controllers * 2},
        {"surface": np.ones((1, 3))},
        {"interior": np.ones((1, 3))},
        {"tracks": None},
        {"split": Split(6, FRAMES)},
        {"fps": 31.0},
        {"gravity": np.zeros(3)},
        {"grips": [0, -1, -1, -1]},
        {"self_collision": True},
        {"object": "other"},
    ]
    assert len({checksum(replace(one, **change)) for change in changed} | {checksum(one)}) == len(changed) + 1


def test_listing_notices_every_change_of_a_file(tmp_path):
    file = tmp_path / "case" / "a.bin"
    file.parent.mkdir()
    file.write_bytes(b"1234")
    first = listing(tmp_path)
    assert listing(tmp_path) == first
    stat = file.stat()
    file.write_bytes(b"4321")
    os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # as a careful copy would
    second = listing(tmp_path)
    assert second != first
    (tmp_path / "b").write_bytes(b"")
    assert listing(tmp_path) not in (first, second)


def test_listing_follows_links_and_ends(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a").write_text("1")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "case").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "up").symlink_to(tmp_path / "data")
    first = listing(tmp_path / "data")
    (tmp_path / "elsewhere" / "a").write_text("12")
    assert listing(tmp_path / "data") != first


def test_recordings_opened_before_are_described_without_reading_them(tmp_path, monkeypatch):
    opened = []

    def reader(path, *, split):
        opened.append(path)
        return collection()

    monkeypatch.setattr("twinbench.benchmark.opening.open_collection", reader)
    (tmp_path / "data").mkdir()
    first, second = (open_recordings(str(tmp_path / "data"), split="published", cache=Cache(tmp_path / "cache")) for _ in range(2))
    assert len(opened) == 1
    for field in ("name", "in_domain", "pairs", "published", "citation"):
        assert getattr(second.collection, field) == getattr(first.collection, field) == getattr(collection(), field)
    assert second.collection.load("lift").name == "lift" and len(opened) == 2
    (tmp_path / "data" / "more").write_text("")
    open_recordings(str(tmp_path / "data"), split="published", cache=Cache(tmp_path / "cache"))
    assert len(opened) == 3


def test_checksums_of_unchanged_folders_need_no_reading(tmp_path):
    common = Settings({"echo": EchoMethod}, metrics())
    for _ in range(2):
        found = collection()
        Runner(Opened(found, key="listing"), common, Cache(tmp_path)).run(plan(found, methods=["echo"]))
    assert calls["load drag"] == calls["load lift"] == 1


# --- where rows come from


def test_peak_memory_notices_what_was_freed_again():
    reset_peak_memory()
    block = np.ones(2**25)  # 256 MiB
    del block
    assert peak_memory()["peak_memory_mib"] >= 256


def test_memory_of_the_graphics_card_is_that_of_torch_and_warp(monkeypatch):
    # Stand-ins for the two modules, with the calls that their documentation names: bytes at the high-water mark.
    used = {"reset": 0}
    cuda = SimpleNamespace(
        is_available=lambda: True,
        is_initialized=lambda: True,
        reset_peak_memory_stats=lambda: used.update(reset=used["reset"] + 1),
        max_memory_allocated=lambda: 3 * 2**20,
    )
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(cuda=cuda))
    warp = SimpleNamespace(get_cuda_devices=lambda: ["cuda:0"], get_mempool_used_mem_high=lambda device: 4 * 2**20)
    monkeypatch.setitem(sys.modules, "warp", warp)
    reset_peak_memory()
    assert used["reset"] == 1 and peak_memory()["peak_device_memory_mib"] == 7


# --- tables


def row(method, task, value, **other):
    return {
        "collection": "made",
        "scenario": "drag",
        "sources": "drag",
        "method": method,
        "task": task,
        "seed": 0,
        "status": "ok",
        "reason": "",
        "diverged_frame": None,
        "chamfer": value,
        "iou": 1 - 10 * value,
        "fit_seconds": 2.0,
        **other,
    }


def table(*rows, published=None):
    units, directions = {"chamfer": "m", "iou": ""}, {"chamfer": "lower", "iou": "higher"}
    return Results(rows, units, directions, {"made": published or {}})


MARKDOWN = """\
**made, prediction: the test frames, in the same roll-out from frame 0**

| method | chamfer [mm] | iou | n | fit [s] |
| --- | ---: | ---: | ---: | ---: |
| static | 40.00 | 0.600 | 2 | 2.0 |
| twin | **25.00** | **0.750** | 2 | 3.0 |
| PhysTwin (published) | 12 | - |  |  |

Means over n rows (recordings x seeds). Lower is better, except iou; marked: the best of the methods with most rows.
"""


def test_markdown_is_the_worked_out_table():
    results = table(
        row("static", "prediction", 0.03),
        row("static", "prediction", 0.05, scenario="lift"),
        row("twin", "prediction", 0.02),
        row("twin", "prediction", 0.03, scenario="lift", sources="lift", fit_seconds=4.0),
        published={("prediction", "PhysTwin", "chamfer"): 0.012, ("transfer", "PhysTwin", "chamfer"): 0.013},
    )
    assert markdown(results) == MARKDOWN


def test_a_method_that_diverged_somewhere_is_not_the_best():
    results = table(
        row("wild", "prediction", 0.001),
        row("wild", "prediction", math.nan, scenario="lift", status="diverged", reason="too fast", diverged_frame=4),
        row("calm", "prediction", 0.01),
        row("calm", "prediction", 0.01, scenario="lift"),
        row("static", "prediction", 0.02),
        row("static", "prediction", 0.02, scenario="lift"),
    )
    (block,) = blocks(results)
    assert block.best("chamfer", "lower") == {"calm"}
    assert notes(results) == ["made, prediction: wild diverged in 1 (not in the means): lift at frame 4: too fast"]
    assert "1 of 2" in terminal(results) and "10.00*" in terminal(results) and notes(results)[0] in terminal(results)


def test_published_figures_never_enter_means_nor_compete():
    results = table(row("a", "transfer", 0.02), row("b", "transfer", 0.03), published={("transfer", "a", "chamfer"): 0.0001})
    (block,) = blocks(results)
    assert [(line.method, line.means["chamfer"]) for line in block.lines] == [("a", 0.02), ("b", 0.03), ("a (published)", 0.0001)]
    assert block.best("chamfer", "lower") == {"a"}


def test_a_mean_over_fewer_rows_says_so():
    results = table(row("a", "transfer", 0.02), row("a", "transfer", math.nan, scenario="lift"), row("b", "transfer", 0.03))
    assert "20.00 (n=1)" in markdown(results)


def test_the_terminal_table_is_aligned():
    results = table(row("a_long_name", "transfer", 0.2), row("b", "transfer", 0.03))
    caption, rule, *head, rule_again, first, second, last = terminal(results).splitlines()[:8]
    assert caption == "made, transfer: another recording of the same object, after frame 0"
    assert [line.split() for line in head] == [["chamfer", "fit"], ["method", "[mm]", "iou", "n", "[s]"]]
    assert first.split() == ["a_long_name", "200.00", "-1.000", "1", "2.0"] and second.split() == ["b", "30.00*", "0.700*", "1", "2.0"]
    for word, value in {"[mm]": "30.00", "iou": "0.700", "n": "1", "[s]": "2.0"}.items():
        assert head[1].index(word) + len(word) == second.rindex(value) + len(value)  # columns end together
    assert len(set((rule, rule_again, last))) == 1 and len(rule) == max(map(len, (*head, first, second)))


def test_names_of_columns_are_stacked_only_where_the_terminal_table_is_too_wide():
    made = row("b", "transfer", 0.03, longer_name=0.2)
    results = Results([made], {"chamfer": "m", "longer_name": "m"}, {"chamfer": "lower", "longer_name": "lower"})
    wide = terminal(results).splitlines()
    assert [line.split() for line in wide[2:4]] == [["chamfer", "longer_name", "fit"], ["method", "[mm]", "[mm]", "n", "[s]"]]
    narrow = terminal(results, width=len(wide[1]) - 1).splitlines()
    assert [line.split() for line in narrow[2:5]] == [["longer_"], ["chamfer", "name", "fit"], ["method", "[mm]", "[mm]", "n", "[s]"]]
    assert len(narrow[1]) < len(wide[1]) and terminal(results, width=len(wide[1])).splitlines() == wide


def test_latex_escapes_names():
    text = latex(table(row("phys_twin & 50%", "transfer", 0.2), row("b", "transfer", 0.03)))
    assert r"phys\_twin \& 50\%" in text and r"\textbf{30.00}" in text
    assert text.count("{") == text.count("}") and text.count(r"\begin") == text.count(r"\end") == 2


def test_results_come_back_as_they_were_written(tmp_path):
    rows = run(tmp_path, use={"echo": EchoMethod, "faulty": faulty("diverges")})
    results = Results.of(rows, metrics(), [collection()])
    write_results(results, tmp_path / "out")
    again = read_results(tmp_path / "out")
    assert terminal(again) == terminal(results) and "PhysTwin (published)" in terminal(again)
    assert json.dumps(again.rows) == json.dumps(rows)
    with (tmp_path / "out" / "rows.csv").open(newline="") as file:
        written = list(csv.DictReader(file))
    assert [w["status"] for w in written] == [r["status"] for r in rows]
    assert [float(w["chamfer"]) for w in written[:3]] == [r["chamfer"] for r in rows[:3]]
    assert pyarrow.parquet.read_table(tmp_path / "out" / "rows.parquet").num_rows == len(rows)
    assert (tmp_path / "out" / "table.md").read_text() == markdown(results)


def test_results_that_are_not_there_or_damaged_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"rows.parquet is missing"):
        read_results(tmp_path)
    write_results(Results.of(run(tmp_path), metrics(), [collection()]), tmp_path)
    whole = pyarrow.parquet.read_table(tmp_path / "rows.parquet")
    texts = pyarrow.array(["near"] * whole.num_rows)
    damaged = {
        "rows.parquet has no column 'method'": whole.drop_columns(["method"]),
        "chamfer must be numbers in rows.parquet, got text": whole.set_column(whole.column_names.index("chamfer"), "chamfer", texts),
    }
    for said, table in damaged.items():
        pyarrow.parquet.write_table(table, tmp_path / "rows.parquet")
        with pytest.raises(ValueError, match=f"cannot be read: {said}"):
            read_results(tmp_path)
    pyarrow.parquet.write_table(whole, tmp_path / "rows.parquet")
    known = (tmp_path / "about.json").read_text()
    for about, said in (("[]", ""), ("{}", "about.json has no 'published'"), ("{", "")):
        (tmp_path / "about.json").write_text(about)
        with pytest.raises(ValueError, match=f"cannot be read: {said}"):
            read_results(tmp_path)
    (tmp_path / "about.json").write_text(known)
    (tmp_path / "rows.parquet").write_bytes(b"PAR1 and nothing else")
    with pytest.raises(ValueError, match="cannot be read"):
        read_results(tmp_path)
