"""Drag that grows with the square of the speed, as in air at high Reynolds number."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import VelocityTerm

__all__ = ["QuadraticDrag"]


@wp.func
def resist(v: Any, dt: Any, p: Any, o: int):
    return v / (type(dt)(1.0) + p[o] * dt * wp.length(v))


class QuadraticDrag(VelocityTerm):
    """v <- v / (1 + c dt |v|): exact for dv/dt = -c |v| v, applied after the forces.

    As a force, -c |v| v would turn a particle around where c dt |v| > 1; this only ever slows it. Rayleigh's drag equation,
    F = rho C_d A |v| v / 2, has c = rho C_d A / (2 m): about 3 1/m for light cloth moving face-on, 0.1 1/m for a rope.
    """

    name = "quadratic_drag"
    parameters = (Parameter("quadratic_drag", 0.0, 0.0, 1000.0, "1/m", "share of its speed that a particle loses per metre of way"),)
    law = resist
    effect = Effect(
        "quadratic_drag",
        "air resists in proportion to the square of the speed",
        amplitudes=("quadratic_drag",),
        typical={"quadratic_drag": 0.5},
        motion="the same swing at two speeds, one twice the other",
    )

    @staticmethod
    def twin(v, dt, quadratic_drag):
        """The same law in numpy."""
        import numpy as np

        return v / (1 + quadratic_drag * dt * np.linalg.norm(v))
