"""A further engine: NVIDIA's Newton simulates cloths and stuffed bodies by vertex block descent (Chen et al., SIGGRAPH 2024) on the CPU.

Its membranes and tetrahedra are stable neo-Hookean (Smith et al. 2018), its sheets bend as discrete shells, its contact is its own; single
precision, implicit Euler steps. What Newton does not have, fibres and forces of laws, acts as outer forces.
"""

from .march import World, simulate
from .scene import imported

__all__ = ["BODIES", "UNABLE", "World", "about", "simulate"]

BODIES = ("cloth", "plush")
UNABLE = frozenset({"self_contact"})


def about() -> dict:
    """What a label says of the engine. Raises ValueError where Newton is not installed."""
    return {"newton": imported()[0].__version__, "integrator": "implicit Euler, vertex block descent"}
