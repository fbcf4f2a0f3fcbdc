"""A sheet that gives way under any load, slowly, and keeps what it gave."""

import math
from typing import Any

import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .stages import SheetFlowTerm

__all__ = ["SheetCreep"]


@wp.func
def flow(strain: Any, curved: Any, dt: Any, p: Any, o: int):
    return strain * settled(p[o] * dt)


class SheetCreep(SheetFlowTerm):
    """q' = r (e - q), of strain and of curvature alike: Maxwell's fluid, Norton's law of the first power as ``norton_creep`` is of solids.

    A strip under a load that strains it by e creeps at r e; a bend that is held keeps all but exp(-r t) of itself.
    """

    name = "sheet_creep"
    parameters = (Parameter("sheet_creep_rate", 0.0, 0.0, 20.0, "1/s", "rate at which elastic strain and curvature become rest"),)
    law = flow
    effect = Effect(
        name="creep",
        says="it gives way slowly under any load, and keeps what it gave",
        amplitudes=("sheet_creep_rate",),
        typical={"sheet_creep_rate": 0.5},
        motion="hold it stretched or bent, briefly and for long, and let go: what is left grows with the time that it was held",
    )

    @staticmethod
    def twin(strain, curved, dt, sheet_creep_rate):
        """The same law in numpy."""
        return -strain * math.expm1(-sheet_creep_rate * dt)
