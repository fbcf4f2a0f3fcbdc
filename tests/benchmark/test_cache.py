"""What is remembered: entries that were tampered with are not used, killed writers leave nothing, and what is fitted again says why."""

import json
import multiprocessing
import os
import shutil
import signal
import sys
import time
from dataclasses import dataclass

import numpy as np
import pytest
from twinbench.benchmark.cache import FORMAT, KINDS, Cache, digest, replacing
from twinbench.benchmark.cli import main
from twinbench.benchmark.opening import Opened, open_recordings
from twinbench.benchmark.origin import Origin, changes
from twinbench.benchmark.plan import plan
from twinbench.benchmark.runner import Runner, Settings
from twinbench.benchmark.sources import SOURCES
from twinbench.benchmark.upkeep import prune
from twinbench.datasets.collection import Collection
from twinbench.datasets.phystwin import write_case
from twinbench.datasets.scenario import Scenario, Split
from twinbench.datasets.temporary import DAY, sweep
from twinbench.methods.base import Method, Trajectory, Twin
from twinbench.methods.registry import methods
from twinbench.metrics.base import metrics

KEY, OTHER = digest("one"), digest("two")
TRACK = {"track_error": metrics()["track_error"]}


def put(cache, key=KEY, kind="fits", says="good"):
    cache.write_folder(kind, key, lambda folder: (folder / "twin.json").write_text(json.dumps(says)), {"note": says})


def got(cache, key=KEY, kind="fits"):
    found = cache.read_folder(kind, key)
    return found and json.loads((found[0] / "twin.json").read_text())


@pytest.fixture
def cache(tmp_path):
    return Cache(tmp_path / "cache")


# --- entries that somebody tampered with


def described(path, **changed):
    """Rewrite what describes an entry: ``value`` etc. replaced, and a digest over the value alone where that is asked for."""
    entry = json.loads(path.read_text())
    alone = changed.pop("alone", False)
    entry |= changed
    if alone:
        entry["digest"] = digest(entry["value"])
    path.write_text(json.dumps(entry))


def edit_value(cache, file, entry):
    described(entry, value={**json.loads(entry.read_text())["value"], "extra": 1})


def edit_value_and_its_digest(cache, file, entry):
    described(entry, value={**json.loads(entry.read_text())["value"], "extra": 1}, alone=True)


def digest_of_the_value_alone(cache, file, entry):
    described(entry, alone=True)


def drop_the_digest(cache, file, entry):
    entry.write_text(json.dumps({k: v for k, v in json.loads(entry.read_text()).items() if k != "digest"}))


def digest_of_another_version(cache, file, entry):
    said = json.loads(entry.read_text())
    described(entry, digest=digest(FORMAT - 1, "fits", KEY, said["made"], said["value"]))


def nested_too_deeply(cache, file, entry):
    entry.write_text('{"value":' + "[" * 200000)


def a_list(cache, file, entry):
    entry.write_text("[]")


def made_from_something_else(cache, file, entry):
    described(entry, made={"inputs": {"seed": 1}, "subject": {}})


TAMPERINGS = [edit_value, edit_value_and_its_digest, digest_of_the_value_alone, drop_the_digest, digest_of_another_version,
              nested_too_deeply, a_list, made_from_something_else]  # fmt: skip


@pytest.mark.parametrize("tamper", TAMPERINGS)
def test_an_entry_that_was_tampered_with_is_not_used(cache, tamper):
    cache.write("rows", KEY, {"chamfer": 1.0})
    put(cache)
    row = cache.root / "rows" / KEY[:2] / f"{KEY}.json"
    for file in (row, cache.root / "fits" / KEY / "entry.json"):
        tamper(cache, file, file)
    assert cache.read("rows", KEY) is None and got(cache) is None
    cache.write("rows", KEY, {"chamfer": 2.0})
    put(cache, says="again")
    assert cache.read("rows", KEY) == {"chamfer": 2.0} and got(cache) == "again"


