"""Pairs of recordings of one object in which a physical effect, a fault of measurement or nothing is concealed.

MuJoCo, implicit finite elements, of ropes PyElastica's Cosserat rods or, of other bodies, Newton simulate them (``ENGINES``), with laws of
their own or with forces computed in their state at every step, not the engine of this project.
The folders hold what a user would believe; what was concealed stands in one file beside them.
"""

from .case import Case, build
from .effects import EFFECTS, OUTSIDE

__all__ = ["EFFECTS", "OUTSIDE", "Case", "build"]
