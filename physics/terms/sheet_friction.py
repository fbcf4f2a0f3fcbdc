"""Dry friction between the threads of a sheet: it opposes every change of shape by the same stress, however slow."""

from typing import Any

import numpy as np
import warp as wp

from ..fabrics import size, size_twin
from ..parameters import Parameter
from .base import Effect
from .stages import SheetBranchTerm

__all__ = ["SheetFriction"]


@wp.func
def lag(strain: Any, curved: Any, q: Any, p: Any, o: int):
    return (strain - q) * (p[o] / p[o + 1])


@wp.func
def slide(strain: Any, curved: Any, q: Any, dt: Any, p: Any, o: int):
    behind = strain - q
    return q + behind * wp.max(type(curved)(1.0) - p[o + 1] / size(behind, curved, p[o + 2]), type(curved)(0.0))


class SheetFriction(SheetBranchTerm):
    """S = elasticity((a / e_h) (e - q)), |e - q| <= e_h: springs in series with sliders that give way at a strain of e_h.

    The most that friction resists with is what the elasticity would at a strain of a; of curvature, at one that strains the surface so.
    One element of Iwan's model (J. Appl. Mech. 33, 1966); of cloth Miguel et al., "Modeling and estimation of internal friction in cloth",
    SIGGRAPH Asia 2013, have Dahl's, which turns round in the same way, but for its corner.
    """

    name = "sheet_friction"
    parameters = (
        Parameter("sheet_rub", 0.0, 0.0, 1.0, "-", "largest friction, as strain at the elasticity's stiffness"),
        Parameter("sheet_rub_strain", 0.01, 5e-4, 0.3, "-", "strain over which friction turns round", scale="log"),
        Parameter("sheet_rub_surface", 5e-4, 1e-5, 0.02, "m", "distance from the middle at which curvature is strain", scale="log"),
    )
    law = lag
    evolve = slide
    effect = Effect(
        name="internal_friction",
        says="its material rubs in itself, and stays where it was bent to",
        amplitudes=("sheet_rub",),
        typical={"sheet_rub": 0.01},
        shapes={"sheet_rub_strain": (0.003, 0.01), "sheet_rub_surface": (5e-4,)},
        motion="bend or stretch it to and fro very slowly, then fast: the lag between both ways is the same",
    )

    @staticmethod
    def twin(strain, curved, q, sheet_rub, sheet_rub_strain, sheet_rub_surface):
        """The same law in numpy."""
        return (strain - q) * (sheet_rub / sheet_rub_strain)

    @staticmethod
    def twin_evolve(strain, curved, q, dt, sheet_rub, sheet_rub_strain, sheet_rub_surface):
        """The same memory in numpy."""
        far = size_twin(strain - q, curved, sheet_rub_surface)
        return q + (strain - q) * np.maximum(1 - sheet_rub_strain / far, 0.0)[..., None]
