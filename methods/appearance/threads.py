"""How many threads small images are worth."""

from __future__ import annotations

from contextlib import contextmanager

__all__ = ["SMALL", "threads_for"]

SMALL = 50_000  # px: tensors of smaller images gain nothing by threads, which wait for each other where cores are shared


@contextmanager
def threads_for(pixels: int):
    """Within, torch works with one thread on images of fewer than ``SMALL`` pixels; after it with as many as before."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1 if pixels < SMALL else before)
    try:
        yield
    finally:
        torch.set_num_threads(before)