def test_an_entry_of_another_key_or_kind_is_not_used(cache):
    cache.write("rows", OTHER, {"chamfer": 0.0})
    put(cache, OTHER, says="other")
    put(cache, KEY, kind="appearances", says="other kind")
    for kind in ("rows", "collections", "checksums"):
        for key in (KEY, OTHER):
            file = cache.root / kind / key[:2] / f"{key}.json"
            if (kind, key) != ("rows", OTHER):
                file.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(cache.root / "rows" / OTHER[:2] / f"{OTHER}.json", file)
                assert cache.read(kind, key) is None
    for source in ("fits/" + OTHER, "appearances/" + KEY):
        shutil.copytree(cache.root / source, cache.root / "fits" / KEY)
        assert got(cache) is None
        shutil.rmtree(cache.root / "fits" / KEY)


def swap_content(content, other):
    shutil.rmtree(content)
    shutil.copytree(other, content)


def a_link_instead_of_the_content(content, other):
    shutil.copytree(content, content.parent.parent.parent / "elsewhere")
    shutil.rmtree(content)
    content.symlink_to(content.parent.parent.parent / "elsewhere")


def a_link_instead_of_a_file(content, other):
    (content / "twin.json").rename(content.parent / "twin.json")
    (content / "twin.json").symlink_to(content.parent / "twin.json")


def a_pipe_instead_of_a_file(content, other):
    (content / "twin.json").unlink()
    os.mkfifo(content / "twin.json")


def a_pipe_instead_of_the_description(content, other):
    (content.parent / "entry.json").unlink()
    os.mkfifo(content.parent / "entry.json")


CONTENT = [
    swap_content,
    a_link_instead_of_the_content,
    a_link_instead_of_a_file,
    a_pipe_instead_of_a_file,
    a_pipe_instead_of_the_description,
    lambda content, other: (content / "more.py").write_text("raise SystemExit"),
    lambda content, other: (content / "empty").mkdir(),
    lambda content, other: (content / "out").symlink_to("/etc/hostname"),
    lambda content, other: (content / "twin.json").write_text('"edited"'),
    lambda content, other: (content / "twin.json").rename(content / "other.json"),
    lambda content, other: shutil.rmtree(content),
    lambda content, other: (shutil.rmtree(content), content.write_text("")),
    lambda content, other: (shutil.rmtree(content.parent), content.parent.write_text("")),
    lambda content, other: (content.parent.rename(content.parent.parent.parent / "moved"),
                            content.parent.symlink_to(content.parent.parent.parent / "moved")),
]  # fmt: skip


@pytest.mark.parametrize("tamper", CONTENT)
def test_a_folder_whose_content_was_tampered_with_is_not_used(cache, tamper):
    put(cache)
    put(cache, OTHER, says="other")
    tamper(cache.root / "fits" / KEY / "content", cache.root / "fits" / OTHER / "content")
    assert got(cache) is None
    put(cache, says="again")
    assert got(cache) == "again" and not list((cache.root / "tmp").iterdir())


def test_a_folder_in_the_place_of_a_row_is_replaced(cache):
    (cache.root / "rows" / KEY[:2] / f"{KEY}.json" / "inside").mkdir(parents=True)
    assert cache.read("rows", KEY) is None
    cache.write("rows", KEY, {"chamfer": 2.0})
    assert cache.read("rows", KEY) == {"chamfer": 2.0}


# --- a run on top of them


@dataclass(frozen=True)
class StillTwin(Twin):
    structure: np.ndarray

    def rollout(self, controllers):
        return Trajectory(np.repeat(self.structure[None], len(controllers), 0).astype(np.float32), (len(self.structure), 0, 0))

    def retarget(self, target):
        return StillTwin(target.structure)

    def save(self, folder):
        np.savez(folder / "twin.npz", structure=self.structure)

    @classmethod
    def load(cls, folder):
        with np.load(folder / "twin.npz") as arrays:
            return cls(arrays["structure"])


