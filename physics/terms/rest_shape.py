"""A body that was under strain already when the recording began."""

from dataclasses import replace

from ..parameters import Parameter
from .base import Effect
from .shapes import shape_of, tied
from .stages import SetupTerm

__all__ = ["RestShape"]


class RestShape(SetupTerm):
    """L <- L exp(s + g . (h - c) / R): springs of the body want to be longer or shorter than they were in frame 0.

    h is the middle of the spring in frame 0, c the body's and R its rms radius. s is a uniform strain, and g one that grows across the
    body: where neighbouring layers differ in length, it bends.
    """

    name = "rest_shape"
    parameters = (
        Parameter("rest_scale", 0.0, -0.7, 0.7, "-", "log-strain by which rest lengths exceed those of frame 0"),
        *(
            Parameter(f"rest_gradient_{axis}", 0.0, -0.7, 0.7, "-", f"its growth over one radius of the body along {axis}")
            for axis in "xyz"
        ),
    )
    effect = Effect(
        "rest_shape",
        "the body was not at rest in its first shape",
        amplitudes=("rest_scale", "rest_gradient_x", "rest_gradient_y", "rest_gradient_z"),
        typical={"rest_scale": 0.02, "rest_gradient_x": 0.02, "rest_gradient_y": 0.01, "rest_gradient_z": 0.01},
        motion="rest in two poses",
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with other ``rest`` lengths (springs,)."""
        import torch

        shape, system = shape_of(batch), batch.spring_system
        apart = (batch.constants["home"][batch.ends].mean(1) - shape.middle[system]) / shape.size[system, None]
        slope = torch.stack([values[f"rest_gradient_{axis}"] for axis in "xyz"], 1)[system]
        strain = values["rest_scale"][system] + (slope * apart).sum(1)
        return replace(inputs, rest=inputs.rest * torch.where(tied(batch), 0.0, strain).exp())
