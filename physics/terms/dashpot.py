"""Damping along each spring (PhysTwin's code; the paper prints the isotropic form -gamma (v_i - v_j))."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import AxialTerm

__all__ = ["Dashpot"]


@wp.func
def damping(length: Any, rate: Any, rest: Any, stiffness: Any, p: Any, o: int):
    return p[o] * rate


class Dashpot(AxialTerm):
    """F = c dl/dt along each spring."""

    name = "dashpot"
    parameters = (Parameter("dashpot_damping", 100.0, 0.0, 200.0, "N s/m", "damping of the rate of stretch of every spring"),)
    law = damping

    @staticmethod
    def twin(length, rate, rest, stiffness, dashpot_damping):
        """The same law in numpy."""
        return dashpot_damping * rate
