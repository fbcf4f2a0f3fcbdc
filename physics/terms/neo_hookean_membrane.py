"""Stretch of rubber sheets, which keep their volume and withstand being crushed."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import MembraneTerm

__all__ = ["NeoHookeanMembrane"]

FLATTEST = 0.02  # least det C that counts: beyond it a triangle is all but a line


@wp.func
def stretch(strain: Any, p: Any, o: int):
    one = type(p[o])(1.0)
    two = type(p[o])(2.0)
    a = one + two * strain[0]
    b = one + two * strain[1]
    c = two * strain[2]
    det = wp.max(a * b - c * c, type(p[o])(FLATTEST))
    mu = p[o] / type(p[o])(3.0)
    less = mu / (det * det)
    return type(strain)(mu - less * b, mu - less * a, less * c)


class NeoHookeanMembrane(MembraneTerm):
    """S = mu h (1 - C^-1 / det C), mu = E / 3: an incompressible neo-Hookean sheet in plane stress, thinner by 1 / sqrt(det C).

    Of the energy W = mu h / 2 (tr C + 1 / det C - 3). A strip at the stretch l bears mu h (l - 1 / l^2) per width. Holzapfel, "Nonlinear
    solid mechanics", 2000, section 6.5.
    """

    name = "neo_hookean_membrane"
    parameters = (Parameter("rubber_stiffness", 300.0, 1.0, 1e6, "N/m", "Young's modulus at small strains times thickness", scale="log"),)
    law = stretch

    @staticmethod
    def twin(strain, rubber_stiffness):
        """The same law in numpy."""
        import numpy as np

        a, b, c = np.moveaxis(np.asarray(strain) * 2 + [1.0, 1.0, 0.0], -1, 0)
        less = 1 / np.maximum(a * b - c * c, FLATTEST) ** 2
        return rubber_stiffness / 3 * np.stack([1 - less * b, 1 - less * a, less * c], -1)
