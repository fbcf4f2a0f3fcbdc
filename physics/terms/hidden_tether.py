"""A thread that ties a patch of the body to a point of the room, and that the recording does not list."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .places import bell, bell_twin, coordinates, near
from .stages import BodyTerm

__all__ = ["HiddenTether"]


@wp.func
def tug(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    anchor = type(x)()
    anchor[0] = p[o + 5]
    anchor[1] = p[o + 6]
    anchor[2] = p[o + 7]
    way = anchor - x
    one = type(m)(1.0)
    taut = one - p[o + 8] / wp.max(wp.length(way), p[o + 8])  # 0 while it is slack
    return way * (m * p[o] * taut * bell(home, p, o + 1))


class HiddenTether(BodyTerm):
    """F = m k w (1 - L / |y - x|) (y - x) where |y - x| > L, else 0: elastic cords of length L from a patch to an anchor y.

    w = exp(-|home - c|^2 / (2 r^2)) is the share that a particle has in the patch.
    """

    name = "hidden_tether"
    parameters = (
        Parameter("hidden_tether", 0.0, 0.0, 10000.0, "1/s^2", "pull per mass and metre in the middle of the patch"),
        *near("tether", "tether_within"),
        *coordinates("tether_anchor", "where in the room the tether is tied"),
        Parameter("tether_length", 1e-3, 1e-4, 10.0, "m", "distance up to which the tether is slack", "log"),
    )
    law = tug
    loads = ("hidden_tether",)
    effect = Effect(
        "hidden_tether",
        "something ties a part of the body to a fixed point",
        amplitudes=("hidden_tether",),
        typical={"hidden_tether": 50.0},
        shapes={"tether_within": (0.03,), "tether_length": (1e-3, 0.03)},
        place="tether",
        within="tether_within",
        motion="pulling it away in three directions",
    )

    @staticmethod
    def twin(x, v, home, m, *values):
        """The same law in numpy."""
        import numpy as np

        stiffness, place, within, anchor, length = values[0], values[1:4], values[4], values[5:8], values[8]
        way = np.array(anchor) - x
        taut = 1 - length / max(np.linalg.norm(way), length)
        return way * (m * stiffness * taut * bell_twin(home, place, within))
