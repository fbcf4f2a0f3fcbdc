"""Viscous stress of solids beside their elasticity."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Term

__all__ = ["KelvinVoigt"]


@wp.func
def stress(deformed: Any, rate: Any, p: Any, o: int):
    one = type(p[o])(1.0)
    two = type(p[o])(2.0)
    mu = p[o] / (two * (one + p[o + 1]))
    lame = two * mu * p[o + 1] / (one - two * p[o + 1])
    mixed = wp.transpose(deformed) * rate
    return deformed * (mixed + wp.transpose(mixed)) * mu + deformed * (lame * wp.trace(mixed))


class KelvinVoigt(Term):
    """P = F (lambda tr(E') 1 + 2 mu E') with the rate E' of the Green strain: an elastic law's damping time is eta / Young's modulus.

    mu and lambda are Lame's constants of eta in the place of Young's modulus. Rigid motions are not damped.
    """

    name = "kelvin_voigt"
    stage = "viscous"
    parameters = (
        Parameter("viscosity", 0.0, 0.0, 1e6, "Pa s", "eta: stress per rate of a stretch, E times the damping time"),
        Parameter("viscous_poisson", 0.3, 0.0, 0.49, "-", "how a stretched bar damps across, as Poisson's ratio"),
    )
    law = stress

    @staticmethod
    def twin(deformed, rate, viscosity, viscous_poisson):
        """The same law in numpy, for deformation gradients and their rates (..., 3, 3)."""
        import numpy as np

        mu = viscosity / (2 * (1 + viscous_poisson))
        lame = 2 * mu * viscous_poisson / (1 - 2 * viscous_poisson)
        mixed = np.swapaxes(deformed, -1, -2) @ rate
        trace = np.trace(mixed, axis1=-2, axis2=-1)[..., None, None]
        return deformed @ (mu * (mixed + np.swapaxes(mixed, -1, -2))) + lame * trace * deformed
