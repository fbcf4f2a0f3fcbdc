"""Gravity that does not point where the recording says."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect, Term

__all__ = ["GravityTilt"]


@wp.func
def lean(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    g = type(x)()
    g[0] = p[o]
    g[1] = p[o + 1]
    g[2] = p[o + 2]
    return g * m


class GravityTilt(Term):
    """F = m t: a uniform acceleration on top of the recording's own gravity g, which so is g + t, of another direction or size."""

    name = "gravity_tilt"
    stage = "body"
    parameters = tuple(
        Parameter(f"tilt_{axis}", 0.0, -20.0, 20.0, "m/s^2", f"acceleration added to gravity along {axis}") for axis in "xyz"
    )
    law = lean
    effect = Effect(
        "gravity_tilt",
        "gravity points another way than the recording says",
        amplitudes=("tilt_x", "tilt_y", "tilt_z"),
        typical={"tilt_x": 0.7, "tilt_y": 0.4, "tilt_z": 0.1},
        motion="free hanging in two poses, or a fall",
    )

    @staticmethod
    def twin(x, v, home, m, tilt_x, tilt_y, tilt_z):
        """The same law in numpy."""
        import numpy as np

        return m * np.array([tilt_x, tilt_y, tilt_z])
