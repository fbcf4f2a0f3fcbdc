"""Drag of still air on a body's skin."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import SurfaceTerm

__all__ = ["SurfaceDrag"]

AIR = 1.2  # kg/m^3, at room temperature
SHADOW = 0.25  # of a convex body's skin is its mean shadow (Cauchy)
HALF_DENSITY = 0.5 * AIR * SHADOW


@wp.func
def hold_back(x: Any, v: Any, home: Any, area: Any, m: Any, p: Any, o: int):
    return v * (-p[o] * type(m)(HALF_DENSITY) * area * wp.length(v))


class SurfaceDrag(SurfaceTerm):
    """F = -C rho / 2 (A / 4) |v| v for a patch A of skin: the drag of a convex body with its mean shadow, a quarter of its surface."""

    name = "surface_drag"
    parameters = (Parameter("drag_coefficient", 1.0, 0.0, 50.0, "-", "drag coefficient C"),)
    law = hold_back

    @staticmethod
    def twin(x, v, home, area, m, drag_coefficient):
        """The same law in numpy, for one point."""
        import numpy as np

        return -HALF_DENSITY * drag_coefficient * area * np.linalg.norm(v) * v
