"""How far something that relaxes gets in a given time."""

from typing import Any

import warp as wp

__all__ = ["settled"]


@wp.func
def settled(x: Any):
    """1 - exp(-x): the share of the way to its target that q' = (target - q) / tau goes in x = t / tau. In [0, 1] for x >= 0.

    As 2 h / (1 + h) with h = tanh(x / 2), which keeps its digits where x is small and 1 - exp(-x) would lose them in float32.
    """
    h = wp.tanh(x * type(x)(0.5))
    return type(x)(2.0) * h / (type(x)(1.0) + h)