fits = []


class Still(Method):
    name = "still"
    twin_class = StillTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        fits.append(self.name)
        return StillTwin(observed[0].structure)


class Executed(Twin):
    """What a forged entry names: nothing of it may ever be called."""

    @classmethod
    def load(cls, folder):
        raise AssertionError("an entry chose the class")


Executed.__abstractmethods__ = frozenset()


def recording(seed=0, name="one"):
    random = np.random.default_rng(seed)
    points = np.repeat(random.uniform(-0.1, 0.1, (1, 9, 3)), 10, 0) - [0, 0, 0.3]
    seen = np.ones((10, 9), bool)
    return Scenario(
        name=name,
        points=points,
        visible=seen,
        motion_valid=seen,
        controllers=points[:, :2] + 0.01,
        split=Split(7, 10),
        tracks=points[:, :3],
    )


def run(cache, use=Still, seed=0, found=None):
    found = found or Opened(Collection("made", {"one": lambda: recording(seed)}, in_domain=("one",)))
    settings = Settings({"still": use}, TRACK)
    rows = Runner(found, settings, cache).run(plan(found.collection, methods=["still"], tasks=["prediction"]))
    return [(row["status"], row["reason"], row["track_error"]) for row in rows]


@pytest.mark.long
def test_what_an_entry_says_chooses_no_class(cache):
    good = run(cache)
    shutil.rmtree(cache.root / "rows")
    (entry,) = cache.root.glob("fits/*/entry.json")
    kind, key, said = "fits", entry.parent.name, json.loads(entry.read_text())
    said["value"]["about"] |= {"module": __name__, "class": "Executed"}
    # even where the digest is computed anew: the class is the method's
    entry.write_text(json.dumps(said | {"digest": digest(FORMAT, kind, key, said["made"], said["value"])}))
    assert cache.read_folder("fits", key) and run(cache) == good


@pytest.mark.parametrize(
    ("named", "reason"),
    [
        (None, "twin_class of a method must be the class of the twins that its fit returns, got None"),
        (StillTwin(np.zeros((1, 3))), "must be the class"),
        (dict, "must be the class"),
        (Executed, "fit returned a StillTwin, and twin_class of the method is Executed"),
    ],
)
def test_a_method_must_name_the_class_of_its_twins(cache, named, reason):
    ((status, why, _),) = run(cache, type("Wrong", (Still,), {"twin_class": named}))
    assert status == "failed" and reason in why


def test_a_subclass_of_the_named_twins_will_do(cache):
    class Special(StillTwin):
        pass

    class Method(Still):
        def fit(self, observed, **options):
            return Special(observed[0].structure)

    assert run(cache, Method)[0][0] == "ok"


# --- why something is computed again


def test_a_run_says_why_it_fits_again(cache, capsys, monkeypatch):
    run(cache)
    assert capsys.readouterr().err == ""  # there was nothing before
    run(cache)
    assert capsys.readouterr().err == ""  # nothing is fitted
    run(cache, seed=1)
    assert capsys.readouterr().err == "still on one: refitted because one changed\n"
    files = SOURCES.files
    monkeypatch.setattr(SOURCES, "files", lambda *modules: files(*modules) | {"methods/base.py": "edited", "methods/new.py": "new"})
    run(cache, seed=1)
    assert capsys.readouterr().err == "still on one: refitted because methods/base.py changed, it now imports methods/new.py\n"
    for file in cache.root.rglob("*.json"):
        file.write_text("")
    run(cache, seed=1)
    assert capsys.readouterr().err == "still on one: refitted because its entry in the cache is damaged\n"


