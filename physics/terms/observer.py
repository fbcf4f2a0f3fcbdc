"""Nudging: a simulation that is pulled softly towards what was seen, so that it stays near the recording and its errors stay small."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import ObserverTerm

__all__ = ["Observer"]

DAMPING = wp.constant(0.7)  # damping ratio of the pull: it settles without ringing


@wp.func
def nudge(x: Any, v: Any, home: Any, y: Any, u: Any, m: Any, p: Any, o: int):
    w = type(m)(wp.static(2.0 * 3.141592653589793)) * p[o]
    return m * (w * w * (y - x) + type(m)(2.0) * type(m)(DAMPING) * w * (u - v))


class Observer(ObserverTerm):
    """F = m (w^2 (y - x) + 2 z w (u - v)) with w = 2 pi f, z = 0.7: a Luenberger observer of bandwidth f.

    y and u are the position and velocity at which the particle was seen (``System.seen``); at 0 Hz the simulation runs free.
    """

    name = "observer"
    parameters = (Parameter("observer_bandwidth", 0.0, 0.0, 20.0, "Hz", "how fast the simulation is drawn to what was seen"),)
    law = nudge

    @staticmethod
    def twin(x, v, home, y, u, m, observer_bandwidth):
        """The same law in numpy."""
        import numpy as np

        w = 2 * np.pi * observer_bandwidth
        return m * (w * w * (y - x) + 2 * 0.7 * w * (u - v))
