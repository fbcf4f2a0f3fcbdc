"""Springs that yield to compression, as threads and thin sheets do, which buckle."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import AxialTerm

__all__ = ["CompressionSoftening"]


@wp.func
def slacken(length: Any, rate: Any, rest: Any, stiffness: Any, p: Any, o: int):
    one = type(length)(1.0)
    strain = length / rest - one
    fade = wp.exp(-wp.abs(strain) / p[o + 1])  # of the absolute value, which cannot overflow
    compressed = wp.where(strain > type(length)(0.0), fade, one) / (one + fade)
    return -stiffness * p[o] * strain * compressed


class CompressionSoftening(AxialTerm):
    """F = -a Y e S(-e / w) beside the spring's own Y e, S the logistic function: takes the share a of compressive tension away.

    The modulus is (1 - a) Y in compression and Y in tension, as of a bimodular material (Ambartsumyan), joined smoothly over strains of w.
    """

    name = "compression_softening"
    parameters = (
        Parameter("compression_softening", 0.0, 0.0, 1.0, "-", "share of its stiffness that a spring loses in compression"),
        Parameter("compression_width", 0.01, 1e-3, 0.2, "-", "strain over which tension passes into compression", "log"),
    )
    law = slacken
    effect = Effect(
        "compression_softening",
        "the material is softer in compression than in tension",
        amplitudes=("compression_softening",),
        typical={"compression_softening": 0.5},
        motion="pushing the ends together, then pulling them apart",
    )

    @staticmethod
    def twin(length, rate, rest, stiffness, compression_softening, compression_width):
        """The same law in numpy."""
        import numpy as np

        strain = length / rest - 1
        fade = np.exp(-abs(strain) / compression_width)
        return -stiffness * compression_softening * strain * (fade if strain > 0 else 1.0) / (1 + fade)
