"""A patch of the body that is heavier than the rest: a weight, a filled end, a wet spot."""

from dataclasses import replace

from ..parameters import Parameter
from .base import Effect
from .places import near
from .stages import SetupTerm

__all__ = ["AddedMass"]


class AddedMass(SetupTerm):
    """m_i <- m_i (1 + a M s_i / sum_j m_j s_j), s_i = exp(-|home_i - c|^2 / (2 r^2)): in all, a times the body's mass M is added.

    Weight grows with it (gravity is an acceleration); springs and what drags by the surface stay as they are.
    """

    name = "added_mass"
    parameters = (
        Parameter("added_mass", 0.0, 0.0, 10.0, "of the body's mass", "mass that is added in all"),
        *near("added_mass", "added_mass_within"),
    )
    loads = ("added_mass",)
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
        """Inputs with more ``mass`` (nodes,), and where there are material points more ``load`` (points,), which nodes then carry."""
        import torch

        place = torch.stack([values[f"added_mass_{axis}"] for axis in "xyz"], 1)
        amount, within = values["added_mass"], values["added_mass_within"]
        if batch.pointed:
            more = _patch(inputs.load, batch.constants["point_home"], batch.point_system, place, amount, within)
            nodes, weights = batch.constants["point_node"].long(), batch.constants["point_weight"]
            mass = inputs.mass.index_add(0, nodes.flatten(), (more[:, None] * weights).flatten())
            return replace(inputs, mass=mass, load=inputs.load + more)
        free = (batch.constants["lead"] == 0).nonzero()[:, 0]  # controllers have no mass
        more = _patch(inputs.mass[free], batch.constants["home"][free], batch.system_of[free], place, amount, within)
        return replace(inputs, mass=inputs.mass.index_add(0, free, more))


def _patch(mass, home, system, place, amount, within):
    """(M,) kg more for each of ``mass`` (M,) at ``home`` (M, 3), of the systems (M,) that have a ``place`` (B, 3) each."""
    import torch

    apart = (home - place[system]).square().sum(1)
    nothing = torch.zeros(len(place), dtype=apart.dtype, device=apart.device)
    # counted from the nearest particle: only ratios matter, and a place far from the body stays a number
    nearest = (nothing + torch.inf).scatter_reduce(0, system, apart.detach(), "amin")
    share = torch.exp((nearest[system] - apart) / (2 * within[system].square()))
    whole, patch = (nothing.index_add(0, system, m) for m in (mass, mass * share))
    return mass * (amount * whole / patch)[system] * share
