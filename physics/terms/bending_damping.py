"""Bending that takes energy out: the body's own friction, which neither drag nor springs along its length have."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import HingeTerm

__all__ = ["BendingDamping"]


@wp.func
def moment(kappa: Any, rate: Any, natural: Any, span: Any, p: Any, o: int):
    resisted = rate * (p[o] / span)
    return type(kappa)(resisted[0], resisted[1], type(span)(0.0))


class BendingDamping(HingeTerm):
    """M = eta (d kappa / dt) / l about both material axes (Kelvin and Voigt's solid in bending)."""

    name = "bending_damping"
    parameters = (Parameter("bending_damping", 0.0, 0.0, 10.0, "N m^2 s", "moment per rate of curvature"),)
    law = moment
    effect = Effect(
        name="bending_damping",
        says="its bending dies out by itself",
        amplitudes=("bending_damping",),
        typical={"bending_damping": 1e-5},
        motion="let it swing or quiver after a quick move",
    )

    @staticmethod
    def twin(kappa, rate, natural, span, bending_damping):
        """The same law in numpy."""
        import numpy as np

        return bending_damping * rate / span * np.array([1.0, 1.0, 0.0])
