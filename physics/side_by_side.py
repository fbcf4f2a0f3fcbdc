"""Independent pieces of work beside each other: on a CPU one for each core, on a GPU each in a stream of its own.

What is simulated by itself, as sound twins that differ in their cells or effects that differ in their laws, fits into no batch. A launch on
the CPU runs outside Python's lock, and one of a small system takes a single of a GPU's hundred processors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from threading import Lock, RLock, local
from typing import Any, TypeVar

import torch
import warp as wp

from .cores import threads

__all__ = ["COMPILER", "launch", "side_by_side"]

Item = TypeVar("Item")
Found = TypeVar("Found")

COMPILER = RLock()  # Warp's: it makes and loads one kernel at a time
WHOLE = Lock()  # of a GPU: blocks that wait for each other must all have a processor
_HERE = local()  # of a thread that works on a piece: how many threads fall to it


def side_by_side(work: Callable[[Item], Found], items: Iterable[Item], device: str, *, workers: int | None = None) -> list[Found]:
    """What ``work`` returns for each of ``items``, in their order; what it finds must not depend on who else is at work.

    ``device`` "cpu", "cuda" or "cuda:1" is where it computes. As many at a time as there are threads (``cores.threads``), or as fall to
    a piece of ``work`` that asks for this itself, or ``workers``. Raises what ``work`` raises, of the first item that does.
    """
    items, room = list(items), workers or getattr(_HERE, "threads", 0) or threads()
    count = min(room, len(items))
    if count <= 1:
        return [work(item) for item in items]
    cuda = torch.device(device).type == "cuda"

    def one(item: Item) -> Found:
        _HERE.threads = max(1, room // count)
        if not cuda:
            return work(item)
        with torch.cuda.stream(stream := torch.cuda.Stream(device)):
            found = work(item)
        stream.synchronize()
        return found

    if cuda:
        torch.cuda.current_stream(device).synchronize()  # a new stream does not wait for it
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(one, items))


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
