"""The physics that a system can have: one term, one file. Removing a term from a system's list removes that physics."""

from .base import Effect, Term
from .controller_springs import ControllerSprings
from .dashpot import Dashpot
from .gravity import Gravity
from .ground import Ground
from .linear_drag import LinearDrag
from .self_collision import SelfCollision
from .springs import Springs

__all__ = ["ControllerSprings", "Dashpot", "Effect", "Gravity", "Ground", "LinearDrag", "SelfCollision", "Springs", "Term"]
