"""Uniform gravity."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import BodyTerm

__all__ = ["Gravity"]


@wp.func
def weight(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    g = type(x)()
    g[0] = p[o]
    g[1] = p[o + 1]
    g[2] = p[o + 2]
    return g * m


class Gravity(BodyTerm):
    """F = m g. The vector is the recording's own: PhysTwin's world has +z into the table, so (0, 0, 9.8)."""

    name = "gravity"
    parameters = tuple(
        Parameter(f"gravity_{axis}", value, -20.0, 20.0, "m/s^2", f"gravitational acceleration along {axis}")
        for axis, value in (("x", 0.0), ("y", 0.0), ("z", 9.8))
    )
    law = weight

    @staticmethod
    def twin(x, v, home, m, gravity_x, gravity_y, gravity_z):
        """The same law in numpy."""
        import numpy as np

        return m * np.array([gravity_x, gravity_y, gravity_z])
