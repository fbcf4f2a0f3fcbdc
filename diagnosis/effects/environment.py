"""What acts on a body from outside: air, gravity, weights, cords, the ground."""

from dataclasses import replace

from ...physics import terms
from .effect import Amount, Effect

__all__ = ["EFFECTS"]

ALL = ("solid", "rope", "sheet")
THIN = ("rope", "sheet")  # as much mass as skin everywhere: air that pulls at mass is air that pulls at skin
SOLID = ("solid",)  # where air pulls at the skin alone
SPEEDS = {"wind_speed": (2.0, 4.0)}
GROUND = {"ground_raise": 1e-3, "ground_tilt_a": 5e-3, "ground_tilt_b": 5e-3}

EFFECTS = (
    Effect.of_term("environment", terms.Wind, THIN, shapes=SPEEDS),
    replace(Effect.of_term("environment", terms.Wind, SOLID, shapes=SPEEDS), term=terms.SkinWind),
    Effect.of_term("environment", terms.QuadraticDrag, THIN),
    replace(Effect.of_term("environment", terms.QuadraticDrag, SOLID), term=terms.SkinDrag),
    Effect.of_term("environment", terms.GravityTilt, ALL),
    Effect.of_term("environment", terms.AddedMass, ALL, shapes={"added_mass_within": (0.03,)}),
    Effect.of_term("contact", terms.HiddenTether, ALL, shapes={"tether_within": (0.03,), "tether_length": (0.03,)}),
    Effect.of_term("contact", terms.HiddenObstacle, ALL, shapes={"obstacle_radius": (0.04,)}),
    Effect.of_term("contact", terms.GroundPose, ALL, grounded=True, usual=GROUND),
    Effect(
        "friction_law",
        "contact",
        "static friction on the ground exceeds kinetic friction",
        None,
        ALL,
        (Amount("coulomb_rest_friction", 0.4, 0.0, 2.0, "-"),),
        shapes={"coulomb_speed": (0.06,)},
        grounded=True,
        motion="dragging it over the table slowly, then faster",
    ),
    Effect.of_term("contact", terms.GroundAdhesion, ALL, shapes={"adhesion_reach": (0.01,)}, grounded=True),
)
