"""Drag that slows every particle at a constant rate."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import VelocityTerm

__all__ = ["LinearDrag"]


@wp.func
def slow(v: Any, dt: Any, p: Any, o: int):
    return v * wp.exp(-dt * p[o])


class LinearDrag(VelocityTerm):
    """v <- v exp(-dt c): exact for dv/dt = -c v, applied after the forces (PhysTwin's code)."""

    name = "linear_drag"
    parameters = (Parameter("drag_damping", 3.0, 0.0, 20.0, "1/s", "rate at which velocities decay in still air"),)
    law = slow

    @staticmethod
    def twin(v, dt, drag_damping):
        """The same law in numpy."""
        import numpy as np

        return v * np.exp(-dt * drag_damping)
