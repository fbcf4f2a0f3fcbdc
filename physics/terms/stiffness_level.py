"""How stiff the body and its grips are as a whole."""

from dataclasses import replace

from ..parameters import Parameter
from .stages import SetupTerm

__all__ = ["StiffnessLevel"]


class StiffnessLevel(SetupTerm):
    """Y_s <- level * Y_s: one level for the body's own springs, one for those that tie controllers.

    A system whose springs have unit stiffness is then homogeneous, and its level can be searched like any other parameter.
    """

    name = "stiffness_level"
    parameters = (
        Parameter("body_stiffness", 1.0, 1e-3, 1e7, "-", "factor on the stiffness of the body's springs", "log"),
        Parameter("grip_stiffness", 1.0, 1e-3, 1e7, "-", "factor on the stiffness of the controllers' springs", "log"),
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with scaled ``stiffness`` (springs,)."""
        import torch

        tied = (batch.constants["lead"][batch.ends] > 0).any(1)
        level = torch.where(tied, values["grip_stiffness"][batch.spring_system], values["body_stiffness"][batch.spring_system])
        return replace(inputs, stiffness=inputs.stiffness * level)
