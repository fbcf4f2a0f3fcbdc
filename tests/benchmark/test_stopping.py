"""Ctrl-C and SIGTERM: a command ends within two seconds, with its processes and without a traceback, whatever it computes."""

import os
import signal
import subprocess
import sys
import time

import pytest

# one step of native code that takes minutes and cannot be interrupted: Python hears of no signal before it is over
BUSY = "__import__('hashlib').pbkdf2_hmac('sha256', b'', b'', 2**31 - 1)"
PROGRAM = """
import os, sys
from twinbench.benchmark import cli
from twinbench.benchmark.processes import workers

def alone(arguments, stop):
    print("ready", flush=True)
    BUSY

def anew(arguments, stop):
    stop.goes_on = False
    alone(arguments, stop)

def spread(arguments, stop):
    with workers(2) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        for future in [pool.submit(eval, "BUSY") for _ in range(2)]:
            future.result()

cli._run = COMMAND
if __name__ == "__main__":
    sys.exit(cli.main([]))
""".replace("BUSY", BUSY)
ALONE, ANEW, SPREAD = (PROGRAM.replace("COMMAND", command) for command in ("alone", "anew", "spread"))


def left(session):
    """Processes of a session that are alive."""
    found = []
    for entry in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{entry}/stat") as file:
                state, *rest = file.read().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if rest[2] == str(session) and state != "Z":
            found.append(int(entry))
    return found


def stopped(tmp_path, source, number, send=os.killpg):
    """Exit code, standard error, and seconds until no process is left, of a program that is sent a signal while it computes."""
    file = tmp_path / "program.py"
    file.write_text(source)
    started = subprocess.Popen(
        [sys.executable, str(file)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=tmp_path
    )
    assert started.stdout.readline()
    time.sleep(0.3)  # it is in the middle of its work
    began = time.monotonic()
    send(started.pid, number)
    code = started.wait(timeout=30)
    while left(started.pid) and time.monotonic() - began < 30:
        time.sleep(0.02)
    return code, started.stderr.read(), time.monotonic() - began


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="processes are counted in /proc")
@pytest.mark.parametrize(
    ("source", "number", "send", "next"),
    [
        (ALONE, signal.SIGINT, os.killpg, "goes on from here"),
        (ANEW, signal.SIGINT, os.killpg, "begins anew"),
        (SPREAD, signal.SIGINT, os.killpg, "goes on from here"),
        (SPREAD, signal.SIGTERM, os.kill, "goes on from here"),
    ],
    ids=["native code", "native code, nothing kept", "processes, Ctrl-C", "processes, SIGTERM"],
)
def test_a_command_ends_with_its_processes_and_without_a_traceback(tmp_path, source, number, send, next):
    code, err, seconds = stopped(tmp_path, source, number, send)
    assert code == 128 + number and seconds < 2
    assert err == f"twinbench: stopped; the same command {next}\n"


@pytest.mark.parametrize(("options", "goes_on"), [([], False), (["--each"], True)])
def test_one_diagnosis_keeps_nothing_before_its_end(monkeypatch, capfd, options, goes_on):
    from twinbench.benchmark.cli import main
    from twinbench.benchmark.commands.diagnose import Diagnose

    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(Diagnose, "__call__", interrupted)
    assert main(["diagnose", "sample/plush_lift", *options]) == 130
    assert ("goes on from here" in capfd.readouterr().err) == goes_on


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="processes are counted in /proc")
def test_processes_end_with_whoever_started_them(tmp_path):
    code, _, seconds = stopped(tmp_path, SPREAD, signal.SIGKILL, os.kill)
    assert code == -signal.SIGKILL and seconds < 2


def test_a_process_that_is_ended_by_somebody_else_is_an_error_with_a_reason():
    from twinbench.benchmark.processes import workers

    with pytest.raises(OSError, match="was ended from outside"), workers(1) as pool:
        pool.submit(signal.raise_signal, signal.SIGKILL).result()


def test_signals_are_nobodys_business_after_a_command():
    from twinbench.benchmark.cli import main

    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    assert main(["--version"]) == 0
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_processes_share_the_cores(monkeypatch):
    from twinbench.benchmark import processes

    monkeypatch.setattr(processes, "cores", lambda: 6)
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with processes.workers(2) as pool:
        given = [pool.submit(os.getenv, name).result() for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")]
    assert given == ["2", "3"]  # six cores for two processes; who asks for fewer gets fewer
    assert os.environ["OMP_NUM_THREADS"] == "2" and "MKL_NUM_THREADS" not in os.environ


def test_threads_are_the_cores_or_fewer_where_the_environment_says_so(monkeypatch):
    from twinbench.physics import cores

    monkeypatch.setattr(cores, "cores", lambda: 6)
    for asked, given in (("2", 2), ("64", 6), ("", 6), ("0", 6), ("many", 6)):
        monkeypatch.setenv("OMP_NUM_THREADS", asked)
        assert cores.threads() == given
