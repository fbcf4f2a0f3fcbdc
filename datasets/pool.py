"""Worker processes that end with whoever asked for them: at once where that one is stopped, and also where it is killed."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from threading import Thread

__all__ = ["Pool", "finished"]

ENDED = "a worker process was ended from outside (out of memory?); the same command goes on from here, with fewer --jobs if need be"


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
            raise OSError(ENDED) from error
        return super().__exit__(kind, error, trace)


def finished(pool, work: Mapping[Hashable, Callable[[], object]]) -> Iterator[tuple[Hashable, Future]]:
    """The names of pieces of ``work``, each with its future, as ``pool`` is done with them.

    A piece whose process was ended from outside has failed with an OSError that says so.
    """
    running = {pool.submit(piece): name for name, piece in work.items()}
    for future in as_completed(running):
        yield running[future], _lost() if isinstance(future.exception(), BrokenProcessPool) else future


def _lost() -> Future:
    future: Future = Future()
    future.set_exception(OSError(ENDED))
    return future


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
    parent = multiprocessing.parent_process()
    assert parent is not None  # this runs in a child
    wait([parent.sentinel])
    os._exit(1)
