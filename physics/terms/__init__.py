"""The physics that a system can have: one term, one file. Removing a term from a system's list removes that physics."""

from .base import Effect, Term
from .bending import Bending
from .bending_damping import BendingDamping
from .controller_springs import ControllerSprings
from .dashpot import Dashpot
from .gravity import Gravity
from .ground import Ground
from .linear_drag import LinearDrag
from .self_collision import SelfCollision
from .springs import Springs
from .torsion import Torsion

__all__ = [
    "Bending",
    "BendingDamping",
    "ControllerSprings",
    "Dashpot",
    "Effect",
    "Gravity",
    "Ground",
    "LinearDrag",
    "SelfCollision",
    "Springs",
    "Term",
    "Torsion",
]
