"""A solid that grows stiffer as it is strained, as tissues and rubbers do."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from ..strains import green, green_twin, hooke, hooke_twin, young, young_twin
from .base import Effect
from .stages import MaterialTerm

__all__ = ["Fung"]

STEEPEST = 20.0  # exponent at which the law goes on linearly, 5e8 times stiffer: no number of a roll-out overflows


@wp.func
def stress(deformed: Any, home: Any, mu: Any, lame: Any, p: Any, o: int):
    strain = green(deformed)
    linear = hooke(strain, mu, lame)
    exponent = wp.min(p[o + 1] * wp.ddot(strain, linear) / young(mu, lame), type(mu)(STEEPEST))
    return deformed * (linear * (p[o] * (wp.exp(exponent) - type(mu)(1.0))))


class Fung(MaterialTerm):
    """P = a F (C : E) (exp(Q) - 1), Q = b E : C : E / Y, of the energy W = a Y (exp(Q) - 1 - Q) / 2 b, with the Green strain E.

    Fung's exponential law ("Biomechanics", 1993, section 7.5) less its linear part, so that nothing is added at small strains. In a bar
    under tension Q = b E_11^2; C and Y are the elasticity's own moduli.
    """

    name = "fung"
    parameters = (
        Parameter("fung_share", 0.0, 0.0, 100.0, "-", "stiffness of the exponential part as a share of the elasticity's"),
        Parameter("fung_exponent", 10.0, 0.1, 200.0, "-", "b: how soon it stiffens", scale="log"),
    )
    law = stress
    effect = Effect(
        "strain_stiffening",
        "the material stiffens as it stretches",
        amplitudes=("fung_share",),
        typical={"fung_share": 2.0},
        shapes={"fung_exponent": (3.0, 10.0, 30.0)},
        motion="slow stretches, small and large",
    )

    @staticmethod
    def twin(deformed, home, mu, lame, fung_share, fung_exponent):
        """The same law in numpy."""
        strain = green_twin(deformed)
        linear = hooke_twin(strain, mu, lame)
        exponent = np.minimum(fung_exponent * (strain * linear).sum((-1, -2)) / young_twin(mu, lame), STEEPEST)
        return deformed @ linear * (fung_share * (np.exp(exponent) - 1))[..., None, None]
