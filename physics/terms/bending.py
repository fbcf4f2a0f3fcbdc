"""Elastic bending about a natural shape."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import HingeTerm

__all__ = ["Bending"]


@wp.func
def moment(kappa: Any, rate: Any, natural: Any, span: Any, p: Any, o: int):
    bent = (kappa - p[o + 1] * natural) * (p[o] / span)
    return type(kappa)(bent[0], bent[1], type(span)(0.0))


class Bending(HingeTerm):
    """M = B (kappa - s kappa_0) / l about both material axes: B is the flexural rigidity E I, kappa_0 the hinge's natural curvature.

    Bergou et al., "Discrete elastic rods", 2008, equation 2 for an isotropic section.
    """

    name = "bending"
    parameters = (
        Parameter("bending_stiffness", 0.0, 0.0, 100.0, "N m^2", "flexural rigidity E I; of a sheet, of the strip that a hinge stands for"),
        Parameter("natural_share", 1.0, 0.0, 2.0, "-", "how much of the given natural curvature the body wants"),
    )
    law = moment
    effect = Effect(
        name="bending",
        says="it resists being bent",
        amplitudes=("bending_stiffness",),
        typical={"bending_stiffness": 0.01},
        shapes={"natural_share": (0.0, 1.0)},
        motion="bring the held points together, so that the body must fold or bow between them",
    )

    @staticmethod
    def twin(kappa, rate, natural, span, bending_stiffness, natural_share):
        """The same law in numpy."""
        import numpy as np

        return bending_stiffness * (kappa - natural_share * natural) / span * np.array([1.0, 1.0, 0.0])
