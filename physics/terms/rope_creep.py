"""A rope that keeps the bends in which it was held, the more the longer."""

from ..parameters import Parameter
from .base import Effect
from .sheet_creep import SheetCreep, flow
from .stages import HingeFlowTerm

__all__ = ["RopeCreep"]


class RopeCreep(HingeFlowTerm):
    """q' = r (k - k_0 - q), of the curvature beyond the natural one: ``sheet_creep`` of ropes."""

    name = "rope_creep"
    parameters = (Parameter("rope_creep_rate", 0.0, 0.0, 20.0, "1/s", "rate at which elastic curvature becomes natural"),)
    law = flow
    effect = Effect(
        name="creep",
        says="it gives way slowly under any load, and keeps what it gave",
        amplitudes=("rope_creep_rate",),
        typical={"rope_creep_rate": 0.5},
        motion="hold it bent, briefly and for long, and let go: what is left grows with the time that it was held",
    )

    @staticmethod
    def twin(strain, curved, dt, rope_creep_rate):
        """The same law in numpy."""
        return SheetCreep.twin(strain, curved, dt, rope_creep_rate)
