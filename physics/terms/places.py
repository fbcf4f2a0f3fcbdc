"""Where on a body, or in the room, a term acts."""

from typing import Any

import warp as wp

from ..parameters import Parameter

__all__ = ["bell", "bell_twin", "coordinates", "near"]

FAR = 10.0  # m: no place in a recording's world is farther from its origin along an axis


def coordinates(prefix: str, meaning: str) -> tuple[Parameter, ...]:
    """Three parameters ``<prefix>_x, _y, _z`` [m]."""
    return tuple(Parameter(f"{prefix}_{axis}", 0.0, -FAR, FAR, "m", f"{meaning}, {axis}") for axis in "xyz")


def near(prefix: str, within: str) -> tuple[Parameter, ...]:
    """A patch of the body, for ``bell``: its middle in frame 0, and how far it reaches."""
    return *coordinates(prefix, "middle of the patch in frame 0"), Parameter(within, 0.05, 1e-3, 10.0, "m", "reach of the patch", "log")


@wp.func
def bell(home: Any, p: Any, o: int):
    """exp(-|home - c|^2 / (2 r^2)), c = p[o..o+2], r = p[o+3]: 1 in the middle of a patch, 0.14 at twice its reach."""
    apart = type(home)()
    apart[0] = home[0] - p[o]
    apart[1] = home[1] - p[o + 1]
    apart[2] = home[2] - p[o + 2]
    return wp.exp(-wp.dot(apart, apart) / (p[o + 3] * p[o + 3] + p[o + 3] * p[o + 3]))


def bell_twin(home, place, within):
    """The same in numpy, of ``home`` (..., 3)."""
    import numpy as np

    apart = home - np.asarray(place)
    return np.exp(-(apart * apart).sum(-1) / (2 * within**2))
