"""A force across the way that particles go."""

from typing import Any

import numpy as np
import warp as wp
from twinbench.physics.parameters import Parameter
from twinbench.physics.terms.base import Effect
from twinbench.physics.terms.stages import BodyTerm

__all__ = ["Swirl"]


@wp.func
def sideways(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    return type(x)(-p[o] * v[1], p[o] * v[0], type(m)(0.0))


class Swirl(BodyTerm):
    """F = c (-v_y, v_x, 0): a push across the way that a particle goes, as a spinning body has in air (Magnus)."""

    name = "swirl"
    parameters = (Parameter("swirl", 0.0, -5.0, 5.0, "N s/m", "force across the way at a speed of 1 m/s"),)
    law = sideways
    effect = Effect(
        "swirl",
        "a force pushes it across the way that it goes",
        amplitudes=("swirl",),
        typical={"swirl": 0.5},
        motion="the same swing along two directions",
    )

    @staticmethod
    def twin(x, v, home, m, swirl):
        """The same law in numpy."""
        return swirl * np.array([-v[1], v[0], 0.0])
