"""A process of the sealed challenge may be killed at any moment: the same command then goes on, and ends where it would have ended."""

import os
import shutil
import sys
from functools import partial

import pytest
from challenges import FAKES, Guess, with_fakes, without_simulators
from twinbench.benchmark.challenge import scores
from twinbench.benchmark.challenge.answering import answer_set, take_answers
from twinbench.benchmark.challenge.history import history
from twinbench.benchmark.challenge.opening import open_set, opened_labels
from twinbench.benchmark.challenge.packing import pack, unpack
from twinbench.benchmark.challenge.scoring import score_set, write_scores
from twinbench.datasets.concealed.folder import Folder
from twinbench.datasets.concealed.make import make
from twinbench.datasets.concealed.plan import Preset
from twinbench.datasets.concealed.seal import folder_digest, read_json, write_json

PAIR = Preset(controls=1, levels=(1.0,), outside=0, pairs=0, effects=1)
CHANGES = (
    *("open", "os.chmod", "os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.truncate", "os.utime", "shutil.rmtree"),
    "tempfile.mkdtemp",
)
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
KILLED = 77  # exit status of who was killed

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a copy of this process")


class Quick(Guess):
    """Another that answers by itself."""

    name = "quick"


def cheaply(monkeypatch):
    without_simulators(monkeypatch)
    with_fakes(monkeypatch, {"guess": FAKES["guess"], "quick": Quick()})
    monkeypatch.setattr(scores, "bootstrap", lambda *a, **k: (0.0, 1.0))  # intervals are not what is looked at here


@pytest.fixture(autouse=True)
def fakes(monkeypatch):
    cheaply(monkeypatch)


def killed(command, root, at: int) -> bool:
    """Run ``command(root)`` in a copy of this process that dies before its change ``at`` of the file system; whether it came to that."""
    child = os.fork()
    if child == 0:
        left = [at]

        def watch(event, details):
            if event in CHANGES and not (event == "open" and not (details[2] or 0) & WRITES):
                left[0] -= 1
                if left[0] < 0:
                    os._exit(KILLED)

        sys.addaudithook(watch)
        try:
            command(root)
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == KILLED


def whole(root):
    """All files below, and none of them left half-written."""
    names = sorted(p.relative_to(root).as_posix() for p in root.rglob("*"))
    assert not [n for n in names if ".partial" in n or n.split("/")[-1].startswith(".")]
    return names


def made(root):
    make(root, preset=PAIR, seed="x", engines=("mujoco",))


def answered(root):
    answer_set(root, names=("guess", "quick"))


def sealed(root):
    """The answers of another program."""
    for case in Folder(root).published()["cases"]:
        write_json(root.parent / "own" / f"{case}.json", {"verdict": "unknown"})
    take_answers(root, name="mine", source=root.parent / "own")


def opened(root):
    open_set(root)


def scored(root):
    folder = Folder(root)
    found = history(folder)
    write_scores(score_set(root), found, root / "score")


STEPS = {"make": made, "answer": answered, "take": sealed, "open": opened, "score": scored}


@pytest.fixture(scope="module")
def stages(tmp_path_factory):
    """The folder of the set before each step, and after the last."""
    with pytest.MonkeyPatch.context() as patch:
        cheaply(patch)
        root, kept = tmp_path_factory.mktemp("stages"), {}
        (root / "set").mkdir()
        for name, step in STEPS.items():
            kept[name] = shutil.copytree(root / "set", root / name)
            step(root / "set")
    return kept | {"end": root / "set"}


def campaign(stages, step, tmp_path, stride):
    """Kill ``step`` before every ``stride``-th change of a file, do it again, and go on to the end. Returns how many kills there were."""
    names = list(STEPS)
    at, kills = 0, 0
    while True:
        root = shutil.copytree(stages[step], tmp_path / str(at) / "set")
        if not killed(STEPS[step], root, at):
            return kills
        kills += 1
        for later in names[names.index(step) :]:
            STEPS[later](root)
        check(Folder(root), Folder(stages["end"]), step)
        shutil.rmtree(root.parent)
        at += stride


def check(folder, undisturbed, step):
    assert folder.published() == undisturbed.published()
    assert folder_digest(folder.cases) == folder_digest(undisturbed.cases) and folder_digest(folder.kept) == folder_digest(undisturbed.kept)
    events = [e["event"] for e in folder.ledger.read()]
    assert events[0] == "made" and events.count("made") == 1 and events.count("answered") == 3
    assert events.count("opened") == 1 or step == "open"  # an opening that was begun was an opening
    assert opened_labels(folder) == opened_labels(undisturbed)
    status = {name: found[0] for name, found in score_set(folder.root).items()}
    assert {name: s["status"] for name, s in status.items()} == dict.fromkeys(("guess", "mine", "quick"), "confirmatory")
    assert read_json(folder.root / "score" / "score.json")["entrants"]["guess"]["standing"] == status["guess"]
    if step != "score":  # tables are written by way of a name of their own
        assert whole(folder.root) == whole(undisturbed.root)


@pytest.mark.parametrize(("step", "stride"), [("make", 11), ("answer", 3), ("take", 2), ("open", 1), ("score", 2)])
def test_the_same_command_goes_on(stages, step, stride, tmp_path):
    assert campaign(stages, step, tmp_path, stride) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("step", STEPS)
def test_the_same_command_goes_on_from_every_change(stages, step, tmp_path):
    assert campaign(stages, step, tmp_path, 1) >= 3


@pytest.mark.parametrize("step", ["make", "answer", "take", "open"])
def test_a_line_that_was_cut_anywhere_is_written_again(stages, step, tmp_path):
    """The ledger's last line, as much of it as had been written; the newline comes last."""
    names = list(STEPS)
    after = names[names.index(step) + 1]
    lines = (stages[after] / "ledger.jsonl").read_bytes().splitlines(keepends=True)
    for length in {0, 1, 2, 30, len(lines[-1]) // 2, len(lines[-1]) - 2, len(lines[-1]) - 1}:
        root = shutil.copytree(stages[after], tmp_path / str(length) / "set")
        (root / "ledger.jsonl").write_bytes(b"".join(lines[:-1]) + lines[-1][:length])
        if step == "open":
            shutil.rmtree(root / "opened")  # labels come out after the line
        for later in names[names.index(step) :]:
            STEPS[later](root)
        check(Folder(root), Folder(stages["end"]), step)


def test_two_at_a_time_leave_one_chain(stages, tmp_path):
    root = shutil.copytree(stages["answer"], tmp_path / "set")
    ledger, children = Folder(root).ledger, []
    for k in range(4):
        child = os.fork()
        if child == 0:
            try:
                for _ in range(5):
                    ledger.append("answered", rival=f"writer{k}", root="0" * 64, answers=0)
            finally:
                os._exit(0)
        children.append(child)
    for child in children:
        assert os.waitpid(child, 0)[1] == 0
    assert len(ledger.read()) == 21  # the chain holds, and nobody's line is lost


@pytest.mark.long
@pytest.mark.parametrize("to", ["entrant", "keeper"])
def test_unpacking_goes_on_too(stages, to, tmp_path):
    archive, _ = pack(stages["answer"], to, tmp_path / "part.zip")
    unpack(archive, tmp_path / "all")
    at = 0
    while killed(partial(unpack, archive), tmp_path / str(at), at):
        unpack(archive, tmp_path / str(at))
        assert whole(tmp_path / str(at)) == whole(tmp_path / "all")
        at += 1
    assert at >= 3
