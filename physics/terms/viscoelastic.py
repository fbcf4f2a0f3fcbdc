"""A Maxwell branch beside every spring: stiffer when moved fast, and its extra force fades while the strain is held."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .stages import StrandTerm

__all__ = ["Viscoelastic"]


@wp.func
def tension(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any, o: int):
    return p[o] * stiffness * (length / rest - type(length)(1.0) - q)


@wp.func
def relax(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any, o: int):
    return q + (length / rest - type(length)(1.0) - q) * settled(dt / p[o + 1])


class Viscoelastic(StrandTerm):
    """F = a Y (e - q), q' = (e - q) / tau, e = l / L0 - 1: with the elastic Y e the standard linear solid of Zener.

    q, the strain of the branch's dashpot, is integrated exactly while e holds still.
    """

    name = "viscoelastic"
    parameters = (
        Parameter("branch_stiffness", 0.0, 0.0, 20.0, "-", "stiffness of the Maxwell branch as a share of the spring's own"),
        Parameter("relaxation_time", 0.1, 0.01, 10.0, "s", "time in which the branch's force falls to 1/e", scale="log"),
    )
    law = tension
    evolve = relax
    effect = Effect(
        name="viscoelastic",
        says="it is stiffer when moved fast, and its force fades while it is held",
        amplitudes=("branch_stiffness",),
        typical={"branch_stiffness": 2.0},
        shapes={"relaxation_time": (0.02, 0.05, 0.15, 0.5, 1.5, 5.0)},
        motion="pull fast and hold still, and shake it slowly and quickly: the lag is largest at one period over 2 pi",
    )

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, branch_stiffness, relaxation_time):
        """The same law in numpy."""
        return branch_stiffness * stiffness * (length / rest - 1 - q)

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, branch_stiffness, relaxation_time):
        """The same memory in numpy."""
        import numpy as np

        e = length / rest - 1
        return e + (q - e) * np.exp(-dt / relaxation_time)
