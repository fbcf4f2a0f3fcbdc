"""Worker processes end with whoever asked for them, however that one ends."""

import os
import signal
import subprocess
import sys
import time

import pytest
from twinbench.datasets.pool import Pool
from waiting import alive

FOREVER = 600  # s that workers would take; whatever is over in a tenth of that did not wait for them
LATE = 60
PROGRAM = f"""
import os, time
from twinbench.datasets.pool import Pool
with Pool(2) as pool:
    running = [pool.submit(time.sleep, {FOREVER}) for _ in range(3)]
    print(*pool._processes, flush=True)
    running[0].result()
"""


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="asks Linux which processes there are")
@pytest.mark.parametrize("how", ["SIGINT to all", "SIGINT", "SIGTERM", "SIGKILL"])
def test_workers_end_with_who_asked_for_them(how):
    begun = time.monotonic()
    plain = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731, as a terminal starts programs
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=plain
    )
    try:
        workers = {int(word) for word in program.stdout.readline().split()}
        assert len(workers) == 2
        (os.killpg if how.endswith("all") else os.kill)(program.pid, getattr(signal, how.split()[0]))
        said = program.communicate(timeout=LATE)[1]
        while any(map(alive, workers)):
            assert time.monotonic() - begun < LATE
            time.sleep(0.05)
    finally:
        program.kill()
    assert program.returncode != 0
    assert said.count("Traceback") == (1 if "INT" in how else 0)  # that of the program itself, which does not catch Ctrl-C


def test_an_error_does_not_wait_for_what_runs():
    begun = time.monotonic()
    with pytest.raises(ZeroDivisionError), Pool(1) as pool:
        pool.submit(time.sleep, FOREVER)
        raise ZeroDivisionError
    assert time.monotonic() - begun < LATE


def test_a_worker_that_is_killed_is_one_sentence():
    with pytest.raises(OSError, match="a worker process was ended from outside"), Pool(1) as pool:
        os.kill(pool.submit(os.getpid).result(), signal.SIGKILL)
        pool.submit(time.sleep, FOREVER).result()