def origin(code, data=("a",), names=("one",), **inputs):
    return Origin({"code": code, "data": list(data), "seed": 0, **inputs}, {"method": "m", "data": list(names)}).made


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (origin({"a.py": "1"}), origin({"a.py": "1"}), ""),
        (origin({"a.py": "1", "b.py": "1"}), origin({"a.py": "2", "b.py": "2"}), "a.py and b.py changed"),
        (origin({f"{k}.py": "1" for k in range(5)}), origin({f"{k}.py": "2" for k in range(5)}), "0.py, 1.py, 2.py and 2 more changed"),
        (origin({"a.py": "1"}), origin({}), "it no longer imports a.py"),
        (origin({"package p": "1.0"}), origin({"package p": "1.1"}), "package p (1.0, now 1.1) changed"),
        (origin({}, "ab", ("one", "one\nimages")), origin({}, "ac", ("one", "one\nimages")), "images of one changed"),
        (origin({}, method="m"), origin({}, method=["m", {"epochs": 2}]), "the method's options changed"),
    ],
)
def test_what_changed_is_said_in_words(before, after, said):
    assert changes(before, after) == said


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with two recordings, in a working directory and with a cache of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    for seed, name in enumerate(("lift_once", "lift_twice")):
        write_case(tmp_path / "thing" / name, recording(seed, name))
    return tmp_path / "thing"


def command(*arguments):
    return main(list(map(str, arguments)))


def fit_all(folder, *options):
    return command("run", "--data", folder, "--methods", "static", "rigid", "--metrics", "track_error", *options)


def test_list_explain_and_prune(folder, cache, capsys, monkeypatch):
    assert command("cache", "list") == 0 and "fits              0" in capsys.readouterr().out
    assert command("cache", "explain", "rigid", "--data", folder, "--metrics", "track_error") == 0
    assert capsys.readouterr().out.count("not fitted yet") == 2
    assert fit_all(folder) == 0
    capsys.readouterr()
    assert command("cache", "list", "--kinds", "fits", "rows") == 0
    out = capsys.readouterr().out
    assert "fits              4" in out and "rigid on lift_once (seed 0, quick, cpu)" in out and "prediction of lift_once" in out
    assert command("cache", "explain", "rigid", "--data", folder, "--metrics", "track_error") == 0
    out = capsys.readouterr().out
    assert out.count(": fitted, ") == 2 and "scored" not in out
    key = next(line.split()[-1] for line in out.splitlines() if "lift_once" in line)
    assert command("cache", "explain", key) == 0
    out = capsys.readouterr().out
    assert "rigid on lift_once" in out and "from twinbench.methods.rigid" in out and "It would be used again." in out
    assert command("cache", "prune") == 0 and capsys.readouterr().out.startswith("Freed 0.0 kB")

    files = SOURCES.files

    def edited(*modules):
        return files(*modules) | ({"methods/rigid.py": "edited"} if "twinbench.methods.rigid" in modules else {})

    monkeypatch.setattr(SOURCES, "files", edited)
    assert command("cache", "explain", "rigid", "--data", folder, "--metrics", "track_error") == 0
    assert capsys.readouterr().out.count("will be refitted because methods/rigid.py changed") == 2
    assert command("cache", "explain", key) == 0 and "Nothing would use it: its code changed" in capsys.readouterr().out
    before = sorted(cache.root.rglob("*"))
    assert command("cache", "prune", "--dry-run") == 0
    out = capsys.readouterr().out
    assert "fits              2" in out and "its code changed" in out and "Would free" in out and sorted(cache.root.rglob("*")) == before
    assert command("cache", "prune") == 0 and "Freed" in capsys.readouterr().out
    assert {entry.made["subject"]["method"] for entry in cache.entries("fits", "rows")} == {"static"}


def left(cache):
    return {kind: len(list(cache.entries(kind))) for kind in KINDS}


