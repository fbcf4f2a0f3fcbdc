"""Hands that carry points of a body along by springs."""

from typing import Any

import warp as wp

from ..hands import is_meant, meant
from ..parameters import Parameter
from .stages import GripTerm

__all__ = ["SoftGrip"]


@wp.func
def carry(apart: Any, rate: Any, m: Any, hand: Any, p: Any, o: int):
    one = meant(p[o + 2], hand)
    w = wp.where(one, p[o], p[o + 3])
    z = wp.where(one, p[o + 1], p[o + 4])
    return (apart * w + rate * (type(m)(2.0) * z)) * (m * w)


class SoftGrip(GripTerm):
    """F = s m w (w d + 2 z d') on a point that lags d behind its hand, s the firmness with which it is held (``physics.points``).

    A hand that holds a mass M firmly is a spring of M w^2 [N/m], and of M w^2 r^2 [N m] against turning, r the radius of gyration there.
    All hands hold alike, unless one is named: then the others have a w and z of their own.
    """

    name = "soft_grip"
    parameters = (
        Parameter("grip_rate", 1000.0, 1.0, 3000.0, "1/s", "angular frequency w of a held mass", "log"),
        Parameter("grip_damping", 0.2, 0.01, 20.0, "-", "damping ratio z of that", "log"),
        Parameter("grip_hand", -1.0, -1.0, 9.0, "-", "number of the hand that holds so; -1: all do"),
        Parameter("firm_rate", 1000.0, 1.0, 3000.0, "1/s", "w of the others", "log"),
        Parameter("firm_damping", 0.2, 0.01, 20.0, "-", "z of the others", "log"),
    )
    law = carry

    @staticmethod
    def hardness(grip_rate, grip_damping, grip_hand, firm_rate, firm_damping):
        every = [(grip_rate, grip_damping), *([(firm_rate, firm_damping)] if grip_hand >= -0.5 else [])]
        return max(w**2 for w, _ in every), max(2 * z * w for w, z in every)

    @staticmethod
    def twin(apart, rate, m, hand, grip_rate, grip_damping, grip_hand, firm_rate, firm_damping):
        """The same law in numpy."""
        w, z = (grip_rate, grip_damping) if is_meant(grip_hand, hand) else (firm_rate, firm_damping)
        return m * w * (w * apart + 2 * z * rate)
