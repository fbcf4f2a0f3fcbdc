"""Air on a body's skin, in the amounts of ``Wind`` and ``QuadraticDrag``, which are per mass of the whole body.

These pull at mass. In a rope or a sheet skin and mass are spread alike; in a solid air pulls at the skin alone, and what is inside is
carried along by it.
"""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import SurfaceTerm
from .wind import CALM, Wind

__all__ = ["SkinDrag", "SkinWind"]

SKIN = Parameter("told_skin", 1.0, 1e-6, 1e6, "m^2/kg", "skin over mass of the whole body, as it is told")


@wp.func
def blow(x: Any, v: Any, home: Any, area: Any, m: Any, p: Any, o: int):
    q = type(x)(p[o], p[o + 1], p[o + 2])
    calm = type(m)(wp.static(CALM))
    size = wp.sqrt(wp.dot(q, q) + calm * calm)
    u = v / p[o + 3]
    past = q / size - u
    faint = calm / size  # of no direction where there is no wind: |e|^2 + faint^2 = 1
    return (q - u * (size - calm)) * (area / p[o + 4] * wp.sqrt(wp.dot(past, past) + faint * faint))


class SkinWind(SurfaceTerm):
    """F = (a M / A) |q| |e - v / W| (e - v / W), e = q / |q|, on a patch a of the skin A of a body of mass M (``Wind``)."""

    name = "skin_wind"
    parameters = (*Wind.parameters, SKIN)
    loads = Wind.loads
    law = blow

    @staticmethod
    def twin(x, v, home, area, m, wind_x, wind_y, wind_z, wind_speed, told_skin):
        """The same law in numpy, for one point."""
        return Wind.twin(x, v, home, area / told_skin, wind_x, wind_y, wind_z, wind_speed)


@wp.func
def resist(x: Any, v: Any, home: Any, area: Any, m: Any, p: Any, o: int):
    return v * (-p[o] * wp.length(v) * area / p[o + 1])


class SkinDrag(SurfaceTerm):
    """F = -c (a M / A) |v| v on a patch a of the skin A of a body of mass M: Rayleigh's drag equation with c = rho C_d A / (2 M)."""

    name = "skin_drag"
    parameters = (Parameter("quadratic_drag", 0.0, 0.0, 1000.0, "1/m", "share of its speed that the body loses per metre of way"), SKIN)
    law = resist

    @staticmethod
    def twin(x, v, home, area, m, quadratic_drag, told_skin):
        """The same law in numpy, for one point."""
        import numpy as np

        return -quadratic_drag * area / told_skin * np.linalg.norm(v) * v
