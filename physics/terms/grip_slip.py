"""A hand that does not hold fast: the body slides out of its grip while it is pulled hard."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .stages import StrandTerm

__all__ = ["GripSlip"]

LEAST = wp.constant(1.0e-6)  # N: a softer spring never pulls hard enough to slip


@wp.func
def tension(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any, o: int):
    return -stiffness * q


@wp.func
def slip(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any, o: int):
    held = p[o + 1] / wp.max(stiffness, type(stiffness)(LEAST))
    beyond = wp.max(length / rest - type(length)(1.0) - q - held, type(length)(0.0))
    return q + link * beyond * settled(p[o] * dt)


class GripSlip(StrandTerm):
    """F = -Y q on springs that tie a controller, q' = r max(0, (e - q) - F_s / Y), e = l / L0 - 1: they creep longer above F_s and stay so.

    Bingham's slider with a viscous rate; q' is integrated exactly while e holds still. The body's own springs and grips are left alone.
    """

    name = "grip_slip"
    parameters = (
        Parameter("slip_rate", 0.0, 0.0, 200.0, "1/s", "rate at which tension beyond the threshold is given way to"),
        Parameter("slip_force", 1.0, 0.01, 1e4, "N", "tension of one spring to the hand at which it begins to slip", scale="log"),
    )
    law = tension
    evolve = slip
    effect = Effect(
        name="grip_slip",
        says="it slides out of the hand when pulled hard",
        amplitudes=("slip_rate",),
        typical={"slip_rate": 20.0},
        shapes={"slip_force": (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)},
        motion="pull hard, and go back: what slipped does not return",
    )

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, slip_rate, slip_force):
        """The same law in numpy."""
        return -stiffness * q

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, slip_rate, slip_force):
        """The same memory in numpy."""
        import numpy as np

        beyond = max(0.0, length / rest - 1 - q - slip_force / max(stiffness, 1e-6))
        return q - link * beyond * np.expm1(-slip_rate * dt)
