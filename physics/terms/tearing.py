"""Springs around a place that tear when they are stretched too far, and do not heal."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .places import bell, bell_twin, near
from .stages import StrandTerm

__all__ = ["Tearing"]


@wp.func
def tension(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any, o: int):
    return -stiffness * (length / rest - type(length)(1.0)) * q


@wp.func
def tear(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any, o: int):
    one = type(length)(1.0)
    beyond = (length / rest - one - p[o + 1]) / p[o + 1]
    if beyond <= type(length)(0.0):
        return q
    return q + (one - q) * settled(p[o] * bell(middle, p, o + 2) * beyond * dt)


class Tearing(StrandTerm):
    """F = -q Y e beside the elastic Y e, e = l / L0 - 1: q in [0, 1] is the damage, q' = r w (1 - q) max(0, e - e_c) / e_c.

    w = exp(-d^2 / (2 R^2)) of the distance d, in frame 0, of the spring's middle from the place. Kachanov's damage variable with a linear
    overstrain; q' is integrated exactly while e holds still. Only the elastic force is torn, not a dashpot's.
    """

    name = "tearing"
    parameters = (
        Parameter("tear_rate", 0.0, 0.0, 1000.0, "1/s", "rate of damage at twice the tear strain"),
        Parameter("tear_strain", 0.03, 0.001, 2.0, "-", "strain at which tearing begins", scale="log"),
        *near("tear", "tear_radius"),
    )
    law = tension
    evolve = tear
    effect = Effect(
        name="tearing",
        says="it tears at one place when it is stretched too far",
        amplitudes=("tear_rate",),
        typical={"tear_rate": 20.0},
        shapes={"tear_strain": (0.02, 0.08), "tear_radius": (0.02, 0.05)},
        place="tear",
        within="tear_radius",
        motion="pull it apart harder and harder, and then once more: what tore stays loose",
    )

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, tear_rate, tear_strain, tear_x, tear_y, tear_z, tear_radius):
        """The same law in numpy."""
        return -q * stiffness * (length / rest - 1)

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, tear_rate, tear_strain, tear_x, tear_y, tear_z, tear_radius):
        """The same memory in numpy."""
        import numpy as np

        beyond = max(0.0, (length / rest - 1 - tear_strain) / tear_strain)
        w = bell_twin(middle, (tear_x, tear_y, tear_z), tear_radius)
        return 1 - (1 - q) * np.exp(-tear_rate * w * beyond * dt)
