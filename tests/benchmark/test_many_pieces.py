"""Commands whose pieces go to a cluster, with an executor that does them in this process: many diagnoses, and a sealed challenge."""

import json
from pathlib import Path

import pytest
from challenges import FAKES, TINY, filmed, with_fakes, without_simulators
from numpy.random import default_rng
from twinbench.benchmark.cli import main
from twinbench.benchmark.diagnosing import recordings_of
from twinbench.benchmark.executors.slurm import Slurm
from twinbench.datasets.concealed.make import make
from twinbench.datasets.phystwin import write_case
from twinbench.diagnosis import diagnose as module

pytest.importorskip("submitit", reason="no submitit here: pip install 'twinbench[cluster]'")
CLUSTER = ["--executor", "slurm", "--slurm", "cluster=debug"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def things(tmp_path):
    """A folder of two recordings, and one beside it."""
    for k, place in enumerate(("things/lift", "things/push", "alone")):
        write_case(tmp_path / place, filmed("x", default_rng(k)))
    return tmp_path


@pytest.fixture
def asked(monkeypatch):
    """The recordings that are diagnosed, by a diagnosis that costs nothing; that of "push" fails."""
    found = []

    class Found:
        def __init__(self, name):
            self.result = {"verdict": "missing", "effect": "wind", "case": name}

        def write(self, folder):
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "diagnosis.json").write_text(json.dumps(self.result))

    def diagnose(scenario, **options):
        found.append((scenario.name, options["preset"]))
        if scenario.name == "push":
            raise RuntimeError("no time left")
        return Found(scenario.name)

    monkeypatch.setattr(module, "diagnose", diagnose)
    return found


def test_every_recording_is_diagnosed_by_itself_and_what_is_there_is_kept(things, asked, capsys):
    assert main(["diagnose", "things", "alone", "--each", *CLUSTER, "--out", "o", "--quiet"]) == 1
    said = capsys.readouterr().out.splitlines()
    assert sorted(said[:3])[0].startswith("alone: The twin leaves out ") and "push: failed (RuntimeError: no time left)" in said
    assert said[3] == "Written to o: 2 of 3 diagnoses, NAME/diagnosis.json each"
    assert json.loads(Path("o/lift/diagnosis.json").read_text())["case"] == "lift" and sorted(asked)[0] == ("alone", "quick")
    del asked[:]
    assert main(["diagnose", "things", "alone", "--each", *CLUSTER, "--out", "o", "--quiet"]) == 1
    assert asked == [("push", "quick")]  # what failed is tried again
    del asked[:]
    main(["diagnose", "things/lift", "--each", *CLUSTER, "--out", "o", "--quiet", "--preset", "full"])
    assert asked == [("lift", "full")]  # other options, another diagnosis
    del asked[:]
    assert main(["diagnose", "--config", "o/alone/config.toml", "--each", *CLUSTER, "--out", "p", "--quiet"]) == 0
    assert asked == [("alone", "quick")]


def test_recordings_are_found_by_name(things):
    assert recordings_of(["things", "alone"]) == {"lift": "things/lift", "push": "things/push", "alone": "alone"}
    assert recordings_of(["sample"]) == {name: f"sample/{name}" for name in ("plush_drag", "plush_lift")}
    with pytest.raises(ValueError, match=r"two recordings are called 'lift': things/lift and .*lift; diagnose them into two folders"):
        recordings_of(["things", str(things / "things" / "lift")])
    with pytest.raises(ValueError, match="no recording at nowhere"):
        recordings_of(["nowhere"])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--each", "--transfer", "alone"], "--transfer belongs to one diagnosis; --each makes one of every recording"),
        (["--jobs", "2"], "--jobs needs --each: one diagnosis is the work of one process"),
        (CLUSTER, "--executor slurm needs --each: one diagnosis is the work of one process"),
        (["--each", "--jobs", "0"], "--jobs must be at least 1, got 0"),
    ],
)
def test_what_does_not_go_together_is_said(things, asked, options, message, capsys):
    assert main(["diagnose", "alone", *options]) == 2
    assert capsys.readouterr().err == f"twinbench: {message}\n" and not asked


def test_a_challenge_is_the_same_whoever_makes_and_answers_it(tmp_path, monkeypatch, capsys):
    with_fakes(monkeypatch, {"guess": FAKES["guess"]})
    without_simulators(monkeypatch)
    for name, executor in (("here", None), ("there", Slurm(["cluster=debug"]))):
        make(tmp_path / name, preset=TINY, seed="s", engines=("mujoco",), executor=executor)
    here, there = (json.loads(Path(name, "manifest.json").read_text()) for name in ("here", "there"))
    assert here == there and len(here["cases"]) > 5
    for name, how in (("here", []), ("there", CLUSTER)):
        assert main(["challenge", "answer", name, "--entrants", "guess", *how]) == 0
    sealed = [json.loads(Path(name, "answers/guess/sealed.json").read_text()) for name in ("here", "there")]
    assert set(sealed[0]["answers"]) == set(sealed[1]["answers"]) == set(here["cases"])
    assert not list(Path("there").glob(".*"))  # nothing is left in what is handed out


def test_the_command_hands_its_executor_to_who_makes(tmp_path, monkeypatch):
    asked = {}

    def make(out, **options):
        asked.update(options)
        raise ValueError("enough")

    monkeypatch.setattr("twinbench.datasets.concealed.make.make", make)
    assert main(["challenge", "make", "--out", "set", "--seed", "s", *CLUSTER, "--jobs", "3"]) == 2
    assert isinstance(asked["executor"], Slurm) and asked["executor"].jobs == 3
    assert main(["challenge", "make", "--out", "set", "--seed", "s"]) == 2
    assert asked["executor"] is None and asked["jobs"] == 1
