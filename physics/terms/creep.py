"""Springs that give way under any load, slowly, and keep what they gave."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .stages import StrandTerm

__all__ = ["Creep"]


@wp.func
def tension(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any, o: int):
    return -stiffness * q


@wp.func
def flow(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any, o: int):
    return q + (length / rest - type(length)(1.0) - q) * settled(p[o] * dt)


class Creep(StrandTerm):
    """F = -Y q beside the elastic Y e, e = l / L0 - 1: q is the strain that has crept, q' = r (e - q).

    Maxwell's fluid: under a constant load strain grows steadily, held still the force falls as exp(-r t), and there is no threshold.
    q' is integrated exactly while e holds still.
    """

    name = "creep"
    parameters = (
        Parameter("creep_rate", 0.0, 0.0, 20.0, "1/s", "share of its elastic strain that a spring turns into rest length in a second"),
    )
    law = tension
    evolve = flow
    effect = Effect(
        name="creep",
        says="it gives way slowly under any load, and keeps what it gave",
        amplitudes=("creep_rate",),
        typical={"creep_rate": 1.0},
        motion="hold it stretched or bent, briefly and for long, and let go: what is left grows with the time that it was held",
    )

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, creep_rate):
        """The same law in numpy."""
        return -stiffness * q

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, creep_rate):
        """The same memory in numpy."""
        import numpy as np

        e = length / rest - 1
        return e + (q - e) * np.exp(-creep_rate * dt)
