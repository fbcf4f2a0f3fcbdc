"""Fresh processes that share out the work: each has its part of the cores and, on graphics cards, sees one card only.

They end with the process that started them, however that ends. Ctrl-C and SIGTERM reach none of them: whoever started them is told, and
decides.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

__all__ = ["cards", "cores", "end_children", "workers"]

VISIBLE = "CUDA_VISIBLE_DEVICES"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # what numerical libraries read when they are loaded


def cards(device: str = "cuda") -> tuple[str, ...]:
    """What ``CUDA_VISIBLE_DEVICES`` calls the graphics cards that this process sees; none where ``device`` is not "cuda"."""
    if device != "cuda":
        return ()
    import torch

    count = torch.cuda.device_count()
    named = [name.strip() for name in os.environ.get(VISIBLE, "").split(",") if name.strip()]
    return tuple(named[:count] if named else map(str, range(count)))


def cores() -> int:
    """How many processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def workers(count: int, devices: Sequence[str] = ()) -> Iterator[ProcessPoolExecutor]:
    """A pool of ``count`` fresh processes; each takes the next of ``devices``, and the first again after the last, for its only card.

    What a process runs may use as many threads as it has cores to itself. When the block ends by an error, what runs is finished and what
    waits is dropped; when it is told to stop (KeyboardInterrupt and the like), the processes are ended at once. Raises OSError where a
    process was ended by somebody else.
    """
    context = multiprocessing.get_context("spawn")
    turns = context.Queue() if devices else None
    for k in range(count if devices else 0):
        turns.put(devices[k % len(devices)])
    pool = _Pool(count, mp_context=context, initializer=_begin, initargs=(turns,))
    try:
        yield pool
    except BaseException as error:
        if not isinstance(error, Exception):
            end_children()
        pool.shutdown(cancel_futures=True)
        if isinstance(error, BrokenProcessPool):
            said = "one of the processes was ended from outside, most likely for want of memory; the same command goes on from here"
            raise OSError(f"{said}, with fewer --jobs if need be") from error
        raise
    pool.shutdown()


def end_children() -> None:
    """End all processes that this one has started through ``multiprocessing``, at once."""
    for child in multiprocessing.active_children():
        child.kill()


class _Pool(ProcessPoolExecutor):
    """A pool whose processes are started, when work is submitted, with signals held back and with their share of threads."""

    def submit(self, function, /, *arguments, **options):
        with _held_back(), _share(self._max_workers):
            return super().submit(function, *arguments, **options)


@contextmanager
def _held_back() -> Iterator[None]:
    """Ctrl-C and SIGTERM wait until the end of the block; for processes that are started in it, which inherit this, for ever."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _share(count: int) -> Iterator[None]:
    """Processes that are started in the block use at most their share of the cores, of ``count`` such processes."""
    before = {name: os.environ.get(name) for name in THREADS}
    each = max(1, cores() // count)
    asked = {name: int(value) for name, value in before.items() if value and value.isdecimal()}
    os.environ.update({name: str(min(each, asked.get(name, each))) for name in THREADS})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _begin(turns) -> None:
    """In a new process: end with the one that started it, and take a card before anybody starts CUDA here."""
    threading.Thread(target=_end_with, args=(multiprocessing.parent_process(),), daemon=True).start()
    if turns is not None:
        os.environ[VISIBLE] = turns.get()


def _end_with(parent) -> None:
    parent.join()
    os._exit(1)
