"""A gas in the pores of a solid, which resists being squeezed, and may be more than fits."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from ..strains import young, young_twin
from .base import Effect
from .stages import MaterialTerm

__all__ = ["Inflation"]


@wp.func
def stress(deformed: Any, home: Any, mu: Any, lame: Any, p: Any, o: int):
    swell = wp.determinant(deformed)
    return wp.transpose(wp.inverse(deformed)) * (p[o] * young(mu, lame) * (swell - p[o + 1]))


class Inflation(MaterialTerm):
    """P = -p J F^-T with the pressure p = k (f / J - 1) over that outside, k = a Y: Boyle's law, of the energy W = k (J - f ln J).

    f is the room that the filling wants, over what it had in frame 0: 1 where it only resists, more in a body that was blown up. Closed
    foams have k of 100 kPa times their porosity (Gibson and Ashby, "Cellular solids", 1997, section 5.3); what leaks has less.
    """

    name = "inflation"
    parameters = (
        Parameter("inflation", 0.0, 0.0, 50.0, "-", "pressure at twice the filling over Young's modulus"),
        Parameter("inflation_fill", 1.0, 0.5, 2.0, "-", "room that the filling wants, over what it has in frame 0"),
    )
    law = stress
    effect = Effect(
        "pressure",
        "what is inside resists being squeezed into less room",
        amplitudes=("inflation",),
        typical={"inflation": 1.0},
        shapes={"inflation_fill": (1.0, 1.1)},
        motion="squeeze it between two hands, along one axis and along another",
    )

    @staticmethod
    def twin(deformed, home, mu, lame, inflation, inflation_fill):
        """The same law in numpy."""
        excess = inflation * young_twin(mu, lame) * (np.linalg.det(deformed) - inflation_fill)
        return excess[..., None, None] * np.swapaxes(np.linalg.inv(deformed), -1, -2)
