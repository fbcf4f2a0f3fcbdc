"""A body that is stiffer in some places than in others, as real ones are."""

from dataclasses import replace

from ..parameters import Parameter
from .shapes import shape_of, tied
from .stages import SetupTerm

__all__ = ["StiffnessField"]

MODES = ("slope_a", "slope_b", "slope_c", "bow_a", "bow_b", "saddle")


class StiffnessField(SetupTerm):
    """Y <- Y exp(sum_k a_k f_k(u)), f = (u_1, u_2, u_3, (u_1^2 - 1) / 2, (u_2^2 - 1) / 2, u_1 u_2).

    u is where a spring's middle was in frame 0: from the body's middle, along its principal axes, in rms extents. The smoothest modes of an
    uneven material, which belongs to any twin and is no missing physics. A thin axis counts as at least a twentieth of the longest.
    """

    name = "stiffness_field"
    parameters = tuple(
        Parameter(f"stiffness_{mode}", 0.0, -2.0, 2.0, "-", f"{mode.replace('_', ' ')} of the log-stiffness") for mode in MODES
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with uneven ``stiffness`` (springs,)."""
        import torch

        shape, system = shape_of(batch), batch.spring_system
        apart = batch.constants["home"][batch.ends].mean(1) - shape.middle[system]
        a, b, c = (torch.einsum("sij,sj->si", shape.axes[system], apart) / shape.extents[system]).unbind(1)
        modes = torch.stack([a, b, c, (a * a - 1) / 2, (b * b - 1) / 2, a * b], 1)
        level = (modes * torch.stack([values[f"stiffness_{mode}"] for mode in MODES], 1)[system]).sum(1)
        return replace(inputs, stiffness=inputs.stiffness * torch.where(tied(batch), 0.0, level).exp())
