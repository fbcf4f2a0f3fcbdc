"""A material that is stiffer in one direction than in another."""

from dataclasses import replace

from ..parameters import Parameter
from .base import Effect
from .shapes import tied
from .stages import SetupTerm

__all__ = ["Anisotropy"]

PAIRS = ("xx", "yy", "xy", "yz", "xz")


class Anisotropy(SetupTerm):
    """Y <- Y exp(d . A d), d the spring's direction in frame 0, A symmetric and traceless, in the axes of the world.

    The lowest even harmonic of direction, as in the orientation tensors of fibre composites (Advani and Tucker); five numbers, as
    A_zz = -A_xx - A_yy. In a flat sheet only two combinations of the five move stiffness from one direction to another: where z = 0,
    A_xx - A_yy and A_xy; A_xx + A_yy there stiffens all springs alike. Springs of controllers stay as they are.
    """

    name = "anisotropy"
    parameters = tuple(Parameter(f"anisotropy_{pair}", 0.0, -3.0, 3.0, "-", f"{pair} of the log-stiffness tensor") for pair in PAIRS)
    effect = Effect(
        "anisotropy",
        "the material is stiffer in one direction than in another",
        amplitudes=tuple(f"anisotropy_{pair}" for pair in PAIRS),
        typical={"anisotropy_xx": 0.5, "anisotropy_yy": -0.5, "anisotropy_xy": 0.3, "anisotropy_yz": 0.0, "anisotropy_xz": 0.0},
        motion="stretches along two directions and on the bias",
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with ``stiffness`` (springs,) by direction."""
        import torch

        home = batch.constants["home"]
        apart = home[batch.ends[:, 1]] - home[batch.ends[:, 0]]
        x, y, z = (apart / apart.norm(dim=1, keepdim=True).clamp_min(1e-9)).unbind(1)
        xx, yy, xy, yz, xz = (values[f"anisotropy_{pair}"][batch.spring_system] for pair in PAIRS)
        level = xx * (x * x - z * z) + yy * (y * y - z * z) + 2 * (xy * x * y + yz * y * z + xz * x * z)
        return replace(inputs, stiffness=inputs.stiffness * torch.where(tied(batch), 0.0, level).exp())
