"""Springs beside a sheet's elasticity that fade: stiffer when moved fast, and their stress goes while the strain is held."""

import math
from typing import Any

import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .stages import SheetBranchTerm

__all__ = ["SheetRelaxing"]


@wp.func
def lag(strain: Any, curved: Any, q: Any, p: Any, o: int):
    return (strain - q) * p[o]


@wp.func
def forget(strain: Any, curved: Any, q: Any, dt: Any, p: Any, o: int):
    return q + (strain - q) * settled(dt / p[o + 1])


class SheetRelaxing(SheetBranchTerm):
    """S = elasticity(a (e - q)), q' = (e - q) / tau, of strain and of curvature alike: Zener's solid, as ``maxwell`` is of solids.

    q is integrated exactly while e holds still (Simo and Hughes, "Computational inelasticity", 1998, section 10.2).
    """

    name = "sheet_relaxing"
    parameters = (
        Parameter("sheet_branch_share", 0.0, 0.0, 20.0, "-", "stiffness of the Maxwell branch as a share of the elasticity's"),
        Parameter("sheet_branch_time", 0.1, 0.005, 10.0, "s", "time in which the branch's stress falls to 1/e", scale="log"),
    )
    law = lag
    evolve = forget
    effect = Effect(
        name="viscoelastic",
        says="it is stiffer when moved fast, and its force fades while it is held",
        amplitudes=("sheet_branch_share",),
        typical={"sheet_branch_share": 1.0},
        shapes={"sheet_branch_time": (0.05, 0.2, 0.8)},
        motion="pull fast and hold still, and shake it slowly and quickly: the lag is largest at one period over 2 pi",
    )

    @staticmethod
    def twin(strain, curved, q, sheet_branch_share, sheet_branch_time):
        """The same law in numpy."""
        return (strain - q) * sheet_branch_share

    @staticmethod
    def twin_evolve(strain, curved, q, dt, sheet_branch_share, sheet_branch_time):
        """The same memory in numpy."""
        return strain + (q - strain) * math.exp(-dt / sheet_branch_time)
