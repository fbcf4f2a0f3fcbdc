"""Fresh processes that share out the work: each has its part of the cores and, on graphics cards, sees one card only.

They end with the process that started them, however that ends. Ctrl-C and SIGTERM reach none of them: whoever started them is told, and
decides.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from ..datasets.pool import Pool
from ..physics.cores import cores

__all__ = ["VISIBLE", "cards", "end_children", "share", "workers"]

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


def workers(count: int, devices: Sequence[str] = ()) -> Pool:
    """A pool of ``count`` fresh processes; each takes the next of ``devices``, and the first again after the last, for its only card.

    What a process runs may use as many threads as it has cores to itself. How the pool ends: see ``datasets.pool``.
    """
    if not devices:
        return _Pool(count)
    turns = multiprocessing.get_context("spawn").Queue()
    for k in range(count):
        turns.put(devices[k % len(devices)])
    return _Pool(count, _take, turns)


def end_children() -> None:
    """End all processes that this one has started through ``multiprocessing``, at once."""
    for child in multiprocessing.active_children():
        child.kill()


class _Pool(Pool):
    """A pool whose processes are started, when work is submitted, with their share of threads."""

    _max_workers: int  # of ``concurrent.futures``

    def submit(self, *given, **named):
        with _share(self._max_workers):
            return super().submit(*given, **named)


def share(count: int) -> dict[str, str]:
    """What the environment must say so that one of ``count`` processes uses its share of the cores, or fewer where it says so already."""
    each = max(1, cores() // count)
    asked = {name: int(value) for name in THREADS if (value := os.environ.get(name, "")).isdecimal()}
    return {name: str(min(each, asked.get(name, each))) for name in THREADS}


@contextmanager
def _share(count: int) -> Iterator[None]:
    """Processes that are started in the block use at most their share of the cores, of ``count`` such processes."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(share(count))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _take(turns) -> None:
    os.environ[VISIBLE] = turns.get()  # before anybody starts CUDA here
