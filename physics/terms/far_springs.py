"""Springs that reach beyond a particle's next neighbours, and so hold a body's bends."""

from dataclasses import replace

from ..parameters import Parameter
from .stages import SetupTerm

__all__ = ["FarSprings"]


class FarSprings(SetupTerm):
    """Y_s <- share * Y_s for springs of the body whose rest length exceeds ``far_reach``.

    A spring-mass twin bends against the springs that skip its next neighbours: a fit of every spring's stiffness finds their share, and so
    must a twin with few numbers. 1 leaves the body as it is drawn. A nuisance of the drawn topology, no missing physics.
    """

    name = "far_springs"
    parameters = (
        Parameter("far_share", 1.0, 0.0, 10.0, "-", "stiffness of the springs that skip neighbours, over that of the others"),
        Parameter("far_reach", 10.0, 1e-4, 10.0, "m", "rest length beyond which a spring skips neighbours", "log"),
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with other ``stiffness`` (springs,)."""
        import torch

        system = batch.spring_system
        far = (inputs.rest > values["far_reach"][system]) & ~(batch.constants["lead"][batch.ends] > 0).any(1)
        return replace(inputs, stiffness=inputs.stiffness * torch.where(far, values["far_share"][system], 1.0))
