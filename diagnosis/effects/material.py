"""What a solid's material may be beside neo-Hookean and viscous, and a sheet's beside linear, isotropic and viscous.

Fibres and yarns are tried in four directions of the body's plane.
"""

from math import pi

from ...physics import terms
from .effect import Effect

__all__ = ["EFFECTS"]

SOLID, SHEET = ("solid",), ("sheet",)
AROUND = (0.0, pi / 4, pi / 2, -pi / 4)
WAYS = {"fibre_azimuth": AROUND, "fibre_elevation": (0.0,), "fibre_compression": (1.0,)}

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
    Effect.of_term("material", terms.Yarns, SHEET, shapes={"yarn_azimuth": AROUND}),
    Effect.of_term("material", terms.SheetTension, SHEET),
    Effect.of_term("material", terms.MembraneStiffening, SHEET, shapes={"membrane_knee": (0.02,)}),
    Effect.of_term("material", terms.MembraneSlack, SHEET),
    Effect.of_term("material", terms.SheetRelaxing, SHEET),
    Effect.of_term("material", terms.SheetFriction, SHEET),
    Effect.of_term("material", terms.SheetCreep, SHEET),
    Effect.of_term("material", terms.SheetYielding, SHEET),
)
