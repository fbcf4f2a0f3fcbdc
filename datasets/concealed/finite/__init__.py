"""A second engine: finite elements and geometrically exact rods, implicit in time, that share nothing with the project's own physics.

Cloths are neo-Hookean membranes with discrete-shell bending, or where they are resolved that of a plate, stuffed bodies neo-Hookean
tetrahedra or quadratic hexahedra, ropes Simo-Reissner rods.
"""

from .march import World, simulate

__all__ = ["World", "about", "simulate"]


def about() -> dict:
    """What a label says of the engine."""
    return {"finite": "neo-Hookean elements, shear-deformable rods", "integrator": "BDF2"}
