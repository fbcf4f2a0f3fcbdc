"""Jobs of Slurm: with submitit's local and debug executors, and with programs that answer as Slurm does."""

import os
import subprocess
import sys
import time
from contextlib import closing
from functools import partial
from pathlib import Path

import fake_slurm
import pieces
import pytest
from twinbench.benchmark.executors.slurm import Slurm
from twinbench.benchmark.executors.slurm_jobs import IDS, cancel_orphans
from twinbench.benchmark.executors.slurm_options import SlurmOptions
from waiting import alive, until

submitit = pytest.importorskip("submitit", reason="no submitit here: pip install 'twinbench[cluster]'")
LATE = 30  # s


def results(executor, work, **options):
    return {name: future.exception() or future.result() for name, future in executor.each(work, **options)}


@pytest.fixture
def slurm(tmp_path, monkeypatch):
    """A machine with Slurm's programs; the folder that they are in."""
    programs = tmp_path / "programs"
    programs.mkdir()
    fake_slurm.install(programs)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr("twinbench.benchmark.executors.slurm_jobs.LATE", 0.0)
    monkeypatch.setattr("twinbench.benchmark.executors.slurm_jobs.ASK", 0.5)
    return programs


# --- without Slurm


def test_submitits_debug_executor_does_the_work_in_this_process(tmp_path):
    executor = Slurm(["cluster=debug"], folder=tmp_path / "jobs")
    found = results(executor, {"a": partial(pow, 2, 10), "b": pieces.fails, "c": os.getpid})
    assert found["a"] == 1024 and found["c"] == os.getpid()
    assert isinstance(found["b"], ValueError) and str(found["b"]) == "stiffness must be > 0 [N], got -3.0"
    assert not list((tmp_path / "jobs").iterdir())  # nothing is left


def test_submitits_local_executor_does_the_work_in_other_processes(tmp_path):
    executor = Slurm(["cluster=local"], jobs=2, folder=tmp_path / "jobs")
    found = results(executor, {"who": os.getpid, "where": pieces.place})
    assert found["who"] != os.getpid() and found["where"] == os.getcwd()  # paths mean what they mean here


@pytest.mark.slow
def test_a_process_of_submitits_local_executor_that_is_lost_is_replaced(tmp_path, caplog):
    executor = Slurm(["cluster=local"], jobs=2, folder=tmp_path / "jobs")
    assert results(executor, {"died": partial(pieces.dies_once, tmp_path)}) == {"died": "done"}
    assert "ended without a result" in caplog.text and "its work is done again (2 of 3)" in caplog.text


# --- options


def test_options_are_read():
    asked = SlurmOptions.of(
        ["partition=gpu", "time=1-02:30", "memory=1500M", "cpus=4", "account=a b", "array=100", "setup=module load x=y"]
    )
    assert asked == SlurmOptions("gpu", "a b", time=26 * 60 + 30, memory=1500 / 1024, cpus=4, array=100, setup="module load x=y")
    given = asked.submitit(device="cuda", jobs=8)
    assert given["gpus_per_node"] == 1 and given["slurm_array_parallelism"] == 8 and given["slurm_setup"][-1] == "module load x=y"
    assert "gpus_per_node" not in asked.submitit(device="cpu", jobs=None)


@pytest.mark.parametrize(
    ("said", "minutes"), [("90", 90), ("1:30", 2), ("2:00:00", 120), ("1-12", 2160), ("0-0:10:01", 11), ("0:59", 1)]
)  # as man sbatch has it: minutes, minutes:seconds, hours:minutes:seconds, days-hours, ...; begun minutes count
def test_times_are_those_of_sbatch(said, minutes):
    assert SlurmOptions.of([f"time={said}"]).time == minutes


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["partitoin=gpu"], "unknown key of --slurm 'partitoin'; did you mean 'partition'?"),
        (["partition"], "--slurm must be KEY=VALUE, got 'partition'"),
        (["time=soon"], "--slurm time must be minutes or [DAYS-]HOURS:MINUTES:SECONDS, got 'soon'"),
        (["time=0"], "--slurm time must be at least a minute, got '0'"),
        (["memory=16"], "--slurm memory must be a size as 16G or 4000M, got '16'"),
        (["cpus=0"], "--slurm cpus must be a whole number of at least 1, got '0'"),
        (["cpus=2", "cpus=3"], "--slurm cpus is given twice"),
        (["cluster=slurn"], "unknown cluster of --slurm 'slurn'; did you mean 'slurm'?"),
        (["setup=a\nb"], "--slurm setup must be one line"),
    ],
)
def test_wrong_options_are_refused(given, message):
    with pytest.raises(ValueError) as refused:
        SlurmOptions.of(given)
    assert message in str(refused.value)


