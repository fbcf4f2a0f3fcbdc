"""Which hand a law is of, by its number."""

from typing import Any

import warp as wp

__all__ = ["is_meant", "meant"]

HALF = 0.5  # numbers are whole: what is nearer to one than that is it


@wp.func
def meant(number: Any, hand: Any):
    """Whether ``number`` is that of the ``hand``, or -1, which is all of them."""
    half = type(number)(HALF)
    return number < -half or wp.abs(number - hand) < half


def is_meant(number: float, hand: float) -> bool:
    """The same in Python."""
    return number < -HALF or abs(number - hand) < HALF
