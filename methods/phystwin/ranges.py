"""What PhysTwin searches, and where each number may lie."""

from __future__ import annotations

from dataclasses import replace

from ...physics.parameters import Parameter
from ...physics.terms import Dashpot, Ground, LinearDrag, SelfCollision
from .config import Quirks

__all__ = ["ADDED_SHARE", "CONTACT", "SEARCHED", "ranges"]

SPACING = 0.005  # m: the published voxel thinning, for which the published radii were chosen

CONTACT = ("collide_elas", "collide_fric", "collide_object_elas", "collide_object_fric")

SEARCHED = (
    Parameter("global_spring_Y", 3e4, 0.0, 1e5, "N", "force per unit strain of every spring"),
    Parameter("object_radius", 0.02, 0.01, 0.05, "m", "distance within which particles are joined"),
    Parameter("object_max_neighbours", 30, 10, 50, "-", "most springs that a particle asks for"),
    Parameter("controller_radius", 0.04, 0.01, 0.08, "m", "distance within which a controller pulls"),
    Parameter("controller_max_neighbours", 50, 10, 80, "-", "most springs of a controller"),
    *(p for p in Ground.parameters + SelfCollision.parameters if p.name in CONTACT),
    Parameter("collision_dist", 0.02, 0.01, 0.05, "m", "distance within which particles can meet"),
    *LinearDrag.parameters,
    *Dashpot.parameters,
)
"""The twelve parameters of the zero-order stage with the published ranges and starts, in the published order."""

ADDED_SHARE = Parameter("added_share", 1.0, 0.0, 2.0, "-", "amplitude of added physics over what was given")
"""Searched beside the twelve where physics beyond PhysTwin's is added."""

LENGTHS = ("object_radius", "controller_radius", "collision_dist")

LOGARITHMIC = {
    "global_spring_Y": dict(value=1e4, low=1e2, high=1e6, scale="log"),
    "dashpot_damping": dict(value=10.0, low=0.1, high=200.0, scale="log"),
}
"""Soft toys lie at a hundredth of the published stiffness range, cables beyond its end."""


def ranges(quirks: Quirks, spacing: float) -> tuple[Parameter, ...]:
    """The searched parameters for a body whose particles lie ``spacing`` [m] apart; radii scale with it unless ``fixed_radii``."""
    scale = 1.0 if quirks.fixed_radii else max(1.0, spacing / SPACING)
    table = []
    for p in SEARCHED:
        if p.name in LENGTHS:
            p = replace(p, value=p.value * scale, low=p.low * scale, high=p.high * scale)
        elif p.name in LOGARITHMIC and not quirks.linear_search:
            p = replace(p, **LOGARITHMIC[p.name])
        table.append(p)
    return tuple(table)
