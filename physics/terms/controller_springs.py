"""Springs that tie the body to controllers (hand points)."""

from ..parameters import Parameter
from .stages import LinksTerm

__all__ = ["ControllerSprings"]


class ControllerSprings(LinksTerm):
    """The system's springs whose first end is a controller; without this term they are left out.

    They obey the same axial laws as the body's own. PhysTwin's code leaves controller velocities at zero in the dashpot, so that its
    hand springs damp absolute motion: ``controller_velocity`` 0 is that, 1 is the controller's true velocity.
    """

    name = "controller_springs"
    parameters = (Parameter("controller_velocity", 1.0, 0.0, 1.0, "-", "share of the controllers' velocity that dashpots feel"),)
