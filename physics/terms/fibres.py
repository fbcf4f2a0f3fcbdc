"""Fibres in a solid: it is stiffer along one axis."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from ..strains import young, young_twin
from .base import Effect
from .stages import MaterialTerm

__all__ = ["Fibres"]

SLACK = 0.01  # of I_4 - 1, twice the strain over which a fibre passes from slack to taut: a kink in the stiffness there has no derivative


@wp.func
def stress(deformed: Any, home: Any, mu: Any, lame: Any, p: Any, o: int):
    one = type(mu)(1.0)
    half = type(mu)(0.5)
    slack = type(mu)(SLACK)
    along = type(home)(wp.cos(p[o + 2]) * wp.cos(p[o + 1]), wp.cos(p[o + 2]) * wp.sin(p[o + 1]), wp.sin(p[o + 2]))
    fibre = deformed * along
    x = wp.dot(fibre, fibre) - one
    taut = half * (one + p[o + 3]) * x + half * (one - p[o + 3]) * (wp.sqrt(x * x + slack * slack) - slack)
    return wp.outer(fibre, along) * (half * p[o] * young(mu, lame) * taut)


class Fibres(MaterialTerm):
    """P = a Y / 2 h(I_4 - 1) F n n', I_4 = |F n|^2, h(x) = x in tension and c x in compression, joined smoothly over x of 0.01.

    The standard reinforcing model, W = k (I_4 - 1)^2 / 2 with k = a Y / 4 (Merodio and Ogden 2005): at small strains a fibre adds a Y to
    Young's modulus Y along n, a direction in the grid's axes. c is 0 for fibres that buckle and 1 for rods.
    """

    name = "fibres"
    parameters = (
        Parameter("fibre_share", 0.0, 0.0, 50.0, "-", "stiffness of the fibres as a share of the elasticity's"),
        Parameter("fibre_azimuth", 0.0, -np.pi, np.pi, "rad", "their direction, from the grid's first axis to its second"),
        Parameter("fibre_elevation", 0.0, -np.pi / 2, np.pi / 2, "rad", "their direction, from there to the grid's third axis"),
        Parameter("fibre_compression", 0.0, 0.0, 1.0, "-", "stiffness in compression over that in tension"),
    )
    law = stress
    effect = Effect(
        "anisotropy",
        "the material is stiffer in one direction than in another",
        amplitudes=("fibre_share",),
        typical={"fibre_share": 1.0},
        shapes={"fibre_azimuth": (0.0, np.pi / 2), "fibre_elevation": (0.0, np.pi / 2), "fibre_compression": (0.0, 1.0)},
        motion="stretches along two directions and on the bias",
    )

    @staticmethod
    def twin(deformed, home, mu, lame, fibre_share, fibre_azimuth, fibre_elevation, fibre_compression):
        """The same law in numpy."""
        level = np.cos(fibre_elevation)
        along = np.array([level * np.cos(fibre_azimuth), level * np.sin(fibre_azimuth), np.sin(fibre_elevation)])
        fibre = deformed @ along
        x = (fibre * fibre).sum(-1) - 1
        taut = (1 + fibre_compression) / 2 * x + (1 - fibre_compression) / 2 * (np.sqrt(x * x + SLACK**2) - SLACK)
        return (fibre_share * young_twin(mu, lame) / 2 * taut)[..., None, None] * fibre[..., :, None] * along
