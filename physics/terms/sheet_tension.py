"""A sheet that was under tension, or compression, when the recording began."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import MembraneTerm

__all__ = ["SheetTension"]


@wp.func
def stretch(strain: Any, p: Any, o: int):
    return type(strain)(p[o], p[o + 1], p[o + 2])


class SheetTension(MembraneTerm):
    """S = T, the same at any strain: what a sheet bears in its first shape, whose rest shape is another one.

    Of a sheet with the stiffness E h that would be smaller by a strain e all over, T = e E h / (1 - nu) in both directions; of one that
    would be shorter along n, e E h / (1 - nu^2) there and nu times as much across.
    """

    name = "sheet_tension"
    parameters = tuple(
        Parameter(f"tension_{name}", 0.0, -100.0, 100.0, "N/m", f"in frame 0 {where}")
        for name, where in (("first", "along the sheet's first axis"), ("second", "along its second axis"), ("shear", "in shear"))
    )
    law = stretch
    effect = Effect(
        "rest_shape",
        "the sheet was not at rest in its first shape",
        amplitudes=("tension_first", "tension_second", "tension_shear"),
        typical={"tension_first": 2.0, "tension_second": 2.0, "tension_shear": 1.0},
        motion="rest in two poses",
    )

    @staticmethod
    def twin(strain, tension_first, tension_second, tension_shear):
        """The same law in numpy."""
        import numpy as np

        return np.broadcast_to([tension_first, tension_second, tension_shear], np.shape(strain)).copy()
