"""A solid that is softer in compression than in tension."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from ..strains import green, green_twin
from .base import Effect
from .stages import MaterialTerm

__all__ = ["TensionCompression"]


@wp.func
def stress(deformed: Any, home: Any, mu: Any, lame: Any, p: Any, o: int):
    strain = green(deformed)
    square = strain * strain
    size = wp.sqrt(p[o + 1] * p[o + 1] + wp.ddot(strain, strain))
    third = wp.ddot(strain, square) / (type(mu)(3.0) * size * size * size)
    return deformed * ((square * (type(mu)(1.0) / size) - strain * third) * (p[o] * (mu + mu)))


class TensionCompression(MaterialTerm):
    """P = a 2 mu F (E E / r - tr(E^3) E / 3 r^3), r^2 = w^2 + E : E, of the energy W = a 2 mu tr(E^3) / 3 r, with the Green strain E.

    The simplest odd energy that grows no faster than elasticity: cubic below strains of w, so that the stiffness at rest is the
    elasticity's and has no kink, and beyond a bar's modulus is Y + 4 a mu / 3 in tension and Y - 4 a mu / 3 in compression
    (for nu = 0). A smooth stand-in for bimodular materials (Ambartsumyan), whose stiffness jumps.
    """

    name = "tension_compression"
    parameters = (
        Parameter("tension_share", 0.0, -1.2, 1.2, "-", "how much stiffer it is in tension than in compression"),
        Parameter("tension_width", 0.02, 1e-3, 0.5, "-", "strain over which compression passes into tension", "log"),
    )
    law = stress
    effect = Effect(
        "compression_softening",
        "the material is softer in compression than in tension",
        amplitudes=("tension_share",),
        typical={"tension_share": 0.5},
        motion="pushing the ends together, then pulling them apart",
    )

    @staticmethod
    def twin(deformed, home, mu, lame, tension_share, tension_width):
        """The same law in numpy."""
        strain = green_twin(deformed)
        square = strain @ strain
        size = np.sqrt(tension_width**2 + (strain * strain).sum((-1, -2)))[..., None, None]
        third = (strain * square).sum((-1, -2))[..., None, None] / (3 * size**3)
        return tension_share * 2 * mu * deformed @ (square / size - third * strain)
