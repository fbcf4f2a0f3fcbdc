"""Hands that give way, and hands that nobody listed."""

from ...methods.continuum.simulate import FIRM
from ...physics import terms
from .effect import Amount, Effect

__all__ = ["EFFECTS", "HOLD"]


def _yielding(amounts):
    """A hand that sags by s |g| under what it carries is a spring of w^2 = 1 / s for a unit of mass, in series with the firm one."""
    return {"grip_rate": (amounts["grip_sag"] + FIRM**-2) ** -0.5}


EFFECTS = (
    Effect(
        "grip_compliance",
        "grip",
        "hands give way under what they carry",
        None,
        ("solid", "rope", "sheet"),
        (Amount("grip_sag", 2e-4, 0.0, 0.02, "s^2"),),
        law=_yielding,
        shapes={"grip_damping": (1.0,)},
        alters=terms.SoftGrip,
        hides="grip",
        hand="grip_hand",
        motion="lifting, then shaking",
    ),
    Effect.of_term("grip", terms.SlidingHand, ("solid", "rope", "sheet"), hides="grip", hand="slide_hand"),
)

HOLD = Effect(  # asked by itself (``holding``): it has no amount, and its path is what was seen
    "hidden_tether",
    "contact",
    "something that the recording does not list holds a part of the body",
    None,
    ("solid", "rope", "sheet"),
    (),
    place="hold",
    motion="the same without touching it elsewhere",
)
