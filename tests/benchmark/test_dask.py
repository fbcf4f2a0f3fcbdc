"""Workers of dask on loopback: a scheduler and two workers, one of which is killed in the middle of its work."""

import os
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial

import pieces
import pytest
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.executors.card import claimed
from twinbench.benchmark.executors.dask_workers import DaskWorkers
from twinbench.benchmark.opening import open_recordings
from twinbench.benchmark.plan import plan
from twinbench.benchmark.runner import Runner, Settings
from twinbench.benchmark.spread import spread
from twinbench.methods.registry import methods
from twinbench.metrics.base import metrics
from waiting import alive, until

pytest.importorskip("distributed", reason="no dask.distributed here: pip install 'twinbench[cluster]'")
pytestmark = pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="asks Linux which processes there are")
LATE = 60  # s
TIMES = ("fit_seconds", "rollout_seconds", "peak_memory_mib", "peak_device_memory_mib", "date")


@contextmanager
def cluster(folder, workers):
    """The address of a scheduler with so many workers; their processes, and its own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    program = [sys.executable, "-m", "distributed.cli.dask_{}", "--host", "127.0.0.1", "--no-dashboard"]
    first, last = program[:2], program[3:]
    started = [subprocess.Popen([*first, "distributed.cli.dask_scheduler", *last, "--port", address.rpartition(":")[2]], **quiet)]
    worker = [*first, "distributed.cli.dask_worker", address, *last, "--nthreads", "1", "--no-nanny", "--local-directory", str(folder)]
    started += [subprocess.Popen(worker, **quiet) for _ in range(workers)]
    try:
        yield address, started[1:], started[0]
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    with cluster(tmp_path_factory.mktemp("dask"), 2) as found:
        yield found


def settings(*names):
    return Settings({name: methods()[name] for name in names}, {"track_error": metrics()["track_error"]})


@pytest.mark.long
def test_a_killed_workers_piece_is_done_again_and_rows_are_those_of_one_process(two, tmp_path):
    address, workers, _ = two
    (tmp_path / "begun").mkdir()
    work = {name: partial(pieces.waits, tmp_path / "begun", name, until=str(tmp_path / "go")) for name in "abcd"}
    executor = DaskWorkers(address)
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(lambda: {k: future.result() for k, future in executor.each(work, reads=[tmp_path], writes=[tmp_path])})
        until(lambda: len(pieces.begun(tmp_path / "begun")) == 2, LATE)  # each worker has one in hand, and others wait
        lost, child, parent = pieces.begun(tmp_path / "begun")[0]
        killed = next(worker for worker in workers if worker.pid == parent)
        killed.kill()
        until(lambda: not alive(child), LATE)  # which ends with its worker
        (tmp_path / "go").touch()
        found = asked.result(LATE)
    assert found == {name: name for name in "abcd"}
    assert sorted(name for name, *_ in pieces.begun(tmp_path / "begun")) == sorted([*"abcd", lost])  # one was begun twice

    common, cache = settings("rigid"), Cache(tmp_path / "one")
    opened = open_recordings("sample", split="published", cache=cache)
    fits = plan(opened.collection, methods=common.methods, scenarios=opened.collection.in_domain[:1])
    alone = Runner(opened, common, cache).run(fits)
    told = []
    there = spread(opened, common, Cache(tmp_path / "two"), fits, executor=executor, progress=lambda _, done: told.append(done))
    plain = [[{k: v for k, v in row.items() if k not in TIMES} for row in rows] for rows in (alone, there)]
    assert plain[0] == plain[1] and told == sorted(told) and told[-1] == 1
    nobody = DaskWorkers("tcp://127.0.0.1:9")  # what is in the cache is no work
    assert spread(opened, common, Cache(tmp_path / "two"), fits, executor=nobody) == there


def test_what_a_piece_raises_comes_back_and_a_process_that_is_killed_is_replaced(two, tmp_path, caplog):
    work = {"a": pieces.fails, "b": partial(pieces.dies_once, tmp_path), "c": pieces.place}
    found = {name: future.exception() or future.result() for name, future in DaskWorkers(two[0], jobs=1).each(work)}
    assert isinstance(found["a"], ValueError) and str(found["a"]) == "stiffness must be > 0 [N], got -3.0"
    assert found["b"] == "done" and found["c"] == os.getcwd()  # paths mean what they mean here
    assert "was ended from outside (out of memory?): its work is done again (2 of 3)" in caplog.text


def test_who_stops_ends_what_runs(two, tmp_path):
    with closing(DaskWorkers(two[0]).each({"a": os.getpid, "b": partial(pieces.waits, tmp_path, "b", seconds=600)})) as finished:
        assert next(finished)[0] == "a"
        until(lambda: pieces.begun(tmp_path), LATE)
        stopped = time.monotonic()
    assert time.monotonic() - stopped < 2
    until(lambda: not alive(pieces.begun(tmp_path)[0][1]), LATE)


PROGRAM = """
import sys
from functools import partial
sys.path.insert(0, sys.argv[1])
import pieces
from twinbench.benchmark.executors.dask_workers import DaskWorkers
list(DaskWorkers(sys.argv[2]).each({"a": partial(pieces.waits, sys.argv[3], "a", seconds=600)}))
"""


@pytest.mark.slow
def test_workers_stop_where_the_command_is_killed(two, tmp_path):
    arguments = [os.path.dirname(pieces.__file__), two[0], str(tmp_path)]
    command = subprocess.Popen([sys.executable, "-c", PROGRAM, *arguments])
    until(lambda: pieces.begun(tmp_path), LATE)
    command.send_signal(signal.SIGKILL)
    command.wait()
    until(lambda: not alive(pieces.begun(tmp_path)[0][1]), LATE)


@pytest.mark.slow
def test_a_scheduler_that_goes_is_one_sentence(tmp_path):
    (tmp_path / "begun").mkdir()
    with cluster(tmp_path, 1) as (address, _, scheduler):
        work = {"a": partial(pieces.waits, tmp_path / "begun", "a", seconds=600)}
        with ThreadPoolExecutor(1) as pool:
            asked = pool.submit(lambda: list(DaskWorkers(address).each(work, writes=[tmp_path])))
            until(lambda: pieces.begun(tmp_path / "begun"), LATE)
            scheduler.kill()
            with pytest.raises(OSError, match=r"^the scheduler at tcp://127\.0\.0\.1:\d+ is gone"):
                asked.result(LATE)
        until(lambda: not alive(pieces.begun(tmp_path / "begun")[0][1]), LATE)


def test_a_path_that_workers_do_not_see_is_named(two, tmp_path):
    with pytest.raises(ValueError, match=r"does not see .*/nowhere: workers need the file system of the command"):
        list(DaskWorkers(two[0]).each({"a": os.getpid}, reads=[tmp_path / "nowhere"]))


def test_no_scheduler_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr("twinbench.benchmark.executors.dask_workers.CONNECT", 0.5)
    with pytest.raises(OSError, match=r"^--scheduler tcp://127\.0\.0\.1:9: no scheduler of dask answers there"):
        list(DaskWorkers("tcp://127.0.0.1:9").each({"a": os.getpid}, writes=[tmp_path]))


def test_a_card_has_one_piece_at_a_time():
    # two claims of two cards get one each; a third waits until one is given back
    with claimed(["test-7", "test-8"]) as one:
        with claimed(["test-7", "test-8"]) as other:
            assert {one, other} == {"test-7", "test-8"}
        with claimed(["test-7", "test-8"]) as again:
            assert again == other
    with claimed([]) as none:
        assert none == ""
