"""What acts on a body from outside: air, gravity, weights, cords, the ground."""

from ...physics import terms
from .effect import Amount, Effect

__all__ = ["EFFECTS"]

ALL = ("solid", "rope", "sheet")
GROUND = {"ground_raise": 1e-3, "ground_tilt_a": 5e-3, "ground_tilt_b": 5e-3}

EFFECTS = (
    Effect.of_term("environment", terms.Wind, ALL, shapes={"wind_speed": (2.0, 4.0)}),
    Effect.of_term("environment", terms.QuadraticDrag, ALL),
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
