"""A rope that takes a set: bent too far it keeps part of the bend when it is let go."""

from ..parameters import Parameter
from .base import Effect
from .sheet_yielding import SheetYielding, flow
from .stages import HingeFlowTerm

__all__ = ["RopeYielding"]


class RopeYielding(HingeFlowTerm):
    """q' = r (1 - e_Y / s |k|) k of the elastic curvature k, where it strains the surface, s from the middle, by more than e_Y.

    ``sheet_yielding`` of ropes: the whole section yields at once.
    """

    name = "rope_yielding"
    parameters = (
        Parameter("rope_yielding_rate", 0.0, 0.0, 1000.0, "1/s", "rate at which curvature beyond the yield strain turns natural"),
        Parameter("rope_yield_strain", 0.05, 5e-4, 1.0, "-", "elastic strain of the surface at which it yields", scale="log"),
        Parameter("rope_yield_surface", 5e-3, 1e-5, 0.05, "m", "distance from the middle at which curvature is strain", scale="log"),
    )
    law = flow
    effect = Effect(
        name="plasticity",
        says="it keeps part of a deformation that went too far",
        amplitudes=("rope_yielding_rate",),
        typical={"rope_yielding_rate": 20.0},
        shapes={"rope_yield_strain": (0.01, 0.04), "rope_yield_surface": (5e-3,)},
        motion="bend it far, let go and wait: what is left did not depend on how long it was held",
    )

    @staticmethod
    def twin(strain, curved, dt, rope_yielding_rate, rope_yield_strain, rope_yield_surface):
        """The same law in numpy."""
        return SheetYielding.twin(strain, curved, dt, rope_yielding_rate, rope_yield_strain, rope_yield_surface)
