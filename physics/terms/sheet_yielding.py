"""A sheet that takes creases: strained or bent too far it keeps part of its shape when it is let go."""

import math
from typing import Any

import numpy as np
import warp as wp

from ..fabrics import size, size_twin
from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .stages import SheetFlowTerm

__all__ = ["SheetYielding"]


@wp.func
def flow(strain: Any, curved: Any, dt: Any, p: Any, o: int):
    beyond = wp.max(type(curved)(1.0) - p[o + 1] / size(strain, curved, p[o + 2]), type(curved)(0.0))
    return strain * (beyond * settled(p[o] * dt))


class SheetYielding(SheetFlowTerm):
    """q' = r (1 - e_Y / |e - q|) (e - q) beyond e_Y, of strain, and of curvature where it strains the surface so.

    |e| is von Mises' stress over Young's modulus at Poisson's ratio 1/2; J2 plasticity of sheets without hardening (Simo and Hughes 1998,
    section 3.4). The overstress fades at the rate r (Perzyna), as in ``yielding``. Of a bend all of the section yields at once, whatever
    stretches it (Ilyushin's surface joins both).
    """

    name = "sheet_yielding"
    parameters = (
        Parameter("sheet_yielding_rate", 0.0, 0.0, 1000.0, "1/s", "rate at which strain beyond the yield strain turns plastic"),
        Parameter("sheet_yield_strain", 0.02, 5e-4, 1.0, "-", "elastic strain at which a strip yields", scale="log"),
        Parameter("sheet_yield_surface", 5e-4, 1e-5, 0.02, "m", "distance from the middle at which curvature is strain", scale="log"),
    )
    law = flow
    effect = Effect(
        name="plasticity",
        says="it keeps part of a deformation that went too far",
        amplitudes=("sheet_yielding_rate",),
        typical={"sheet_yielding_rate": 20.0},
        shapes={"sheet_yield_strain": (0.003, 0.01), "sheet_yield_surface": (5e-4,)},
        motion="stretch or bend it far, let go and wait: what is left did not depend on how long it was held",
    )

    @staticmethod
    def twin(strain, curved, dt, sheet_yielding_rate, sheet_yield_strain, sheet_yield_surface):
        """The same law in numpy."""
        beyond = np.maximum(1 - sheet_yield_strain / size_twin(strain, curved, sheet_yield_surface), 0.0)
        return -strain * (beyond * math.expm1(-sheet_yielding_rate * dt))[..., None]
