"""Springs beside a rope's bending that fade: stiffer when bent fast, and its moment goes while the bend is held."""

from ..parameters import Parameter
from .base import Effect
from .sheet_relaxing import SheetRelaxing, forget, lag
from .stages import HingeBranchTerm

__all__ = ["RopeRelaxing"]


class RopeRelaxing(HingeBranchTerm):
    """M = B a (k - q), q' = (k - q) / tau, of the curvature k beyond the natural one: Zener's solid, ``sheet_relaxing`` of ropes."""

    name = "rope_relaxing"
    parameters = (
        Parameter("rope_branch_share", 0.0, 0.0, 20.0, "-", "stiffness of the Maxwell branch as a share of the bending's"),
        Parameter("rope_branch_time", 0.1, 0.005, 10.0, "s", "time in which the branch's moment falls to 1/e", scale="log"),
    )
    law = lag
    evolve = forget
    effect = Effect(
        name="viscoelastic",
        says="it is stiffer when moved fast, and its force fades while it is held",
        amplitudes=("rope_branch_share",),
        typical={"rope_branch_share": 1.0},
        shapes={"rope_branch_time": (0.05, 0.2, 0.8)},
        motion="bend it fast and hold still, and shake it slowly and quickly: the lag is largest at one period over 2 pi",
    )

    @staticmethod
    def twin(strain, curved, q, rope_branch_share, rope_branch_time):
        """The same law in numpy."""
        return SheetRelaxing.twin(strain, curved, q, rope_branch_share, rope_branch_time)

    @staticmethod
    def twin_evolve(strain, curved, q, dt, rope_branch_share, rope_branch_time):
        """The same memory in numpy."""
        return SheetRelaxing.twin_evolve(strain, curved, q, dt, rope_branch_share, rope_branch_time)
