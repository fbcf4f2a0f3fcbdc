"""Hands that hold the body elsewhere than the recording says."""

from dataclasses import replace

from ..parameters import Parameter
from .base import Effect
from .shapes import tied
from .stages import SetupTerm

__all__ = ["GripPoints"]

LEAST = 1e-3  # m: a controller's spring does not get shorter than this


class GripPoints(SetupTerm):
    """L <- L |c + s - x| / |c - x| for the springs that tie controllers, c and x their ends in frame 0: as if the hand had been at c + s.

    The hand then is not where its springs were made, and holds the body by -s from there. Controllers that carry a particle rigidly have no
    springs of their own, and stay as they are.
    """

    name = "grip_points"
    parameters = tuple(
        Parameter(f"grip_shift_{axis}", 0.0, -0.1, 0.1, "m", f"how far off the hand was in frame 0, {axis}") for axis in "xyz"
    )
    effect = Effect(
        "grip_points",
        "the hand holds the body elsewhere than the recording says",
        amplitudes=("grip_shift_x", "grip_shift_y", "grip_shift_z"),
        typical={"grip_shift_x": 0.01, "grip_shift_y": 0.005, "grip_shift_z": 0.005},
        motion="turning the hand in place",
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with other ``rest`` lengths (springs,)."""
        import torch

        start, lead = batch.inputs.x, batch.constants["lead"] > 0
        shift = torch.stack([values[f"grip_shift_{axis}"] for axis in "xyz"], 1)[batch.spring_system]
        apart = start[batch.ends[:, 1]] - start[batch.ends[:, 0]]
        sign = lead[batch.ends[:, 1]].to(apart.dtype) - lead[batch.ends[:, 0]].to(apart.dtype)
        before, after = (d.square().sum(1).clamp_min(LEAST**2).sqrt() for d in (apart, apart + sign[:, None] * shift))
        return replace(inputs, rest=torch.where(tied(batch), inputs.rest * (after / before), inputs.rest))
