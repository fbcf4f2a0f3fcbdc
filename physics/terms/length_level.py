"""A body whose springs are all a little longer or shorter than its drawing."""

from dataclasses import replace

from ..parameters import Parameter
from .stages import SetupTerm

__all__ = ["LengthLevel"]


class LengthLevel(SetupTerm):
    """l0_s <- (1 + a) l0_s for the body's own springs, not for those that tie controllers.

    Straight springs between sparse noisy nodes cut corners: the sag of a taut rope grows with the square root of what they are short of.
    A nuisance of the drawing, no missing physics.
    """

    name = "length_level"
    parameters = (Parameter("length_level", 0.0, -0.3, 0.3, "-", "by which share the body's springs are longer than drawn"),)

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with other ``rest`` (springs,)."""
        import torch

        tied = (batch.constants["lead"][batch.ends] > 0).any(1)
        return replace(inputs, rest=torch.where(tied, inputs.rest, inputs.rest * (1 + values["length_level"][batch.spring_system])))
