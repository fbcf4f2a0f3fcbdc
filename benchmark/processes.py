"""Fresh processes that share out the graphics cards: each sees one card only, so that all of a worker's libraries agree on which."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor

__all__ = ["cards", "workers"]

VISIBLE = "CUDA_VISIBLE_DEVICES"


def cards(device: str = "cuda") -> tuple[str, ...]:
    """What ``CUDA_VISIBLE_DEVICES`` calls the graphics cards that this process sees; none where ``device`` is not "cuda"."""
    if device != "cuda":
        return ()
    import torch

    count = torch.cuda.device_count()
    named = [name.strip() for name in os.environ.get(VISIBLE, "").split(",") if name.strip()]
    return tuple(named[:count] if named else map(str, range(count)))


def workers(count: int, devices: Sequence[str] = ()) -> ProcessPoolExecutor:
    """A pool of ``count`` fresh processes; each takes the next of ``devices``, and the first again after the last, for its only card."""
    context = multiprocessing.get_context("spawn")
    if not devices:
        return ProcessPoolExecutor(count, mp_context=context)
    turns = context.Queue()
    for k in range(count):
        turns.put(devices[k % len(devices)])
    return ProcessPoolExecutor(count, mp_context=context, initializer=_take, initargs=(turns,))


def _take(turns):
    os.environ[VISIBLE] = turns.get()  # before anybody starts CUDA here
