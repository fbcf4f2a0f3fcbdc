"""Sheets that resist a sharp bend more, or less, than in proportion."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import PlateTerm

__all__ = ["PlateStiffening"]

LEAST = 1e-12  # 1/m^2 added to the square of a curvature: flat is not 0 / 0


@wp.func
def bend(curvature: Any, p: Any, o: int):
    squared = curvature[0] * curvature[0] + curvature[1] * curvature[1]
    squared += type(p[o])(2.0) * curvature[2] * curvature[2] + type(p[o])(LEAST)
    share = squared / (squared + p[o + 1] * p[o + 1])
    return curvature * (p[o] * share)


class PlateStiffening(PlateTerm):
    """M = b k |k|^2 / (|k|^2 + k_0^2): beside a law in proportion, a rigidity that grows from B to B + b where a bend is sharper than k_0.

    Woven cloth resists small bends by friction between its yarns and larger ones by the yarns alone; layers that are pressed together
    stiffen. Energy b / 2 (|k|^2 - k_0^2 ln(1 + |k|^2 / k_0^2)), convex for b > 0.
    """

    name = "plate_stiffening"
    parameters = (
        Parameter("plate_stiffening", 0.0, 0.0, 1e2, "N m", "rigidity b that sharp bends have beyond slight ones"),
        Parameter("plate_knee", 30.0, 1.0, 1e3, "1/m", "curvature k_0 at which half of it is met", scale="log"),
    )
    law = bend

    @staticmethod
    def twin(curvature, plate_stiffening, plate_knee):
        """The same law in numpy."""
        import numpy as np

        curvature = np.asarray(curvature)
        squared = (curvature**2 @ [1.0, 1.0, 2.0])[..., None] + LEAST
        return plate_stiffening * squared / (squared + plate_knee**2) * curvature
