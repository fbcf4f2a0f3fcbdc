"""Dry friction inside a solid: it opposes every change of shape by the same stress, however slow."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from ..strains import hooke, hooke_twin
from .base import Effect
from .stages import BranchTerm

__all__ = ["DahlFriction"]

STILL = 1e-6  # 1/s: a rate of strain that counts as none, where a direction has no derivative


@wp.func
def stress(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, p: Any, o: int):
    return deformed * (hooke(q, mu, lame) * p[o])


@wp.func
def rub(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, dt: Any, p: Any, o: int):
    mixed = wp.transpose(deformed) * rate
    moving = (mixed + wp.transpose(mixed)) * type(mu)(0.5)
    pace = wp.sqrt(wp.ddot(moving, moving) + type(mu)(STILL * STILL))
    return q + (moving * (type(mu)(1.0) / pace) - q) * settled(pace * dt / p[o + 1])


class DahlFriction(BranchTerm):
    """P = a F (C : z), z' = (E' - |E'| z) / e_h, with the Green strain E and the elasticity's own moduli C: Dahl's solid friction.

    z goes to the direction of E', of size 1, over strains of e_h, whatever the rate: a closed cycle of strain takes the same work at every
    speed, and none gives any, as z : C : E' = (e_h z : C : z / 2)' + |E'| z : C : z. Dahl 1968; in cloth, Miguel et al., SIGGRAPH Asia
    2013. z' is integrated exactly while E' is constant.
    """

    name = "dahl_friction"
    parameters = (
        Parameter("dahl_friction", 0.0, 0.0, 1.0, "-", "largest friction, as strain at the elasticity's stiffness"),
        Parameter("dahl_strain", 0.02, 1e-3, 0.5, "-", "strain over which friction turns round", scale="log"),
    )
    law = stress
    evolve = rub
    effect = Effect(
        name="internal_friction",
        says="its material rubs in itself, and stays where it was bent to",
        amplitudes=("dahl_friction",),
        typical={"dahl_friction": 0.02},
        shapes={"dahl_strain": (0.01, 0.05)},
        motion="bend or stretch it to and fro very slowly, then fast: the lag between both ways is the same",
    )

    @staticmethod
    def twin(stress, deformed, rate, home, mu, lame, q, dahl_friction, dahl_strain):
        """The same law in numpy."""
        return deformed @ hooke_twin(q, mu, lame) * dahl_friction

    @staticmethod
    def twin_evolve(stress, deformed, rate, home, mu, lame, q, dt, dahl_friction, dahl_strain):
        """The same memory in numpy."""
        mixed = np.swapaxes(deformed, -1, -2) @ rate
        moving = (mixed + np.swapaxes(mixed, -1, -2)) / 2
        pace = np.sqrt((moving * moving).sum((-1, -2), keepdims=True) + STILL**2)
        return q - (moving / pace - q) * np.expm1(-pace * dt / dahl_strain)
