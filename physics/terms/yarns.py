"""Yarns in a sheet: it is stiffer along one direction."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import MembraneTerm

__all__ = ["Yarns"]


@wp.func
def stretch(strain: Any, p: Any, o: int):
    one = type(p[o])(1.0)
    c = wp.cos(p[o + 1])
    s = wp.sin(p[o + 1])
    along = strain[0] * c * c + strain[1] * s * s + strain[2] * (one + one) * c * s
    return type(strain)(c * c, s * s, c * s) * (p[o] * along)


class Yarns(MembraneTerm):
    """S = k E_nn n n', n in the sheet's axes: yarns that lie along n and slide over each other, k [N/m] of them per width.

    Beside an isotropic sheet it is the simplest orthotropic one: warp and weft differ by k (Reddy, "Mechanics of laminated composite plates
    and shells", 2004, section 2.4, with E_1 alone).
    """

    name = "yarns"
    parameters = (
        Parameter("yarn_stiffness", 0.0, 0.0, 1e5, "N/m", "tension per width and strain along them, beyond that in other directions"),
        Parameter("yarn_azimuth", 0.0, -np.pi, np.pi, "rad", "their direction, from the sheet's first axis to its second"),
    )
    law = stretch
    effect = Effect(
        "anisotropy",
        "the sheet is stiffer in one direction than in another",
        amplitudes=("yarn_stiffness",),
        typical={"yarn_stiffness": 100.0},
        shapes={"yarn_azimuth": (0.0, np.pi / 2)},
        motion="stretches along two directions and on the bias",
    )

    @staticmethod
    def twin(strain, yarn_stiffness, yarn_azimuth):
        """The same law in numpy."""
        c, s = np.cos(yarn_azimuth), np.sin(yarn_azimuth)
        along = np.asarray(strain) @ [c * c, s * s, 2 * c * s]
        return yarn_stiffness * along[..., None] * np.array([c * c, s * s, c * s])
