"""A softer hold than the twin has."""

from dataclasses import replace

from ..parameters import Parameter
from .base import Effect
from .shapes import tied
from .stages import SetupTerm

__all__ = ["GripCompliance"]


class GripCompliance(SetupTerm):
    """Y <- Y exp(-c) for the springs that tie controllers: fingers and flesh give way, and come back when the load goes."""

    name = "grip_compliance"
    parameters = (Parameter("grip_compliance", 0.0, 0.0, 10.0, "-", "logarithm of how much softer the controllers' springs are"),)
    effect = Effect(
        "grip_compliance",
        "the hold of the hand gives way under load",
        amplitudes=("grip_compliance",),
        typical={"grip_compliance": 1.0},
        motion="hard jerks of the hand, then rest",
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with less ``stiffness`` (springs,)."""
        import torch

        softer = torch.where(tied(batch), -values["grip_compliance"][batch.spring_system], 0.0)
        return replace(inputs, stiffness=inputs.stiffness * softer.exp())
