"""Springs that yield: stretched or squeezed too far they flow, and keep part of the strain when they are let go."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .stages import StrandTerm

__all__ = ["Plasticity"]


@wp.func
def tension(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any, o: int):
    return -stiffness * q


@wp.func
def flow(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any, o: int):
    elastic = length / rest - type(length)(1.0) - q
    return q + (elastic - wp.clamp(elastic, -p[o + 1], p[o + 1])) * settled(p[o] * dt)


class Plasticity(StrandTerm):
    """F = -Y q beside the elastic Y e, e = l / L0 - 1: q is the plastic strain, q' = r sgn(e - q) max(0, |e - q| - e_Y).

    Perzyna's overstress law in one dimension with a linear overstress, without hardening; q' is integrated exactly while e holds still.
    """

    name = "plasticity"
    parameters = (
        Parameter("plastic_rate", 0.0, 0.0, 200.0, "1/s", "rate at which strain beyond the yield strain turns plastic"),
        Parameter("yield_strain", 0.01, 0.001, 1.0, "-", "elastic strain at which flow begins", scale="log"),
    )
    law = tension
    evolve = flow
    effect = Effect(
        name="plasticity",
        says="it keeps part of a deformation that went too far",
        amplitudes=("plastic_rate",),
        typical={"plastic_rate": 20.0},
        shapes={"yield_strain": (0.003, 0.01, 0.03, 0.1, 0.3)},
        motion="stretch or bend it far, let go and wait: what is left did not depend on how long it was held",
    )

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, plastic_rate, yield_strain):
        """The same law in numpy."""
        return -stiffness * q

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, plastic_rate, yield_strain):
        """The same memory in numpy."""
        import numpy as np

        elastic = length / rest - 1 - q
        return q - np.sign(elastic) * max(0.0, abs(elastic) - yield_strain) * np.expm1(-plastic_rate * dt)
