"""Sheets that are softer in compression than in tension."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import MembraneTerm

__all__ = ["MembraneSlack"]


@wp.func
def stretch(strain: Any, p: Any, o: int):
    a = strain[0]
    b = strain[1]
    c = strain[2]
    two = type(p[o])(2.0)
    size = wp.sqrt(p[o + 1] * p[o + 1] + a * a + b * b + two * c * c)
    aa = a * a + c * c
    bb = b * b + c * c
    ab = c * (a + b)
    third = (a * aa + b * bb + two * c * ab) / (type(p[o])(3.0) * size * size * size)
    k = p[o]
    return type(strain)(k * (aa / size - a * third), k * (bb / size - b * third), k * (ab / size - c * third))


class MembraneSlack(MembraneTerm):
    """S = k (E E / r - tr(E^3) E / 3 r^3), r^2 = w^2 + E : E, of the energy W = k tr(E^3) / 3 r, with the Green strain E.

    ``tension_compression`` for sheets: the simplest odd energy that grows no faster than elasticity, so that the stiffness at rest is the
    elasticity's and has no kink. Beyond strains of w a strip is stiffer by 2 k / 3 in tension and softer by as much in compression, as a
    cloth is whose yarns buckle.
    """

    name = "membrane_slack"
    parameters = (
        Parameter("slack_stiffness", 0.0, -1e4, 1e4, "N/m", "k: how much stiffer it is in tension than in compression"),
        Parameter("slack_width", 0.005, 1e-4, 0.5, "-", "strain w over which compression passes into tension", scale="log"),
    )
    law = stretch
    effect = Effect(
        "compression_softening",
        "the sheet is softer in compression than in tension",
        amplitudes=("slack_stiffness",),
        typical={"slack_stiffness": 40.0},
        motion="pushing the ends together, then pulling them apart",
    )

    @staticmethod
    def twin(strain, slack_stiffness, slack_width):
        """The same law in numpy."""
        import numpy as np

        a, b, c = np.moveaxis(np.asarray(strain, float), -1, 0)
        size = np.sqrt(slack_width**2 + a * a + b * b + 2 * c * c)
        square = np.stack([a * a + c * c, b * b + c * c, c * (a + b)], -1)
        third = (square * np.asarray(strain)) @ [1.0, 1.0, 2.0] / (3 * size**3)
        return slack_stiffness * (square / size[..., None] - third[..., None] * np.asarray(strain))