def test_prune_removes_what_no_recording_would_use(folder, cache):
    fit_all(folder)
    full = left(cache)
    assert not list(prune(cache)) and left(cache) == full and full["fits"] == 4
    write_case(folder / "lift_once", recording(7, "lift_once"), overwrite=True)
    why = {(kind, why) for kind, _, why in prune(cache)}
    # the folder was changed: its old listing is of no use. What is in it now nobody has read, so twins are kept
    assert why == {("collections", "its recordings changed"), ("checksums", "its recordings changed")} and left(cache)["fits"] == 4
    fit_all(folder)
    assert {(kind, why) for kind, _, why in prune(cache)} == {("fits", "its recordings changed"), ("rows", "its recordings changed")}
    assert left(cache) == full
    shutil.rmtree(folder)
    list(prune(cache))
    assert not any(left(cache).values())


def test_prune_removes_the_old_the_damaged_and_the_left_over(cache):
    run(cache)
    (fit,) = cache.entries("fits")
    put(cache)
    (cache.root / "fits" / KEY / "content" / "twin.json").write_text("edited")
    old = cache.root / "rows" / OTHER[:2] / f"{OTHER}.json"
    old.parent.mkdir(exist_ok=True)
    old.write_text(json.dumps({"digest": digest({"chamfer": 1.0}), "value": {"chamfer": 1.0}}))  # as the first version wrote it
    killed = cache.root / "tmp" / f".{KEY}.{'0' * 32}.part"
    killed.mkdir()
    (killed / "big").write_bytes(b"0" * 1000)
    (cache.root / "fits" / "mine").mkdir()
    assert cache.read("rows", OTHER) is None
    found = list(prune(cache))
    damaged = "damaged, or of another version"
    assert [(kind, why) for kind, _, why in found] == [("temporary", "left by a run that was killed"), ("fits", damaged), ("rows", damaged)]
    assert found[0][1] == 1000 and left(cache)["fits"] == 1 and (cache.root / "fits" / "mine").exists()  # not ours
    os.utime(fit.path, (time.time() - 3 * DAY,) * 2)
    assert not list(prune(cache, older_than=4))
    assert [(kind, why) for kind, _, why in prune(cache, older_than=2)] == [("fits", "older than 2 days")]


def test_entries_of_scripts_and_of_plug_ins_that_are_not_here_are_kept(cache):
    for module in ("__main__", "no_such_plug_in.method"):
        made = Origin({"code": {"x.py": "1"}, "seed": module}, {"modules": ["twinbench.methods.base", module]})
        cache.write_folder("fits", made.key, lambda folder: None, {}, made.made)
    assert not list(prune(cache)) and len(list(prune(cache, older_than=0))) == 2


@pytest.mark.parametrize("wrong", ["explain rigd", "explain abcdef", "prune --older-than -1", "list --kinds twins"])
def test_wrong_input_is_one_line(folder, capsys, wrong):
    assert command("cache", *wrong.split()) == 2
    assert capsys.readouterr().err.count("\n") == 1


# --- writers that are killed, and writers that race


def test_what_a_killed_writer_left_is_swept_and_what_a_live_one_writes_is_not(tmp_path):
    # a fresh process is killed while it holds a temporary file
    def write(path, ready):
        with replacing(path) as temporary:
            temporary.write_text("half")
            ready.set()
            time.sleep(60)

    context = multiprocessing.get_context("fork")
    ready = context.Event()
    other = context.Process(target=write, args=(tmp_path / "rows.csv", ready))
    other.start()
    try:
        assert ready.wait(30)
        (part,) = tmp_path.iterdir()
        assert sweep(tmp_path) == [] and part.exists()
        with replacing(tmp_path / "rows.csv") as temporary:
            temporary.write_text("whole")
        assert part.exists() and (tmp_path / "rows.csv").read_text() == "whole"
    finally:
        other.kill()
        other.join()
    with replacing(tmp_path / "about.json") as temporary:
        assert not part.exists()
        temporary.write_text("{}")
    assert {file.name for file in tmp_path.iterdir()} == {"rows.csv", "about.json"}


