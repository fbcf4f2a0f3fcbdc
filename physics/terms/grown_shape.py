"""A solid that was under strain already when the recording began."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import GrowthTerm

__all__ = ["GrownShape"]


@wp.func
def growth(at: Any, p: Any, o: int):
    one = type(p[o])(1.0)
    grown = wp.exp(p[o] + p[o + 1] * at[0] + p[o + 2] * at[1] + p[o + 3] * at[2]) - one
    return wp.diag(type(at)(grown, grown, grown))


class GrownShape(GrowthTerm):
    """G = exp(s + g . u) 1: a body wants to be larger by G than it was in frame 0, or smaller.

    u is the place in the body, from its middle in rms radii, along the grid's axes. s is a uniform swelling, and g one that grows across
    the body: a beam of radius R whose layers differ so much bends to a curvature of g / R. See ``physics.materials``.
    """

    name = "grown_shape"
    parameters = (
        Parameter("growth", 0.0, -0.5, 0.5, "-", "log-strain by which the rest shape exceeds that of frame 0"),
        *(Parameter(f"growth_{axis}", 0.0, -0.5, 0.5, "-", f"its growth over one radius of the body along axis {axis}") for axis in "abc"),
    )
    law = growth
    effect = Effect(
        "rest_shape",
        "the body was not at rest in its first shape",
        amplitudes=("growth", "growth_a", "growth_b", "growth_c"),
        typical={"growth": 0.02, "growth_a": 0.02, "growth_b": 0.01, "growth_c": 0.01},
        motion="rest in two poses",
    )

    @staticmethod
    def twin(at, growth, growth_a, growth_b, growth_c):
        """The same law in numpy."""
        grown = np.exp(growth + at @ np.array([growth_a, growth_b, growth_c])) - 1
        return np.asarray(grown)[..., None, None] * np.eye(3)
