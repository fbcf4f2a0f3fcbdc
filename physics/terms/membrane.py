"""Stretch of sheets, stiff in proportion to Green's strain."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import MembraneTerm

__all__ = ["Membrane", "in_plane", "in_plane_twin"]


@wp.func
def in_plane(strain: Any, stiffness: Any, poisson: Any):
    """Plane stress of an isotropic sheet, Hooke's law: ``stiffness`` [N/m] is Young's modulus times the thickness."""
    one = type(stiffness)(1.0)
    c = stiffness / (one - poisson * poisson)
    across = poisson * c
    return type(strain)(c * strain[0] + across * strain[1], across * strain[0] + c * strain[1], (c - across) * strain[2])


@wp.func
def stretch(strain: Any, p: Any, o: int):
    return in_plane(strain, p[o], p[o + 1])


def in_plane_twin(strain, stiffness, poisson):
    """The same in numpy, for tensors (..., 3)."""
    import numpy as np

    a, b, shear = np.moveaxis(np.asarray(strain), -1, 0)
    return stiffness / (1 - poisson**2) * np.stack([a + poisson * b, b + poisson * a, (1 - poisson) * shear], -1)


class Membrane(MembraneTerm):
    """S = E h / (1 - nu^2) ((1 - nu) e + nu tr(e) 1), e Green's strain in the plane: St. Venant and Kirchhoff's law in plane stress.

    E is Young's modulus, h the thickness. A strip under tension T per width is longer by T / (E h) at small strains.
    """

    name = "membrane"
    parameters = (
        Parameter("membrane_stiffness", 300.0, 1.0, 1e6, "N/m", "Young's modulus times thickness, E h", scale="log"),
        Parameter("membrane_poisson", 0.3, 0.0, 0.9, "-", "Poisson's ratio nu in the plane"),
    )
    law = stretch

    @staticmethod
    def twin(strain, membrane_stiffness, membrane_poisson):
        """The same law in numpy."""
        return in_plane_twin(strain, membrane_stiffness, membrane_poisson)
