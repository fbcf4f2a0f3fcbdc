"""A patch of the body that somebody carries along and the recording does not say so."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .places import bell, bell_twin, near
from .stages import ObserverTerm

__all__ = ["SecondHand"]


@wp.func
def carry(x: Any, v: Any, home: Any, y: Any, u: Any, m: Any, p: Any, o: int):
    return ((y - x) + (u - v) * p[o + 5]) * (m * p[o] * bell(home, p, o + 1))


class SecondHand(ObserverTerm):
    """F = m b w (y - x + t (u - v)), w = exp(-|home - c|^2 / (2 r^2)): a patch follows what was seen of it, at y [m] moving with u [m/s].

    An observer (Luenberger's) of bandwidth sqrt(b) and damping ratio t sqrt(b) / 2 in the patch alone: an unknown hand can be anywhere, so
    its path is read off the recording. It pulls only where particles were seen, and so explains the rest of the body, not the patch.
    """

    name = "second_hand"
    parameters = (
        Parameter("second_hand", 0.0, 0.0, 10000.0, "1/s^2", "squared bandwidth of the hold in the middle of the patch"),
        *near("second_hand", "second_hand_within"),
        Parameter("second_hand_lead", 0.05, 0.0, 0.5, "s", "damping of the hold: time over which it looks ahead"),
    )
    law = carry
    effect = Effect(
        "hidden_tether",
        "something moves a part of the body that the recording does not list",
        amplitudes=("second_hand",),
        typical={"second_hand": 500.0},
        shapes={"second_hand_within": (0.02, 0.04)},
        place="second_hand",
        within="second_hand_within",
        motion="the same without touching it elsewhere",
    )

    @staticmethod
    def twin(x, v, home, y, u, m, second_hand, second_hand_x, second_hand_y, second_hand_z, second_hand_within, second_hand_lead):
        """The same law in numpy."""
        share = bell_twin(home, (second_hand_x, second_hand_y, second_hand_z), second_hand_within)
        return ((y - x) + (u - v) * second_hand_lead) * (m * second_hand * share)
