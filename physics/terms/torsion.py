"""Elastic twist of ropes."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import HingeTerm

__all__ = ["Torsion"]


@wp.func
def moment(kappa: Any, rate: Any, natural: Any, span: Any, p: Any, o: int):
    return type(kappa)(type(span)(0.0), type(span)(0.0), p[o] * kappa[2] / span)


class Torsion(HingeTerm):
    """T = C tau / l along the rope: C [N m^2] is the torsional rigidity G J. Only hinges of a chain twist.

    Bergou et al., "Discrete elastic rods", 2008, section 4.2.2.
    """

    name = "torsion"
    parameters = (Parameter("torsion_stiffness", 0.0, 0.0, 100.0, "N m^2", "torsional rigidity G J"),)
    law = moment
    effect = Effect(
        name="torsion",
        says="it resists being twisted, so that a naturally bent rope does not roll freely",
        amplitudes=("torsion_stiffness",),
        typical={"torsion_stiffness": 0.01},
        motion="move the grips around each other, so that the rope leaves its plane",
    )

    @staticmethod
    def twin(kappa, rate, natural, span, torsion_stiffness):
        """The same law in numpy."""
        import numpy as np

        return torsion_stiffness * kappa / span * np.array([0.0, 0.0, 1.0])
