"""Springs that grow stiffer as they stretch."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import AxialTerm

__all__ = ["StrainStiffening"]


@wp.func
def stiffen(length: Any, rate: Any, rest: Any, stiffness: Any, p: Any, o: int):
    strain = length / rest - type(length)(1.0)
    return stiffness * p[o] * strain * strain * strain


class StrainStiffening(AxialTerm):
    """F = Y b e^3 beside the spring's own Y e, e = l / L0 - 1: odd in the strain, as the Duffing oscillator's cubic spring.

    At e = 1 / sqrt(b) the tension is twice the linear one and the slope dF/de = Y (1 + 3 b e^2) four times, and the stable step half.
    """

    name = "strain_stiffening"
    parameters = (Parameter("strain_stiffening", 0.0, 0.0, 1000.0, "-", "cubic share of the tension at unit strain"),)
    law = stiffen
    effect = Effect(
        "strain_stiffening",
        "the material stiffens as it stretches",
        amplitudes=("strain_stiffening",),
        typical={"strain_stiffening": 20.0},
        motion="slow stretches, small and large",
    )

    @staticmethod
    def twin(length, rate, rest, stiffness, strain_stiffening):
        """The same law in numpy."""
        strain = length / rest - 1
        return stiffness * strain_stiffening * strain**3