def test_only_temporary_files_are_swept_and_those_without_a_lock_when_they_are_old(tmp_path):
    kept = [".rows.csv.part", "rows.csv." + "0" * 32 + ".part", ".rows.csv." + "0" * 31, ".hidden", f".young.{'0' * 32}"]
    for name in [*kept, f".old.{'1' * 32}"]:
        (tmp_path / name).write_text("")
    os.utime(tmp_path / f".old.{'1' * 32}", (time.time() - 2 * DAY,) * 2)
    (tmp_path / f".link.{'2' * 32}.part").symlink_to(tmp_path / ".hidden")
    assert [path.name for path, _ in sweep(tmp_path)] == [f".old.{'1' * 32}"]
    assert sweep(tmp_path / "none") == []


EVENTS = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.scandir", "shutil.rmtree", "os.listdir", "fcntl.flock"}


def killed_at(count, work):
    """Run ``work`` in a process that kills itself at its ``count``-th event on the file system. Whether it was killed before its end."""
    child = os.fork()
    if not child:
        seen = 0

        def hook(event, arguments):
            nonlocal seen
            if event in EVENTS:
                seen += 1
                if seen == count:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
        try:
            work()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


@pytest.mark.long
@pytest.mark.parametrize("before", ["nothing", "damaged", "sound"])
def test_a_writer_killed_at_any_event_loses_nothing_and_leaves_nothing(tmp_path, before):
    for count in range(1, 200):
        cache = Cache(tmp_path / str(count))
        if before != "nothing":
            put(cache, says="sound")
            cache.write("rows", KEY, {"says": "sound"})
        if before == "damaged":
            (cache.root / "fits" / KEY / "content" / "twin.json").write_text("{")
        killed = killed_at(count, lambda cache=cache: (put(cache, says="new"), cache.write("rows", KEY, {"says": "new"})))
        assert got(cache) in {"nothing": (None, "new"), "damaged": (None, "new"), "sound": ("sound",)}[before]
        row = cache.read("rows", KEY)
        assert row is None if before == "nothing" and row is None else row["says"] in ("sound", "new")
        put(cache, says="new")
        cache.write("rows", KEY, {"says": "new"})
        assert got(cache) == ("sound" if before == "sound" else "new") and cache.read("rows", KEY) == {"says": "new"}
        assert not list((cache.root / "tmp").iterdir()) and len(list(cache.root.rglob("*.json"))) == 3
        if not killed:
            assert count > 10
            return
    raise AssertionError("never came to its end")


def racing(root, start, count, wrong):
    cache = Cache(root)
    start.wait()
    for turn in range(count):
        key = digest("turn", turn)
        try:
            put(cache, key)
            if got(cache, key) != "good":
                raise AssertionError("what was stored cannot be read back")
        except BaseException as error:
            wrong.put(repr(error))


def test_two_runs_may_replace_the_same_damaged_entries(cache):
    count = 60
    for turn in range(count):
        key = digest("turn", turn)
        put(cache, key)
        (cache.root / "fits" / key / "content" / "twin.json").write_text("{")
    context = multiprocessing.get_context("fork")
    start, wrong = context.Barrier(3), context.Queue()
    runs = [context.Process(target=racing, args=(cache.root, start, count, wrong)) for _ in range(3)]
    for one in runs:
        one.start()
    for one in runs:
        one.join(60)
    assert [one.exitcode for one in runs] == [0] * 3 and wrong.empty()
    assert all(got(cache, digest("turn", turn)) == "good" for turn in range(count)) and not list((cache.root / "tmp").iterdir())


def test_a_folder_is_described_by_its_layouts_code(folder, cache, monkeypatch):
    first = open_recordings(str(folder), split="published", cache=cache)
    files = SOURCES.files
    monkeypatch.setattr(SOURCES, "files", lambda *modules: {**files(*modules), "edited.py": "1"})
    assert open_recordings(str(folder), split="published", cache=cache).key != first.key
    assert "datasets/phystwin.py" in files("twinbench.datasets.phystwin_layout") and "static" in methods()
