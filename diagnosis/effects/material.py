"""What a solid's material may be beside neo-Hookean and viscous. Fibres are tried in four directions of the body's plane and across it."""

from math import pi

from ...physics import terms
from .effect import Effect

__all__ = ["EFFECTS"]

SOLID = ("solid",)
WAYS = {"fibre_azimuth": (0.0, pi / 4, pi / 2, -pi / 4), "fibre_elevation": (0.0,), "fibre_compression": (1.0,)}

EFFECTS = (
    Effect.of_term("material", terms.Fibres, SOLID, shapes=WAYS),
    Effect.of_term("material", terms.Fung, SOLID, shapes={"fung_exponent": (10.0,)}),
    Effect.of_term("material", terms.TensionCompression, SOLID),
    Effect.of_term("material", terms.Inflation, SOLID, shapes={"inflation_fill": (1.0,)}),
    Effect.of_term("material", terms.Maxwell, SOLID, shapes={"maxwell_time": (0.05, 0.2, 0.8)}),
    Effect.of_term("material", terms.DahlFriction, SOLID, shapes={"dahl_strain": (0.02,)}),
    Effect.of_term("material", terms.NortonCreep, SOLID, shapes={"norton_exponent": (1.0,)}),
    Effect.of_term("material", terms.Yielding, SOLID, shapes={"solid_yield_strain": (0.03,)}),
    Effect.of_term("material", terms.GrownShape, SOLID),
)
