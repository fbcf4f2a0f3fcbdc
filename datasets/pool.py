"""Worker processes that end with whoever asked for them: at once where that one is stopped, and also where it is killed."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from threading import Thread

__all__ = ["Pool"]


class Pool(ProcessPoolExecutor):
    """``count`` fresh processes; ``begin(*given)``, if any, is called in each before its work.

    Whatever ends the ``with`` block but its own end (Ctrl-C, an error) kills them: what they were at is not waited for. Ctrl-C is for this
    process alone. Where this process is killed, they end by themselves.
    Raises OSError where one of them was ended from outside, as systems do that run out of memory.
    """

    def __init__(self, count: int, begin: Callable | None = None, *given):
        super().__init__(count, mp_context=multiprocessing.get_context("spawn"), initializer=_begin, initargs=(begin, *given))

    def submit(self, *given, **named):
        with _deaf():
            return super().submit(*given, **named)

    def __exit__(self, kind, error, trace):
        if kind is not None:
            for process in list((self._processes or {}).values()):
                process.kill()
            self.shutdown(cancel_futures=True)
        if isinstance(error, BrokenProcessPool):
            said = "a worker process was ended from outside (out of memory?); the same command goes on from here"
            raise OSError(f"{said}, with fewer --jobs if need be") from error
        return super().__exit__(kind, error, trace)


@contextmanager
def _deaf() -> Iterator[None]:
    """What is started in here never hears of Ctrl-C or SIGTERM, not even while it imports; what comes meanwhile is heard afterwards."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(begin, *given):
    Thread(target=_follow, daemon=True).start()
    if begin is not None:
        begin(*given)


def _follow():
    wait([multiprocessing.parent_process().sentinel])
    os._exit(1)
