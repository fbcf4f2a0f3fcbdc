"""Drag of still air on a particle's surface: a force that does not ask what the particle weighs."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import BodyTerm

__all__ = ["AirDrag"]


@wp.func
def hold_back(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    return -p[o] * v


class AirDrag(BodyTerm):
    """F = -c v, Stokes' drag of a small slow body. A particle that is loaded is slowed less by it: dv/dt = -(c / m) v.

    PhysTwin's drag (``LinearDrag``) takes the same share of every particle's speed, as if what is heavier had more surface.
    """

    name = "air_drag"
    parameters = (Parameter("air_drag", 3.0, 0.0, 20.0, "N s/m", "drag force for each m/s of a particle"),)
    law = hold_back

    @staticmethod
    def twin(x, v, home, m, air_drag):
        """The same law in numpy."""
        return -air_drag * v
