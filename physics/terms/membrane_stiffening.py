"""Sheets that resist being stretched far more than in proportion."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import MembraneTerm

__all__ = ["MembraneStiffening"]


@wp.func
def stretch(strain: Any, p: Any, o: int):
    squared = strain[0] * strain[0] + strain[1] * strain[1] + type(p[o])(2.0) * strain[2] * strain[2]
    return strain * (p[o] * squared / (squared + p[o + 1] * p[o + 1]))


class MembraneStiffening(MembraneTerm):
    """S = b E |E|^2 / (|E|^2 + e_0^2): beside a law in proportion, a stiffness that grows by b where the sheet is strained more than e_0.

    Yarns of a cloth that are pulled straighten out first and are stretched then. Energy b / 2 (|E|^2 - e_0^2 ln(1 + |E|^2 / e_0^2)),
    convex for b > 0, as ``plate_stiffening`` has it for bends.
    """

    name = "membrane_stiffening"
    parameters = (
        Parameter("membrane_stiffening", 0.0, 0.0, 1e5, "N/m", "stiffness b that large strains meet beyond small ones"),
        Parameter("membrane_knee", 0.02, 1e-3, 0.5, "-", "strain e_0 at which half of it is met", scale="log"),
    )
    law = stretch
    effect = Effect(
        "strain_stiffening",
        "the sheet stiffens as it stretches",
        amplitudes=("membrane_stiffening",),
        typical={"membrane_stiffening": 200.0},
        shapes={"membrane_knee": (0.01, 0.04)},
        motion="slow stretches, small and large",
    )

    @staticmethod
    def twin(strain, membrane_stiffening, membrane_knee):
        """The same law in numpy."""
        import numpy as np

        strain = np.asarray(strain)
        squared = (strain**2 @ [1.0, 1.0, 2.0])[..., None]
        return membrane_stiffening * squared / (squared + membrane_knee**2) * strain
