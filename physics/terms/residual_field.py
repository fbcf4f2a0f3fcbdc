"""A force that no law names: linear in where a particle belongs, where it is and how it moves. A yardstick, not an explanation."""

from itertools import product
from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import BodyTerm

__all__ = ["INPUTS", "ResidualField"]

INPUTS = ("one", "home_x", "home_y", "home_z", "x", "y", "z", "v_x", "v_y", "v_z")
UNITS = {"one": "m/s^2", "v_x": "1/s", "v_y": "1/s", "v_z": "1/s"}


@wp.func
def push(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    return type(x)(
        m * (p[o] + p[o + 1] * home[0] + p[o + 2] * home[1] + p[o + 3] * home[2]
             + p[o + 4] * x[0] + p[o + 5] * x[1] + p[o + 6] * x[2] + p[o + 7] * v[0] + p[o + 8] * v[1] + p[o + 9] * v[2]),
        m * (p[o + 10] + p[o + 11] * home[0] + p[o + 12] * home[1] + p[o + 13] * home[2]
             + p[o + 14] * x[0] + p[o + 15] * x[1] + p[o + 16] * x[2] + p[o + 17] * v[0] + p[o + 18] * v[1] + p[o + 19] * v[2]),
        m * (p[o + 20] + p[o + 21] * home[0] + p[o + 22] * home[1] + p[o + 23] * home[2]
             + p[o + 24] * x[0] + p[o + 25] * x[1] + p[o + 26] * x[2] + p[o + 27] * v[0] + p[o + 28] * v[1] + p[o + 29] * v[2]),
    )  # fmt: skip


class ResidualField(BodyTerm):
    """F = m R (1, home, x, v), R a matrix (3, 10): the learned correction that a named effect is measured against.

    What is missing and yet has no name in the catalogue shows here: an energy source, a moving frame, a spring to nowhere.
    """

    name = "residual_field"
    parameters = tuple(
        Parameter(f"residual_{axis}_{given}", 0.0, -1000.0, 1000.0, UNITS.get(given, "1/s^2"), f"force per mass along {axis} by {given}")
        for axis, given in product("xyz", INPUTS)
    )
    law = push

    @staticmethod
    def twin(x, v, home, m, *values):
        """The same law in numpy."""
        import numpy as np

        return m * np.reshape(values, (3, len(INPUTS))) @ np.concatenate([[1.0], home, x, v])
