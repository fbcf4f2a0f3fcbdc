"""A table that is higher, lower or less level than the recording says."""

from dataclasses import replace

from ..parameters import Parameter
from .base import Effect
from .shapes import shape_of
from .stages import SetupTerm

__all__ = ["GroundPose"]


class GroundPose(SetupTerm):
    """Moves the planes of the ground terms: n <- n cos a cos b + t_1 sin a + t_2 cos a sin b, and up by h along the new normal.

    t_1 is the world axis least along n, made orthogonal to it, and t_2 = n x t_1; the plane turns about the point below the body's
    middle in frame 0. Raises ValueError where a batch has no ground to move.
    """

    name = "ground_pose"
    parameters = (
        Parameter("ground_raise", 0.0, -0.3, 0.3, "m", "height of the ground above where the recording has it"),
        Parameter("ground_tilt_a", 0.0, -0.7, 0.7, "rad", "tilt of the normal towards the first tangent"),
        Parameter("ground_tilt_b", 0.0, -0.7, 0.7, "rad", "tilt of the normal towards the second tangent"),
    )
    effect = Effect(
        "ground_pose",
        "the ground lies elsewhere than the recording says",
        amplitudes=("ground_raise", "ground_tilt_a", "ground_tilt_b"),
        typical={"ground_raise": 0.01, "ground_tilt_a": 0.05, "ground_tilt_b": 0.03},
        motion="laying it down at several places of the table",
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs whose ``table`` (B, columns) has the planes moved."""
        planes = [kind for kind in ("ground", "coulomb", "adhesion") if f"{kind}_offset" in batch.columns] or ["ground"]
        middle, table = shape_of(batch).middle, inputs.table.clone()
        for kind in planes:
            normal = [batch.column(f"{kind}_normal_{axis}") for axis in "xyz"]
            offset = batch.column(f"{kind}_offset")
            n, height = inputs.table[:, normal], inputs.table[:, offset]
            turned = _turned(n, values["ground_tilt_a"][:, None], values["ground_tilt_b"][:, None])
            foot = middle - n * ((n * middle).sum(1) - height)[:, None]
            table[:, normal] = turned
            table[:, offset] = height + ((turned - n) * foot).sum(1) + values["ground_raise"]
        return replace(inputs, table=table)


def _turned(n, a, b):
    """Unit normals (B, 3) turned by the angles (B, 1) towards their tangents."""
    import torch

    least = n.detach().abs().argsort(dim=1, stable=True)[:, 0]  # the axis least along the normal
    first = torch.eye(3, dtype=n.dtype, device=n.device)[least]
    first = first - n * (n * first).sum(1, keepdim=True)
    first = first / first.norm(dim=1, keepdim=True)
    second = torch.linalg.cross(n, first)
    return n * a.cos() * b.cos() + first * a.sin() + second * a.cos() * b.sin()
