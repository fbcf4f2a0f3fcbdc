"""A solid that gives way under any load, slowly, and keeps what it gave."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from ..strains import deviator, deviator_twin, green, green_twin, poisson, poisson_twin, relaxing, relaxing_twin, size, size_twin
from .base import Effect
from .stages import FlowTerm

__all__ = ["NortonCreep"]

ROUND = float(np.sqrt(3 / 2))  # of a bar: (1 + nu) e over the size of its strain's deviator


@wp.func
def flow(deformed: Any, home: Any, mu: Any, lame: Any, dt: Any, p: Any, o: int):
    wide = type(mu)(1.0) + poisson(mu, lame)
    strain = green(deformed)
    load = type(mu)(ROUND) * size(deviator(strain)) / wide
    pace = p[o] * type(mu)(1.5) / wide * wp.pow(load / p[o + 2], p[o + 1] - type(mu)(1.0))
    return relaxing(strain, settled(pace * dt))


class NortonCreep(FlowTerm):
    """D = dt r (e / e_0)^(n - 1) 3 / (2 (1 + nu)) dev E, e = sqrt(3 / 2) |dev E| / (1 + nu): von Mises' stress over Young's modulus.

    Norton's power law (Lemaitre and Chaboche, "Mechanics of solid materials", 1990, section 6.4) in strains: a bar under a load that
    strains it by e creeps at e' = r e (e / e_0)^(n - 1), at constant volume. E is the Green strain of F G^-1. A substep relaxes by
    1 - exp(-x), which for n = 1 is exact while F holds still, and overshoots for no n and no dt.
    """

    name = "norton_creep"
    parameters = (
        Parameter("norton_rate", 0.0, 0.0, 20.0, "1/s", "share of its elastic strain that a bar creeps by in a second, at the strain e_0"),
        Parameter("norton_exponent", 1.0, 1.0, 8.0, "-", "n: by which power of the stress"),
        Parameter("norton_strain", 0.05, 0.002, 1.0, "-", "e_0: the elastic strain of which the rate speaks", scale="log"),
    )
    law = flow
    effect = Effect(
        name="creep",
        says="it gives way slowly under any load, and keeps what it gave",
        amplitudes=("norton_rate",),
        typical={"norton_rate": 2.0},
        shapes={"norton_exponent": (1.0, 3.0)},
        motion="hold it stretched or bent, briefly and for long, and let go: what is left grows with the time that it was held",
    )

    @staticmethod
    def twin(deformed, home, mu, lame, dt, norton_rate, norton_exponent, norton_strain):
        """The same law in numpy."""
        wide = 1 + poisson_twin(mu, lame)
        strain = green_twin(deformed)
        load = ROUND * size_twin(deviator_twin(strain)) / wide
        pace = norton_rate * 1.5 / wide * (load / norton_strain) ** (norton_exponent - 1)
        return relaxing_twin(strain, -np.expm1(-pace * dt))
