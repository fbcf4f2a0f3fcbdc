"""Hands that carry points of a body along by springs."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import GripTerm

__all__ = ["SoftGrip"]


@wp.func
def carry(apart: Any, rate: Any, m: Any, p: Any, o: int):
    return (apart * p[o] + rate * (type(m)(2.0) * p[o + 1])) * (m * p[o])


class SoftGrip(GripTerm):
    """F = s m w (w d + 2 z d') on a point that lags d behind its hand, s the firmness with which it is held (``physics.points``).

    A hand that holds a mass M firmly is a spring of M w^2 [N/m], and of M w^2 r^2 [N m] against turning, r the radius of gyration there.
    """

    name = "soft_grip"
    parameters = (
        Parameter("grip_rate", 1000.0, 1.0, 3000.0, "1/s", "angular frequency w of a held mass", "log"),
        Parameter("grip_damping", 0.2, 0.01, 20.0, "-", "damping ratio z of that", "log"),
    )
    law = carry

    @staticmethod
    def hardness(grip_rate, grip_damping):
        return grip_rate**2, 2 * grip_damping * grip_rate

    @staticmethod
    def twin(apart, rate, m, grip_rate, grip_damping):
        """The same law in numpy."""
        return m * grip_rate * (grip_rate * apart + 2 * grip_damping * rate)