def test_a_machine_without_slurm_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ValueError, match="no Slurm here"):
        results(Slurm(folder=tmp_path / "jobs"), {"a": os.getpid})


# --- with Slurm's programs


def test_pieces_are_an_array_of_jobs(slurm, tmp_path):
    executor = Slurm(["partition=short", "time=2:00:00", "memory=2G", "array=2"], jobs=2, folder=tmp_path / "jobs")
    found = results(executor, {k: partial(pow, 2, k) for k in range(3)})
    assert found == {0: 1, 1: 2, 2: 4}
    script = (slurm / "1000.sh").read_text()
    for line in ("--partition=short", "--time=120", "--mem=2GB", "--array=0-1%2", "--cpus-per-task=1"):
        assert f"#SBATCH {line}\n" in script
    assert "export OMP_NUM_THREADS=${OMP_NUM_THREADS:-${SLURM_CPUS_PER_TASK:-1}}" in script
    assert sorted(file.name for file in slurm.glob("*.sh")) == ["1000.sh", "1001.sh"]  # two and one


def test_what_the_cluster_refuses_is_one_line(slurm, tmp_path):
    (slurm / "sbatch").write_text("#!/bin/sh\necho 'sbatch: error: invalid partition specified: shrot' >&2\nexit 1\n")
    with pytest.raises(OSError, match=r"^the cluster refuses the jobs: .*invalid partition specified: shrot"):
        results(Slurm(["partition=shrot"], folder=tmp_path / "jobs"), {"a": os.getpid}, writes=[tmp_path])
    assert not list((tmp_path / "jobs").iterdir())


@pytest.mark.slow
def test_a_lost_job_is_done_again(slurm, tmp_path, caplog):
    found = results(Slurm(folder=tmp_path / "jobs"), {"died": partial(pieces.dies_once, tmp_path), "b": partial(pow, 2, 2)})
    assert found == {"died": "done", "b": 4} and "done again (2 of 3)" in caplog.text


@pytest.mark.slow
def test_who_stops_cancels_all_jobs_at_once(slurm, tmp_path):
    (tmp_path / "begun").mkdir()
    work = {f"p{k}": partial(pieces.waits, tmp_path / "begun", f"p{k}", seconds=600) for k in range(2)}
    work["quick"] = os.getpid
    with closing(Slurm(folder=tmp_path / "jobs").each(work)) as finished:
        assert next(finished)[0] == "quick"
        until(lambda: len(pieces.begun(tmp_path / "begun")) == 2, LATE)
        stopped = time.monotonic()
    assert time.monotonic() - stopped < 2
    until(lambda: not [process for _, process, _ in pieces.begun(tmp_path / "begun") if alive(process)], LATE)


PROGRAM = """
import sys
from functools import partial
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import pieces
from twinbench.benchmark.executors.slurm import Slurm
list(Slurm(folder=sys.argv[2]).each({"a": partial(pieces.waits, sys.argv[3], "a", seconds=600)}))
"""


@pytest.mark.slow
def test_the_jobs_of_a_command_that_was_killed_are_cancelled_by_the_next(slurm, tmp_path):
    (tmp_path / "begun").mkdir()
    arguments = [str(Path(pieces.__file__).parent), str(tmp_path / "jobs"), str(tmp_path / "begun")]
    command = subprocess.Popen([sys.executable, "-c", PROGRAM, *arguments])
    until(lambda: pieces.begun(tmp_path / "begun"), LATE)
    assert cancel_orphans(tmp_path / "jobs") == 0  # it lives
    command.kill()
    command.wait()
    ((_, process, _),) = pieces.begun(tmp_path / "begun")
    assert alive(process) and len(list((tmp_path / "jobs").glob(f".*/{IDS}"))) == 1
    assert results(Slurm(["cluster=debug"], folder=tmp_path / "jobs"), {"b": os.getpid}) == {"b": os.getpid()}
    until(lambda: not alive(process), LATE)
    assert not list((tmp_path / "jobs").iterdir())
