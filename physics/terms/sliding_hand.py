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
SHORT = wp.constant(1.0 - 1.0e-5)  # of the farthest: what has come so far, to rounding, has arrived


@wp.func
def slide(apart: Any, pull: Any, m: Any, hand: Any, slid: Any, dt: Any, p: Any, o: int):
    far, pulled = wp.length(apart), wp.length(pull) / m
    beyond = wp.max(pulled - p[o + 1] * p[o + 2], type(m)(0.0)) / wp.max(pulled, type(m)(NOTHING))
    rate = wp.where(meant(p[o + 4], hand), p[o + 3], type(m)(0.0)) * pulled / (p[o + 2] * wp.max(far, type(m)(NOTHING)))
    gone = slid + apart * (beyond * settled(rate * dt))
    way, most = wp.length(gone), p[o]
    within = wp.where(way > most, most / wp.max(way, type(m)(NOTHING)), type(m)(1.0))
    return wp.where(wp.length(slid) < most * type(m)(SHORT), gone * within, slid)


class SlidingHand(SlipTerm):
    """q' = c (a / b - s) a / |a|, where a held mass is pulled by a > s b, and else 0: Bingham's slider with a viscous rate.

    b is by what hands pull held masses while they carry all of the body at rest: where they hold alike, they let slip above s times its
    weight in all, by c [m/s] for each further weight, and hold fast again once |q| is d: at a knot, or as fingers close. q' is integrated
    exactly while the lag stays, and ends where the pull is s b. The room's axes count: a hand that turns leaves behind what slid. Where one
    hand is named, the others hold fast.
    """

    name = "sliding_hand"
    parameters = (
        Parameter("slide_most", 0.0, 0.0, 1.0, "m", "how far d what is held slides until it is held again"),
        Parameter("slide_weights", 1.0, 0.05, 20.0, "-", "weights s of the body that hands hold", scale="log"),
        Parameter(
            "slide_burden", 100.0, 1e-3, 1e6, "m/s^2", "b, by which hands pull what they hold while they carry the body", scale="log"
        ),
        Parameter("slide_speed", 0.1, 1e-3, 10.0, "m/s", "speed c of what slides, for each weight beyond what hands hold", scale="log"),
        Parameter("slide_hand", -1.0, -1.0, 9.0, "-", "number of the hand that lets slip; -1: all do"),
    )
    law = slide
    effect = Effect(
        name="grip_slip",
        says="it slides out of the hand when pulled hard",
        amplitudes=("slide_most",),
        typical={"slide_most": 0.02},
        shapes={"slide_weights": (0.3, 0.6, 1.2, 2.4), "slide_speed": (0.03, 0.3)},
        motion="pull hard, and go back: what slipped does not return",
    )

    @staticmethod
    def twin(apart, pull, m, hand, slid, dt, slide_most, slide_weights, slide_burden, slide_speed, slide_hand):
        """The same law in numpy."""
        slide_speed = slide_speed if is_meant(slide_hand, hand) else 0.0
        far, pulled = float(np.linalg.norm(apart)), float(np.linalg.norm(pull)) / m
        beyond = max(0.0, pulled - slide_weights * slide_burden) / max(pulled, 1e-12)
        gone = slid - apart * beyond * np.expm1(-slide_speed * pulled / (slide_burden * max(far, 1e-12)) * dt)
        way = float(np.linalg.norm(gone))
        return gone * min(1.0, slide_most / max(way, 1e-12)) if np.linalg.norm(slid) < slide_most * (1 - 1e-5) else slid
