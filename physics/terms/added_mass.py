"""A patch of the body that is heavier than the rest: a weight, a filled end, a wet spot."""

from dataclasses import replace

from ..parameters import Parameter
from .base import Effect, Term
from .places import near

__all__ = ["AddedMass"]


class AddedMass(Term):
    """m_i <- m_i (1 + a M s_i / sum_j m_j s_j), s_i = exp(-|home_i - c|^2 / (2 r^2)): in all, a times the body's mass M is added.

    Weight grows with it (gravity is an acceleration); springs and what drags by the surface stay as they are.
    """

    name = "added_mass"
    stage = "setup"
    parameters = (
        Parameter("added_mass", 0.0, 0.0, 10.0, "of the body's mass", "mass that is added in all"),
        *near("added_mass", "added_mass_within"),
    )
    effect = Effect(
        "added_mass",
        "one part of the body is heavier",
        amplitudes=("added_mass",),
        typical={"added_mass": 0.2},
        shapes={"added_mass_within": (0.03, 0.1)},
        place="added_mass",
        within="added_mass_within",
        motion="holding it still in two poses, then shaking it",
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with more ``mass`` (nodes,)."""
        import torch

        system, free = batch.system_of, batch.constants["lead"] == 0  # controllers have no mass
        place = torch.stack([values[f"added_mass_{axis}"] for axis in "xyz"], 1)[system]
        apart = (batch.constants["home"] - place).square().sum(1)
        nothing = torch.zeros(len(batch.systems), dtype=apart.dtype, device=apart.device)
        # counted from the nearest particle: only ratios matter, and a place far from the body stays a number
        nearest = (nothing + torch.inf).scatter_reduce(0, system[free], apart[free].detach(), "amin")
        share = torch.exp((nearest[system] - apart) / (2 * values["added_mass_within"][system].square()))
        whole, patch = (nothing.index_add(0, system[free], m[free]) for m in (inputs.mass, inputs.mass * share))
        grown = inputs.mass * (1 + (values["added_mass"] * whole / patch)[system] * share)
        return replace(inputs, mass=torch.where(free, grown, inputs.mass))
