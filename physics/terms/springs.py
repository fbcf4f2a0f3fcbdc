"""Elastic springs whose stiffness multiplies strain (PhysTwin, section 3.2; its code, not k (l - L0) as printed)."""

from typing import Any

import warp as wp

from .stages import AxialTerm

__all__ = ["Springs"]


@wp.func
def tension(length: Any, rate: Any, rest: Any, stiffness: Any, p: Any, o: int):
    return stiffness * (length / rest - type(length)(1.0))


class Springs(AxialTerm):
    """F = Y (l / L0 - 1) along each spring: Y [N] and L0 [m] belong to the spring, so they live in the system's spring table."""

    name = "springs"
    law = tension

    @staticmethod
    def twin(length, rate, rest, stiffness):
        """The same law in numpy."""
        return stiffness * (length / rest - 1)
