"""Viscous stress of solids beside their elasticity."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import ViscousTerm

__all__ = ["KelvinVoigt"]


@wp.func
def stress(rate: Any, p: Any, o: int):
    one = type(p[o])(1.0)
    two = type(p[o])(2.0)
    mu = p[o] / (two * (one + p[o + 1]))
    lame = two * mu * p[o + 1] / (one - two * p[o + 1])
    return rate * (two * mu) + wp.identity(n=3, dtype=type(p[o])) * (lame * wp.trace(rate))


class KelvinVoigt(ViscousTerm):
    """S = lambda tr(E') 1 + 2 mu E' with the rate E' of the Green strain: an elastic law's damping time is eta / Young's modulus.

    mu and lambda are Lame's constants of eta in the place of Young's modulus. Rigid motions are not damped.
    """

    name = "kelvin_voigt"
    parameters = (
        Parameter("viscosity", 0.0, 0.0, 1e6, "Pa s", "eta: stress per rate of a stretch, E times the damping time"),
        Parameter("viscous_poisson", 0.3, 0.0, 0.49, "-", "how a stretched bar damps across, as Poisson's ratio"),
    )
    law = stress

    @staticmethod
    def twin(rate, viscosity, viscous_poisson):
        """The same law in numpy, for rates of the Green strain (..., 3, 3)."""
        import numpy as np

        mu = viscosity / (2 * (1 + viscous_poisson))
        lame = 2 * mu * viscous_poisson / (1 - 2 * viscous_poisson)
        return 2 * mu * rate + lame * np.trace(rate, axis1=-2, axis2=-1)[..., None, None] * np.eye(3)
