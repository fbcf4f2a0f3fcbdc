"""Gravity that does not point where the recording says."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import BodyTerm

__all__ = ["GravityTilt"]

STEEPEST = 0.99  # sine of the largest tilt


@wp.func
def lean(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    t = type(x)()
    told = type(x)()
    t[0] = p[o]
    t[1] = p[o + 1]
    t[2] = p[o + 2]
    told[0] = p[o + 3]
    told[1] = p[o + 4]
    told[2] = p[o + 5]
    size = wp.length(told)
    if size > type(m)(0.0):
        down = told / size
        t = t - down * wp.dot(down, t)
        across = wp.dot(t, t)
        most = type(m)(wp.static(STEEPEST)) * size
        if across > most * most:
            t = t * (most / wp.sqrt(across))
            across = most * most
        t = t + down * (wp.sqrt(size * size - across) - size)
    return t * m


class GravityTilt(BodyTerm):
    """F = m (g' - g) of a gravity g' as strong as the told g: across g it has the acceleration t, along it sqrt(g^2 - t^2).

    What t has along g means nothing. Where no gravity is told, F = m t.
    """

    name = "gravity_tilt"
    parameters = (
        *(Parameter(f"tilt_{axis}", 0.0, -20.0, 20.0, "m/s^2", f"gravity across the one that is told, along {axis}") for axis in "xyz"),
        *(Parameter(f"told_gravity_{axis}", 0.0, -30.0, 30.0, "m/s^2", f"gravity as it is told, along {axis}") for axis in "xyz"),
    )
    law = lean
    loads = ("tilt_x", "tilt_y", "tilt_z")
    effect = Effect(
        "gravity_tilt",
        "gravity points another way than the recording says",
        amplitudes=("tilt_x", "tilt_y", "tilt_z"),
        typical={"tilt_x": 0.7, "tilt_y": 0.4, "tilt_z": 0.1},
        motion="free hanging in two poses, or a fall",
    )

    @staticmethod
    def twin(x, v, home, m, tilt_x, tilt_y, tilt_z, told_gravity_x, told_gravity_y, told_gravity_z):
        """The same law in numpy."""
        import numpy as np

        t, told = np.array([tilt_x, tilt_y, tilt_z]), np.array([told_gravity_x, told_gravity_y, told_gravity_z])
        size = np.linalg.norm(told)
        if size > 0:
            down = told / size
            t = t - down * (down @ t)
            t = t * min(1.0, STEEPEST * size / max(np.linalg.norm(t), 1e-300))
            t = t + down * (np.sqrt(size**2 - t @ t) - size)
        return m * t
