"""Layers of sheets and strands of ropes that press on each other and rub."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from .stages import LayerTerm

__all__ = ["LayerContact"]

PRESSED = 0.2  # of the thickness: where less is left, pressure goes on at the secant there; the step stays stable up to it
SOFT = 0.2  # of the thickness, over which damping of the approach begins: a jump at the first touch would have no derivative


@wp.func
def keep_apart(apart: Any, rate: Any, m: Any, p: Any, o: int):
    zero = type(m)(0.0)
    one = type(m)(1.0)
    distance = wp.max(wp.length(apart), type(m)(1.0e-9))
    n = apart / distance
    gap = p[o] - distance
    h = wp.max(p[o], type(m)(1.0e-9))
    left = wp.max(distance / h, type(m)(PRESSED))
    damping = m * p[o + 1] * (p[o + 2] + p[o + 2])
    closing = wp.dot(rate, n)
    slowed = damping * closing * wp.clamp(gap / (h * type(m)(SOFT)), zero, one)
    push = wp.where(gap > zero, wp.max(m * p[o + 1] * p[o + 1] * gap / left - slowed, zero), zero)
    drag = (rate - n * closing) * -damping
    return n * push + drag * wp.min(one, p[o + 3] * push / wp.max(wp.length(drag), type(m)(1.0e-12)))


class LayerContact(LayerTerm):
    """N = m w (w (h - d) h / d - 2 z v_n) > 0 at a distance d well below the thickness h, and T = -2 m w z v_t, |T| <= mu N.

    m is a share of a node's mass such that a node between two layers of as fine a mesh feels w (``physics.layers``). Friction is that of
    Coulomb, regularised: what sticks creeps. Nothing is remembered, so that two layers that have passed through each other stay so.
    """

    name = "layer_contact"
    parameters = (
        Parameter("layer_thickness", 0.003, 0.0, 0.1, "m", "distance h of the middles of layers or strands that touch"),
        Parameter("layer_rate", 600.0, 1.0, 1e5, "1/s", "angular frequency w of a node between layers", "log"),
        Parameter("layer_damping", 0.5, 0.0, 2.0, "-", "damping ratio z of that"),
        Parameter("layer_friction", 0.3, 0.0, 3.0, "-", "Coulomb friction mu between layers"),
    )
    law = keep_apart

    @staticmethod
    def hardness(layer_rate, layer_damping, **others):
        return layer_rate**2, 2 * layer_damping * layer_rate

    @staticmethod
    def twin(apart, rate, m, layer_thickness, layer_rate, layer_damping, layer_friction):
        """The same law in numpy, for one pair."""
        distance = max(np.linalg.norm(apart), 1e-9)
        n, gap = apart / distance, layer_thickness - distance
        if gap <= 0:
            return np.zeros(3)
        h = max(layer_thickness, 1e-9)
        closing, soft = rate @ n, min(1.0, gap / (SOFT * h))
        push = max(m * layer_rate**2 * gap / max(distance / h, PRESSED) - 2 * m * layer_rate * layer_damping * closing * soft, 0.0)
        drag = -2 * m * layer_rate * layer_damping * (rate - closing * n)
        return n * push + drag * min(1.0, layer_friction * push / max(np.linalg.norm(drag), 1e-12))
