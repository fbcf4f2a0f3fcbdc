"""Viscous stress of sheets that are being stretched."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .membrane import in_plane, in_plane_twin
from .stages import ViscousMembraneTerm

__all__ = ["MembraneDamping"]


@wp.func
def resist(rate: Any, p: Any, o: int):
    return in_plane(rate, p[o], p[o + 1])


class MembraneDamping(ViscousMembraneTerm):
    """S = eta h / (1 - nu^2) ((1 - nu) e' + nu tr(e') 1), e' the rate of Green's strain (Kelvin and Voigt).

    A membrane's damping time is eta h / (E h). Rigid motions are not damped.
    """

    name = "membrane_damping"
    parameters = (
        Parameter("membrane_viscosity", 0.0, 0.0, 1e3, "N s/m", "stress resultant per rate of a strip's stretch, E h times a damping time"),
        Parameter("membrane_viscous_poisson", 0.3, 0.0, 0.9, "-", "how a stretched strip damps across, as Poisson's ratio"),
    )
    law = resist

    @staticmethod
    def twin(rate, membrane_viscosity, membrane_viscous_poisson):
        """The same law in numpy."""
        return in_plane_twin(rate, membrane_viscosity, membrane_viscous_poisson)
