"""A table that holds on to what lies on it."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import BodyTerm

__all__ = ["GroundAdhesion"]


@wp.func
def stick(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    n = type(x)()
    n[0] = p[o + 2]
    n[1] = p[o + 3]
    n[2] = p[o + 4]
    far = (wp.dot(n, x) - p[o + 5]) / p[o + 1]
    near = wp.max(type(m)(0.0), type(m)(1.0) - far * far)
    return n * (-m * p[o] * near * near)


class GroundAdhesion(BodyTerm):
    """F = -m a (1 - h^2 / r^2)^2 n for |h| < r, h = n . x - offset: a pull towards a plane that fades out smoothly within a reach.

    It takes a force of m a to lift a particle, and the work 8 m a r / 15. Below the plane it fades as well, so that what has sunk in can
    come out. A traction-separation law as of cohesive zones (Needleman), of compact support. The plane is the ground's.
    """

    name = "ground_adhesion"
    parameters = (
        Parameter("ground_adhesion", 0.0, 0.0, 100.0, "m/s^2", "pull per mass on a particle that lies on the ground"),
        Parameter("adhesion_reach", 0.01, 1e-3, 0.5, "m", "height at which the pull has vanished", "log"),
        Parameter("adhesion_normal_x", 0.0, -1.0, 1.0, "-", "ground normal, x"),
        Parameter("adhesion_normal_y", 0.0, -1.0, 1.0, "-", "ground normal, y"),
        Parameter("adhesion_normal_z", -1.0, -1.0, 1.0, "-", "ground normal, z"),
        Parameter("adhesion_offset", 0.0, -10.0, 10.0, "m", "distance of the plane from the origin along its normal"),
    )
    law = stick
    effect = Effect(
        "ground_adhesion",
        "the ground holds on to what lies on it",
        amplitudes=("ground_adhesion",),
        typical={"ground_adhesion": 5.0},
        shapes={"adhesion_reach": (0.01, 0.04)},
        motion="peeling it off the table, slowly and upwards",
    )

    @staticmethod
    def twin(x, v, home, m, ground_adhesion, adhesion_reach, adhesion_normal_x, adhesion_normal_y, adhesion_normal_z, adhesion_offset):
        """The same law in numpy."""
        import numpy as np

        n = np.array([adhesion_normal_x, adhesion_normal_y, adhesion_normal_z])
        far = (n @ x - adhesion_offset) / adhesion_reach
        return n * (-m * ground_adhesion * max(0.0, 1 - far * far) ** 2)
