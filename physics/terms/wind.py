"""Air that moves past the body."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect, Term

__all__ = ["Wind"]

CROSSOVER = 0.5  # m/s: below this speed of the air past a particle drag is linear in it, above it quadratic


@wp.func
def blow(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    w = type(x)()
    w[0] = p[o]
    w[1] = p[o + 1]
    w[2] = p[o + 2]
    u = w - v
    s = type(m)(wp.static(CROSSOVER * CROSSOVER))
    return (u * wp.sqrt(wp.dot(u, u) + s) + v * wp.sqrt(wp.dot(v, v) + s)) * (m * p[o + 3])


class Wind(Term):
    """F = m c (f(w - v) - f(-v)), f(u) = u sqrt(|u|^2 + s^2), s = 0.5 m/s: what moving air pulls more than still air.

    f is the drag equation (Rayleigh) above the speed s and linear below it, as small flows are; so the pull is linear in a light wind w.
    Still air's own drag is another term's. A particle that moves with the wind is pulled less, which tells wind from tilted gravity.
    """

    name = "wind"
    stage = "body"
    parameters = (
        *(Parameter(f"wind_{axis}", 0.0, -10.0, 10.0, "m/s", f"velocity of the air along {axis}") for axis in "xyz"),
        Parameter("wind_drag", 1.0, 0.01, 20.0, "1/m", "drag coefficient of the air that passes a particle", "log"),
    )
    law = blow
    effect = Effect(
        "wind",
        "the air moves",
        amplitudes=("wind_x", "wind_y", "wind_z"),
        typical={"wind_x": 1.0, "wind_y": 0.5, "wind_z": 0.0},
        shapes={"wind_drag": (0.3, 3.0)},
        motion="rest, then fast swings with the wind and against it",
    )

    @staticmethod
    def twin(x, v, home, m, wind_x, wind_y, wind_z, wind_drag):
        """The same law in numpy."""
        import numpy as np

        u = np.array([wind_x, wind_y, wind_z]) - v
        return (u * np.sqrt(u @ u + CROSSOVER**2) + v * np.sqrt(v @ v + CROSSOVER**2)) * (m * wind_drag)
