"""Viscous moments of sheets that are being bent."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .plate_bending import flexed, flexed_twin
from .stages import ViscousPlateTerm

__all__ = ["PlateDamping"]


@wp.func
def resist(rate: Any, p: Any, o: int):
    return flexed(rate, p[o], p[o + 1])


class PlateDamping(ViscousPlateTerm):
    """M = c ((1 - nu) k' + nu tr(k') 1) of the rate k' at which the curvature changes: a plate's damping time is c / B."""

    name = "plate_damping"
    parameters = (
        Parameter("plate_viscosity", 0.0, 0.0, 1.0, "N m s", "bending moment per length and rate of curvature, B times a damping time"),
        Parameter("plate_viscous_poisson", 0.0, 0.0, 0.5, "-", "how it damps across, as Poisson's ratio"),
    )
    law = resist

    @staticmethod
    def twin(rate, plate_viscosity, plate_viscous_poisson):
        """The same law in numpy."""
        return flexed_twin(rate, plate_viscosity, plate_viscous_poisson)
