"""Drag of sheets: air resists what moves face-on, and lets pass what moves edge-on."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import FacetTerm

__all__ = ["PlateDrag"]

EDGE = 1e-12  # m^2: a facet of no area has no face


@wp.func
def resist(area: Any, v: Any, m: Any, swell: Any, dt: Any, p: Any, o: int):
    size = wp.max(wp.length(area), type(m)(wp.static(EDGE)))
    n = area / size
    across = wp.dot(v, n)
    rate = p[o] * size * wp.abs(across)
    return n * (-rate * across / (type(m)(1.0) + rate * dt / m))


class PlateDrag(FacetTerm):
    """F = -c A |v.n| (v.n) n on every facet of area A and normal n, whichever side is in front.

    Rayleigh's drag equation for the part of the wind that meets a plate has c = rho C_d / 2, 0.7 kg/m^3 in air: cloth of 0.25 kg/m^2 that
    moves face-on loses 2.8 of its speed per metre of way. Over 1 + c A |v.n| dt / m, m being the facet's mass, so that a substep only ever
    slows it, as ``quadratic_drag`` does.
    """

    name = "plate_drag"
    parameters = (Parameter("plate_drag", 0.0, 0.0, 1e6, "kg/m^3", "half the air's density times the drag coefficient of a plate"),)
    law = resist
    effect = Effect(
        "plate_drag",
        "air resists what moves face-on",
        amplitudes=("plate_drag",),
        typical={"plate_drag": 10.0},
        motion="the same fast swing edge-on and face-on",
    )

    @staticmethod
    def twin(area, v, m, swell, dt, plate_drag):
        """The same law in numpy."""
        import numpy as np

        size = max(np.linalg.norm(area), EDGE)
        n = area / size
        rate = plate_drag * size * abs(v @ n)
        return -rate * (v @ n) / (1 + rate * dt / m) * n
