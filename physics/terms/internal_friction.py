"""Dry friction inside the material, as between threads: it opposes every change of shape by the same force, however slow."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .stages import StrandTerm

__all__ = ["InternalFriction"]


@wp.func
def tension(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any, o: int):
    return p[o] * stiffness * q


@wp.func
def rub(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any, o: int):
    return q + (wp.sign(rate) - q) * settled(wp.abs(rate) * dt / (rest * p[o + 1]))


class InternalFriction(StrandTerm):
    """F = a Y z, z' = e' / e_h (1 - z sgn e'), e = l / L0 - 1: Dahl's solid friction, of which a Y is the most.

    z goes to +-1 over strains of e_h, whatever the rate: a closed cycle of strain takes the same work at every speed. Cloth has it (Miguel
    et al., Modeling and estimation of internal friction in cloth, SIGGRAPH Asia 2013). z' is integrated exactly while e' is constant.
    """

    name = "internal_friction"
    parameters = (
        Parameter("internal_friction", 0.0, 0.0, 1.0, "-", "largest friction of a spring, as strain at its stiffness"),
        Parameter("friction_strain", 0.01, 1e-3, 0.3, "-", "strain over which friction turns round", scale="log"),
    )
    law = tension
    evolve = rub
    effect = Effect(
        name="internal_friction",
        says="its material rubs in itself, and stays where it was bent to",
        amplitudes=("internal_friction",),
        typical={"internal_friction": 0.02},
        shapes={"friction_strain": (0.005, 0.03)},
        motion="bend or stretch it to and fro very slowly, then fast: the lag between both ways is the same",
    )

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, internal_friction, friction_strain):
        """The same law in numpy."""
        return internal_friction * stiffness * q

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, internal_friction, friction_strain):
        """The same memory in numpy."""
        import numpy as np

        return q - (np.sign(rate) - q) * np.expm1(-abs(rate) * dt / (rest * friction_strain))
