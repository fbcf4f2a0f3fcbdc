"""A hand out of which a body slides while it is pulled hard."""

from typing import Any

import numpy as np
import warp as wp

from ..hands import is_meant, meant
from ..parameters import Parameter
from ..relaxation import settled
from .base import Effect
from .stages import SlipTerm

__all__ = ["SlidingHand"]

NOTHING = wp.constant(1.0e-12)  # m, and m/s^2: of which nothing is a share


@wp.func
def slide(apart: Any, pull: Any, m: Any, hand: Any, slid: Any, dt: Any, p: Any, o: int):
    far, pulled = wp.length(apart), wp.length(pull) / m
    beyond = wp.max(pulled - p[o + 1] * p[o + 2], type(m)(0.0)) / wp.max(pulled, type(m)(NOTHING))
    rate = wp.where(meant(p[o + 3], hand), p[o], type(m)(0.0)) * pulled / (p[o + 2] * wp.max(far, type(m)(NOTHING)))
    return slid + apart * (beyond * settled(rate * dt))


class SlidingHand(SlipTerm):
    """q' = c (a / b - s) a / |a|, where a held mass is pulled by a > s b, and else 0: Bingham's slider with a viscous rate.

    b is by what hands pull held masses while they carry all of the body at rest: where they hold alike, they let slip above s times its
    weight in all, by c [m/s] for each further weight. q' is integrated exactly while the lag stays, and ends where the pull is s b. The
    room's axes count: a hand that turns leaves behind what slid. Where one hand is named, the others hold fast.
    """

    name = "sliding_hand"
    parameters = (
        Parameter("slide_speed", 0.0, 0.0, 10.0, "m/s", "speed c of what slides out of hands, for each weight beyond what they hold"),
        Parameter("slide_weights", 1.0, 0.05, 20.0, "-", "weights s of the body that hands hold", scale="log"),
        Parameter(
            "slide_burden", 100.0, 1e-3, 1e6, "m/s^2", "b, by which hands pull what they hold while they carry the body", scale="log"
        ),
        Parameter("slide_hand", -1.0, -1.0, 9.0, "-", "number of the hand that lets slip; -1: all do"),
    )
    law = slide
    effect = Effect(
        name="grip_slip",
        says="it slides out of the hand when pulled hard",
        amplitudes=("slide_speed",),
        typical={"slide_speed": 0.1},
        shapes={"slide_weights": (0.3, 0.6, 1.2, 2.4)},
        motion="pull hard, and go back: what slipped does not return",
    )

    @staticmethod
    def twin(apart, pull, m, hand, slid, dt, slide_speed, slide_weights, slide_burden, slide_hand):
        """The same law in numpy."""
        slide_speed = slide_speed if is_meant(slide_hand, hand) else 0.0
        far, pulled = float(np.linalg.norm(apart)), float(np.linalg.norm(pull)) / m
        beyond = max(0.0, pulled - slide_weights * slide_burden) / max(pulled, 1e-12)
        return slid - apart * beyond * np.expm1(-slide_speed * pulled / (slide_burden * max(far, 1e-12)) * dt)
