"""A solid that yields: strained too far it flows, and keeps part of its shape when it is let go."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from ..strains import deviator, deviator_twin, green, green_twin, poisson, poisson_twin, relaxing, relaxing_twin, size, size_twin
from .base import Effect
from .stages import FlowTerm

__all__ = ["Yielding"]

ROUND = float(np.sqrt(2 / 3))  # of a bar: size of its strain's deviator over (1 + nu) e


@wp.func
def flow(deformed: Any, home: Any, mu: Any, lame: Any, dt: Any, p: Any, o: int):
    one = type(mu)(1.0)
    strain = green(deformed)
    limit = type(mu)(ROUND) * (one + poisson(mu, lame)) * p[o + 1]
    excess = wp.max(one - limit / size(deviator(strain)), type(mu)(0.0))
    return relaxing(strain, excess * settled(p[o] * dt))


class Yielding(FlowTerm):
    """D = r dt (1 - e_Y / e) dev E where e > e_Y, e = sqrt(3 / 2) |dev E| / (1 + nu): von Mises' stress over Young's modulus.

    J2 plasticity in strains, without hardening: a bar flows at the stress Y e_Y. E is the Green strain of F G^-1, so that what flowed stays
    without stress however far it went, at the volume that it had. The overstress fades at the rate r (Perzyna), integrated exactly while F
    holds still; r dt >> 1 is the radial return of rate-independent plasticity (Simo and Hughes 1998, sections 2.7 and 3.3).
    """

    name = "yielding"
    parameters = (
        Parameter("yielding_rate", 0.0, 0.0, 1000.0, "1/s", "rate at which strain beyond the yield strain turns plastic"),
        Parameter("solid_yield_strain", 0.05, 0.002, 1.0, "-", "elastic strain at which a bar yields", scale="log"),
    )
    law = flow
    effect = Effect(
        name="plasticity",
        says="it keeps part of a deformation that went too far",
        amplitudes=("yielding_rate",),
        typical={"yielding_rate": 20.0},
        shapes={"solid_yield_strain": (0.01, 0.03, 0.1, 0.3)},
        motion="stretch or bend it far, let go and wait: what is left did not depend on how long it was held",
    )

    @staticmethod
    def twin(deformed, home, mu, lame, dt, yielding_rate, solid_yield_strain):
        """The same law in numpy."""
        strain = green_twin(deformed)
        limit = ROUND * (1 + poisson_twin(mu, lame)) * solid_yield_strain
        excess = np.maximum(1 - limit / size_twin(deviator_twin(strain)), 0.0)
        return relaxing_twin(strain, -excess * np.expm1(-yielding_rate * dt))
