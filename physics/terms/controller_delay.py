"""Controllers that were recorded on another clock than the body."""

from dataclasses import replace

from ..parameters import Parameter
from .base import Effect
from .stages import SetupTerm

__all__ = ["ControllerDelay"]


class ControllerDelay(SetupTerm):
    """path(t) <- path(t - tau), linear between frames; before the first frame and after the last the controllers hold still.

    tau > 0: the body feels its controllers later than they are listed. A frame lasts as long as its substeps.
    """

    name = "controller_delay"
    parameters = (Parameter("controller_delay", 0.0, -0.2, 0.2, "s", "how much later the body feels the controllers than they are listed"),)
    effect = Effect(
        "controller_delay",
        "the controllers were recorded on another clock",
        amplitudes=("controller_delay",),
        typical={"controller_delay": 0.05},
        motion="abrupt stops and reversals of the hand",
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with a delayed ``path`` (T, controllers, 3)."""
        import torch

        path, last = inputs.path, len(inputs.path) - 1
        frame = batch._real(batch.dt * batch.substeps)  # (B,) s
        delay = (values["controller_delay"] / frame)[batch.path_system]
        time = torch.arange(last + 1, dtype=path.dtype, device=path.device)[:, None] - delay  # (T, controllers) frames
        before = time.detach().floor().clamp(0, max(0, last - 1)).long()
        share = (time - before).clamp(0, 1)[..., None]
        controller = torch.arange(path.shape[1], device=path.device)
        a, b = path[before, controller], path[(before + 1).clamp(max=last), controller]
        return replace(inputs, path=a + share * (b - a))
