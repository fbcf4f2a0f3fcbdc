"""Independent pieces of work beside each other: on a CPU one for each core, on a GPU each in a stream of its own.

What is simulated by itself, as sound twins that differ in their cells or effects that differ in their laws, fits into no batch. A launch on
the CPU runs outside Python's lock, and one of a small system takes a single of a GPU's hundred processors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from threading import Lock, RLock, Semaphore, local
from typing import Any, TypeVar

import torch
import warp as wp

from .cores import threads

__all__ = ["COMPILER", "launch", "side_by_side"]

Item = TypeVar("Item")
Found = TypeVar("Found")

COMPILER = RLock()  # Warp's: it makes and loads one kernel at a time
WHOLE = Lock()  # of a GPU: blocks that wait for each other must all have a processor
_HERE = local()  # of a thread that works on a piece: the room that it takes a place of


def side_by_side(work: Callable[[Item], Found], items: Iterable[Item], device: str, *, workers: int | None = None) -> list[Found]:
    """What ``work`` returns for each of ``items``, in their order; what it finds must not depend on who else is at work.

    ``device`` "cpu", "cuda" or "cuda:1" is where it computes. As many at a time as there are threads (``cores.threads``), or ``workers``.
    Where a piece of ``work`` asks for this itself, its pieces take its place and any that others have left: the last piece of all is not
    left to one thread. Raises what ``work`` raises, of the first item that does.
    """
    items, size = list(items), workers or threads()
    count = min(size, len(items))
    if count <= 1:
        return [work(item) for item in items]
    cuda, outer = torch.device(device).type == "cuda", getattr(_HERE, "room", None)
    room = outer or Semaphore(size)

    def one(item: Item) -> Found:
        with room:
            _HERE.room = room
            if not cuda:
                return work(item)
            with torch.cuda.stream(stream := torch.cuda.Stream(device)):
                found = work(item)
            stream.synchronize()
            return found

    if cuda:
        torch.cuda.current_stream(device).synchronize()  # a new stream does not wait for it
    with _left(outer), ThreadPoolExecutor(count) as pool:
        return list(pool.map(one, items))


@contextmanager
def _left(room: Semaphore | None):
    """Meanwhile the place of whoever waits for its pieces is theirs."""
    if room:
        room.release()
    try:
        yield
    finally:
        if room:
            room.acquire()


def launch(kernel, *, dim, inputs: list, device: str, block_dim: int | None = None, waiting: bool = False) -> None:
    """``warp.launch`` in torch's current stream, from any thread; ``waiting``: whether blocks of the kernel wait for each other."""
    how: dict[str, Any] = dict(dim=dim, inputs=inputs, device=device, block_dim=block_dim)
    if device == "cpu":
        how["block_dim"] = block_dim or 1
        with COMPILER:
            kernel.module.load(wp.get_device(device), block_dim=how["block_dim"])
        wp.launch(kernel, **how)  # the run itself
        return
    current = torch.cuda.current_stream(device)
    if current == torch.cuda.default_stream(device):  # which Warp's own stream waits for
        wp.launch(kernel, **how)
        return
    with WHOLE if waiting else nullcontext():
        with COMPILER:
            wp.launch(kernel, **how, stream=wp.stream_from_torch(current))
        if waiting:
            current.synchronize()
