"""What fills a closed body and resists being squeezed into less room."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import FacetTerm

__all__ = ["Pressure"]


@wp.func
def press(area: Any, v: Any, m: Any, swell: Any, dt: Any, p: Any, o: int):
    return area * (p[o] * (p[o + 1] * swell - type(m)(1.0)))


class Pressure(FacetTerm):
    """F = p A n on every facet of a closed skin, p = k (V0 / V - 1): Boyle's law for air of the pressure k outside, over that pressure.

    V0 is the room that the filling wants, ``pressure_fill`` times that within the skin in frame 0; what leaks or gives way resists by less
    than air, 100 kPa. An open skin has no inside, so that nothing is pressed there.
    """

    name = "pressure"
    parameters = (
        Parameter("pressure", 0.0, 0.0, 1e8, "Pa", "pressure at twice the filling, or in half the room"),
        Parameter("pressure_fill", 1.0, 0.5, 2.0, "-", "room that the filling wants, over what it has in frame 0"),
    )
    law = press
    effect = Effect(
        "pressure",
        "what is inside resists being squeezed into less room",
        amplitudes=("pressure",),
        typical={"pressure": 2000.0},
        motion="squeeze it between two hands, along one axis and along another",
    )

    @staticmethod
    def twin(area, v, m, swell, dt, pressure, pressure_fill):
        """The same law in numpy."""
        return pressure * (pressure_fill * swell - 1) * area
