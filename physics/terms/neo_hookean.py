"""Compressible neo-Hookean elasticity of solids."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import SolidTerm

__all__ = ["NeoHookean", "neo_hookean", "neo_hookean_twin"]

FLATTEST = 0.02  # least J of which the logarithm is taken: beyond it material is all but inside out


@wp.func
def moduli(p: Any, o: int):
    one = type(p[o])(1.0)
    two = type(p[o])(2.0)
    mu = p[o] / (two * (one + p[o + 1]))
    return mu, two * mu * p[o + 1] / (one - two * p[o + 1])


@wp.func
def neo_hookean(deformed: Any, mu: Any, lame: Any):
    """P of moduli mu and lambda [Pa]."""
    inverse = wp.transpose(wp.inverse(deformed))
    volume = wp.max(wp.determinant(deformed), type(mu)(FLATTEST))
    return (deformed - inverse) * mu + inverse * (lame * wp.log(volume))


@wp.func
def stress(deformed: Any, p: Any, o: int):
    mu, lame = moduli(p, o)
    return neo_hookean(deformed, mu, lame)


def neo_hookean_twin(deformed, mu, lame):
    """The same in numpy, for deformation gradients (..., 3, 3)."""
    import numpy as np

    inverse = np.swapaxes(np.linalg.inv(deformed), -1, -2)
    volume = np.log(np.maximum(np.linalg.det(deformed), FLATTEST))
    return mu * (deformed - inverse) + lame * volume[..., None, None] * inverse


class NeoHookean(SolidTerm):
    """P = mu (F - F^-T) + lambda ln J F^-T, of the energy W = mu / 2 (tr F'F - 3 - 2 ln J) + lambda / 2 (ln J)^2.

    Lame's constants mu = E / 2 (1 + nu) and lambda = 2 mu nu / (1 - 2 nu) are those of small strains. Bonet and Wood, "Nonlinear continuum
    mechanics for finite element analysis", 2008, equation 6.28.
    """

    name = "neo_hookean"
    parameters = (
        Parameter("youngs_modulus", 2e4, 1e2, 1e8, "Pa", "Young's modulus E at small strains", scale="log"),
        Parameter("poisson", 0.3, 0.0, 0.49, "-", "Poisson's ratio nu at small strains"),
    )
    law = stress
    moduli = moduli

    @staticmethod
    def twin_moduli(youngs_modulus, poisson):
        """Lame's constants (mu, lambda) [Pa] in numpy."""
        mu = youngs_modulus / (2 * (1 + poisson))
        return mu, 2 * mu * poisson / (1 - 2 * poisson)

    @staticmethod
    def twin(deformed, youngs_modulus, poisson):
        """The same law in numpy, for deformation gradients (..., 3, 3)."""
        return neo_hookean_twin(deformed, *NeoHookean.twin_moduli(youngs_modulus, poisson))
