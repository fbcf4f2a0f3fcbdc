"""A Maxwell branch beside a solid's elasticity: stiffer when moved fast, and its extra stress fades while the strain is held."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from ..strains import green, green_twin, hooke, hooke_twin
from .base import Effect
from .stages import BranchTerm

__all__ = ["Maxwell"]


@wp.func
def stress(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, p: Any, o: int):
    return deformed * (hooke(green(deformed) - q, mu, lame) * p[o])


@wp.func
def relax(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, dt: Any, p: Any, o: int):
    return q + (green(deformed) - q) * settled(dt / p[o + 1])


class Maxwell(BranchTerm):
    """P = a F (C : (E - q)), q' = (E - q) / tau, with the Green strain E and the elasticity's own moduli C: Zener's solid.

    Finite linear viscoelasticity in the cheap form for moderate strains, in which the branch is linear in E (Simo and Hughes,
    "Computational inelasticity", 1998, section 10.2). q, the strain of the branch's dashpot, is integrated exactly while E holds still.
    """

    name = "maxwell"
    parameters = (
        Parameter("maxwell_share", 0.0, 0.0, 20.0, "-", "stiffness of the Maxwell branch as a share of the elasticity's"),
        Parameter("maxwell_time", 0.1, 0.005, 10.0, "s", "time in which the branch's stress falls to 1/e", scale="log"),
    )
    law = stress
    evolve = relax
    effect = Effect(
        name="viscoelastic",
        says="it is stiffer when moved fast, and its force fades while it is held",
        amplitudes=("maxwell_share",),
        typical={"maxwell_share": 1.0},
        shapes={"maxwell_time": (0.02, 0.05, 0.15, 0.5, 1.5, 5.0)},
        motion="pull fast and hold still, and shake it slowly and quickly: the lag is largest at one period over 2 pi",
    )

    @staticmethod
    def twin(stress, deformed, rate, home, mu, lame, q, maxwell_share, maxwell_time):
        """The same law in numpy."""
        return deformed @ hooke_twin(green_twin(deformed) - q, mu, lame) * maxwell_share

    @staticmethod
    def twin_evolve(stress, deformed, rate, home, mu, lame, q, dt, maxwell_share, maxwell_time):
        """The same memory in numpy."""
        strain = green_twin(deformed)
        return strain + (q - strain) * np.exp(-dt / maxwell_time)
