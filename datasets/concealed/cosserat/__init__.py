"""A further engine, for ropes alone: PyElastica's Cosserat rods, of which neither the twins nor the other engines have a line.

It conceals everything that ropes have: ``UNABLE`` is empty.
"""

from importlib.metadata import version

from .march import World, imported, simulate

__all__ = ["BODIES", "UNABLE", "World", "about", "simulate"]

BODIES = ("rope",)
UNABLE = frozenset()


def about() -> dict:
    """What a label says of the engine."""
    imported()
    return {"pyelastica": version("pyelastica"), "integrator": "position Verlet"}
