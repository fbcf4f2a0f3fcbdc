"""A patch of the body that is heavier than the rest: a weight, a filled end, a wet spot."""

from dataclasses import replace

from ..parameters import Parameter
from .base import Effect, Term
from .places import near

__all__ = ["AddedMass"]


class AddedMass(Term):
    """m_i <- m_i (1 + a exp(-|home_i - c|^2 / (2 r^2))): a times a particle's own mass is added in the middle of the patch.

    Weight grows with it (gravity is an acceleration) and springs stay as they are. The mass that is added is the sum of the m_i's growth.
    """

    name = "added_mass"
    stage = "setup"
    parameters = (
        Parameter("added_mass", 0.0, 0.0, 100.0, "-", "mass added in the middle of the patch, over a particle's own"),
        *near("added_mass", "added_mass_within"),
    )
    effect = Effect(
        "added_mass",
        "one part of the body is heavier",
        amplitudes=("added_mass",),
        typical={"added_mass": 2.0},
        shapes={"added_mass_within": (0.03, 0.1)},
        place="added_mass",
        within="added_mass_within",
        motion="holding it still in two poses, then shaking it",
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with more ``mass`` (nodes,)."""
        import torch

        place = torch.stack([values[f"added_mass_{axis}"] for axis in "xyz"], 1)[batch.system_of]
        apart = (batch.constants["home"] - place).square().sum(1)
        share = torch.exp(-apart / (2 * values["added_mass_within"][batch.system_of].square()))
        return replace(inputs, mass=inputs.mass * (1 + values["added_mass"][batch.system_of] * share))
