"""A process for the work of a dask worker: unlike the worker's threads it can be stopped, and it has its share of threads and one card.

It ends with the worker, however that ends, and when it has had nothing to do for long.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection

from .piece import perform

__all__ = ["ChildEnded", "in_child"]

IDLE = 300.0  # s without work after which a process ends, and gives its memory back
POLL = 0.1  # s between two questions whether its work is still wanted


class ChildEnded(Exception):
    """The process was ended from outside, as by a system that runs out of memory, or its work is not wanted any more."""


def in_child(packed: bytes, environment: Mapping[str, str], wanted: Callable[[], bool]) -> bytes:
    """What ``perform(packed)`` returns in another process with ``environment``; a process that has done its work waits for the next.

    Raises ChildEnded where it was ended, or where ``wanted()`` became false, which ends it.
    """
    key = tuple(sorted(environment.items()))
    child = _idle(key) or _Child(environment)
    done = False
    try:
        outcome = child.do(packed, wanted)
        done = True
    finally:
        if done:
            with _LOCK:
                _WAITING.setdefault(key, []).append(child)
        else:
            child.end()
    return outcome


class _Child:
    """A process, with ``environment`` added to that of this one."""

    def __init__(self, environment: Mapping[str, str]):
        ours, theirs = socket.socketpair()
        self._connection = Connection(ours.detach())
        env = {**os.environ, **environment, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [sys.executable, "-m", __name__, str(theirs.fileno())]
        # its standard input ends when this process does
        self._process = subprocess.Popen(command, pass_fds=(theirs.fileno(),), stdin=subprocess.PIPE, stdout=2, env=env)
        theirs.close()

    def do(self, packed: bytes, wanted: Callable[[], bool]) -> bytes:
        try:
            self._connection.send_bytes(packed)
            while not self._connection.poll(POLL):
                if not wanted():
                    raise ChildEnded("the work is not wanted any more")
            return self._connection.recv_bytes()
        except (EOFError, OSError) as error:
            raise ChildEnded("the process was ended from outside (out of memory?)") from error

    @property
    def lives(self) -> bool:
        return self._process.poll() is None

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        self._connection.close()
        if self._process.stdin is not None:
            self._process.stdin.close()


_WAITING: dict[tuple, list[_Child]] = {}
_LOCK = threading.Lock()


def _idle(key: tuple) -> _Child | None:
    """A process with this environment that waits for work."""
    with _LOCK:
        waiting = _WAITING.get(key, [])
        while waiting:
            if (child := waiting.pop()).lives:
                return child
            child.end()
    return None


def _main() -> None:
    connection = Connection(int(sys.argv[1]))
    threading.Thread(target=_follow, daemon=True).start()
    with suppress(EOFError, OSError):
        while connection.poll(IDLE):
            connection.send_bytes(perform(connection.recv_bytes()))


def _follow() -> None:
    """End with whoever started this process."""
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    _main()
