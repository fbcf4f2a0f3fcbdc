"""Bending of sheets, stiff in proportion to curvature."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import PlateTerm

__all__ = ["PlateBending", "flexed", "flexed_twin"]


@wp.func
def flexed(curvature: Any, rigidity: Any, poisson: Any):
    """Moments of an isotropic plate of this rigidity B [N m]."""
    across = rigidity * poisson
    return type(curvature)(
        rigidity * curvature[0] + across * curvature[1],
        across * curvature[0] + rigidity * curvature[1],
        (rigidity - across) * curvature[2],
    )


@wp.func
def bend(curvature: Any, p: Any, o: int):
    return flexed(curvature, p[o], p[o + 1])


def flexed_twin(curvature, rigidity, poisson):
    """The same in numpy, for tensors (..., 3)."""
    import numpy as np

    a, b, twist = np.moveaxis(np.asarray(curvature), -1, 0)
    return rigidity * np.stack([a + poisson * b, b + poisson * a, (1 - poisson) * twist], -1)


class PlateBending(PlateTerm):
    """M = B ((1 - nu) k + nu tr(k) 1) of the curvature k beyond that at rest (Kirchhoff).

    Energy B / 2 (k_1^2 + k_2^2 + 2 nu k_1 k_2) per area. A strip of an isotropic plate, free across, bends by B (1 - nu^2); what Peirce's
    cantilever measures of a fabric is B with nu 0, the usual choice for cloth, whose directions bend by themselves.
    """

    name = "plate_bending"
    parameters = (
        Parameter("plate_rigidity", 1e-5, 1e-9, 1e2, "N m", "bending moment per length and curvature, B", scale="log"),
        Parameter("plate_poisson", 0.0, 0.0, 0.5, "-", "how much it bends across against its will, as Poisson's ratio"),
    )
    law = bend

    @staticmethod
    def twin(curvature, plate_rigidity, plate_poisson):
        """The same law in numpy."""
        return flexed_twin(curvature, plate_rigidity, plate_poisson)
