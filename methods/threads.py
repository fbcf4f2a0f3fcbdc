"""How many threads small tensors are worth."""

from __future__ import annotations

from contextlib import contextmanager

__all__ = ["SMALL", "threads_for"]

SMALL = 50_000  # numbers, or pixels: smaller tensors gain nothing by threads, which wait for each other where cores are shared


@contextmanager
def threads_for(size: int):
    """Within, torch works with one thread on tensors or images smaller than ``SMALL``; after it with as many as before."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1 if size < SMALL else before)
    try:
        yield
    finally:
        torch.set_num_threads(before)
