"""A thread that ties a patch of the body to a point of the room, and that the recording does not list."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect, Term
from .places import bell, bell_twin, coordinates, near

__all__ = ["HiddenTether"]


@wp.func
def tug(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    anchor = type(x)()
    anchor[0] = p[o + 5]
    anchor[1] = p[o + 6]
    anchor[2] = p[o + 7]
    return (anchor - x) * (m * p[o] * bell(home, p, o + 1))


class HiddenTether(Term):
    """F = m k w (y - x), w = exp(-|home - c|^2 / (2 r^2)): elastic cords of no rest length from a patch of the body to an anchor y."""

    name = "hidden_tether"
    stage = "body"
    parameters = (
        Parameter("hidden_tether", 0.0, 0.0, 10000.0, "1/s^2", "pull per mass and metre in the middle of the patch"),
        *near("tether", "tether_within"),
        *coordinates("tether_anchor", "where in the room the tether is tied"),
    )
    law = tug
    effect = Effect(
        "hidden_tether",
        "something ties a part of the body to a fixed point",
        amplitudes=("hidden_tether",),
        typical={"hidden_tether": 50.0},
        shapes={"tether_within": (0.02, 0.06)},
        place="tether",
        within="tether_within",
        motion="pulling it away in three directions",
    )

    @staticmethod
    def twin(x, v, home, m, hidden_tether, tether_x, tether_y, tether_z, tether_within, tether_anchor_x, tether_anchor_y, tether_anchor_z):
        """The same law in numpy."""
        import numpy as np

        share = bell_twin(home, (tether_x, tether_y, tether_z), tether_within)
        return (np.array([tether_anchor_x, tether_anchor_y, tether_anchor_z]) - x) * (m * hidden_tether * share)
