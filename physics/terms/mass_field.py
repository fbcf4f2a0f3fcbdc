"""A body whose particles stand for unequal shares of its mass, as thick and thin parts do."""

from dataclasses import replace

from ..parameters import Parameter
from .shapes import shape_of
from .stages import SetupTerm

__all__ = ["MassField"]

MODES = ("slope_a", "slope_b", "slope_c", "bow_a", "bow_b")


class MassField(SetupTerm):
    """m <- m exp(sum_k a_k f_k(u)), f = (u_1, u_2, u_3, (u_1^2 - 1) / 2, (u_2^2 - 1) / 2), and then scaled so that the total stays.

    u is where a particle was in frame 0: from the body's middle, along its principal axes, in rms extents. What a cloud of surface points
    does not tell: how thick the body is behind them. A nuisance of any twin, no missing physics.
    """

    name = "mass_field"
    parameters = tuple(Parameter(f"mass_{mode}", 0.0, -1.5, 1.5, "-", f"{mode.replace('_', ' ')} of the log-mass") for mode in MODES)

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with uneven ``mass`` (nodes,)."""
        import torch

        shape, system = shape_of(batch), batch.system_of
        apart = batch.constants["home"] - shape.middle[system]
        a, b, c = (torch.einsum("nij,nj->ni", shape.axes[system], apart) / shape.extents[system]).unbind(1)
        modes = torch.stack([a, b, c, (a * a - 1) / 2, (b * b - 1) / 2], 1)
        level = (modes * torch.stack([values[f"mass_{mode}"] for mode in MODES], 1)[system]).sum(1)
        free = batch.constants["lead"] == 0  # controllers have no mass to share
        uneven = torch.where(free, inputs.mass * level.exp(), inputs.mass)
        nothing = torch.zeros(len(batch.systems), dtype=uneven.dtype, device=uneven.device)
        before, after = (nothing.index_add(0, system[free], m[free]) for m in (inputs.mass, uneven))
        return replace(inputs, mass=torch.where(free, uneven * (before / after)[system], uneven))
