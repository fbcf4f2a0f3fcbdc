"""A patch of a solid that is stiffer or softer than the rest."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from .base import Effect
from .neo_hookean import neo_hookean, neo_hookean_twin
from .places import bell, bell_twin, near
from .stages import MaterialTerm

__all__ = ["StiffnessPatch"]


@wp.func
def stress(deformed: Any, home: Any, mu: Any, lame: Any, p: Any, o: int):
    return neo_hookean(deformed, mu, lame) * (p[o] * bell(home, p, o + 1))


class StiffnessPatch(MaterialTerm):
    """P = a w P_0, with the neo-Hookean stress P_0 of the elasticity's own moduli and w = exp(-d^2 / 2 R^2) of the distance d from a place.

    A patch of Young's modulus (1 + a w) Y.
    """

    name = "stiffness_patch"
    parameters = (
        Parameter("patch_share", 0.0, -0.95, 20.0, "-", "stiffness in the middle of the patch beyond that of the rest, over the latter"),
        *near("patch", "patch_radius"),
    )
    law = stress
    effect = Effect(
        "stiffness_patch",
        "the material is stiffer or softer at one place",
        amplitudes=("patch_share",),
        typical={"patch_share": 1.0},
        shapes={"patch_radius": (0.02, 0.05)},
        place="patch",
        within="patch_radius",
        motion="bend it at one place after another",
    )

    @staticmethod
    def twin(deformed, home, mu, lame, patch_share, patch_x, patch_y, patch_z, patch_radius):
        """The same law in numpy."""
        share = patch_share * bell_twin(home, (patch_x, patch_y, patch_z), patch_radius)
        return np.asarray(share)[..., None, None] * neo_hookean_twin(deformed, mu, lame)
