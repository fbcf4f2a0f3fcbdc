"""Dry friction between the strands of a rope: it opposes every bend by the same moment, however slow."""

from ..parameters import Parameter
from .base import Effect
from .sheet_friction import SheetFriction, lag, slide
from .stages import HingeBranchTerm

__all__ = ["RopeFriction"]


class RopeFriction(HingeBranchTerm):
    """M = B (a / e_h) (k - q), s |k - q| <= e_h: ``sheet_friction`` of ropes, whose strands slide on each other as they bend.

    The most that friction resists with is the bending's moment where it strains the surface, s from the middle, by a. Cables and yarns
    have it; ``bending_damping`` grows with the rate, this does not.
    """

    name = "rope_friction"
    parameters = (
        Parameter("rope_rub", 0.0, 0.0, 1.0, "-", "largest friction, as strain of the surface at the bending's stiffness"),
        Parameter("rope_rub_strain", 0.02, 5e-4, 0.5, "-", "strain of the surface over which friction turns round", scale="log"),
        Parameter("rope_rub_surface", 5e-3, 1e-5, 0.05, "m", "distance from the middle at which curvature is strain", scale="log"),
    )
    law = lag
    evolve = slide
    effect = Effect(
        name="internal_friction",
        says="its material rubs in itself, and stays where it was bent to",
        amplitudes=("rope_rub",),
        typical={"rope_rub": 0.02},
        shapes={"rope_rub_strain": (0.005, 0.02), "rope_rub_surface": (5e-3,)},
        motion="bend it to and fro very slowly, then fast: the lag between both ways is the same",
    )

    @staticmethod
    def twin(strain, curved, q, rope_rub, rope_rub_strain, rope_rub_surface):
        """The same law in numpy."""
        return SheetFriction.twin(strain, curved, q, rope_rub, rope_rub_strain, rope_rub_surface)

    @staticmethod
    def twin_evolve(strain, curved, q, dt, rope_rub, rope_rub_strain, rope_rub_surface):
        """The same memory in numpy."""
        return SheetFriction.twin_evolve(strain, curved, q, dt, rope_rub, rope_rub_strain, rope_rub_surface)
