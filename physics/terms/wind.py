"""Air that moves past the body."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import BodyTerm

__all__ = ["Wind"]

CALM = 1e-3  # m/s^2: a pull below this has no direction yet, so that the law is smooth where there is no wind


@wp.func
def blow(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    q = type(x)()
    q[0] = p[o]
    q[1] = p[o + 1]
    q[2] = p[o + 2]
    calm = type(m)(wp.static(CALM))
    size = wp.sqrt(wp.dot(q, q) + calm * calm)
    u = v / p[o + 3]
    past = q / size - u
    faint = calm / size  # of no direction where there is no wind: |e|^2 + faint^2 = 1
    return (q - u * (size - calm)) * (m * wp.sqrt(wp.dot(past, past) + faint * faint))


class Wind(BodyTerm):
    """F = m |q| |e - v / W| (e - v / W), e = q / |q|: the drag equation F = m c |w - v| (w - v) (Rayleigh) with w = W e and c = |q| / W^2.

    q is the pull on a particle at rest, in which the force is linear, and W the wind's speed, at which a particle is pulled no more; for a
    fast wind the pull is as uniform as gravity. The air's resistance to motion is in the law, and goes with the wind.
    """

    name = "wind"
    parameters = (
        *(Parameter(f"wind_{axis}", 0.0, -100.0, 100.0, "m/s^2", f"pull per mass on what is at rest, {axis}") for axis in "xyz"),
        Parameter("wind_speed", 3.0, 0.2, 50.0, "m/s", "speed of the air", "log"),
    )
    law = blow
    loads = ("wind_x", "wind_y", "wind_z")
    effect = Effect(
        "wind",
        "the air moves",
        amplitudes=("wind_x", "wind_y", "wind_z"),
        typical={"wind_x": 1.0, "wind_y": 0.5, "wind_z": 0.0},
        shapes={"wind_speed": (1.0, 4.0)},
        motion="rest, then fast swings with the wind and against it",
    )

    @staticmethod
    def twin(x, v, home, m, wind_x, wind_y, wind_z, wind_speed):
        """The same law in numpy."""
        import numpy as np

        q, u = np.array([wind_x, wind_y, wind_z]), v / wind_speed
        size = np.sqrt(q @ q + CALM * CALM)
        past, faint = q / size - u, CALM / size
        return (q - u * (size - CALM)) * (m * np.sqrt(past @ past + faint * faint))
