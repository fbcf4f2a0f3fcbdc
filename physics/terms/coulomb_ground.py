"""A plane that the skin of a body presses into a little, sticks to and slides on."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from .stages import TouchTerm

__all__ = ["CoulombGround"]


@wp.func
def pressed(x: Any, v: Any, m: Any, p: Any, o: int):
    """The plane's normal, and the pressure of the plane on the point [N], which only pushes."""
    n = type(x)(p[o + 3], p[o + 4], p[o + 5])
    zero = type(m)(0.0)
    deep = p[o + 6] - wp.dot(n, x)
    push = m * p[o + 1] * (p[o + 1] * deep - type(m)(2.0) * p[o + 2] * wp.dot(n, v))
    return n, wp.where(deep > zero, wp.max(push, zero), zero)


@wp.func
def capped(pull: Any, most: Any):
    """A pull, no longer than ``most``."""
    return pull * wp.min(type(most)(1.0), most / wp.max(wp.length(pull), type(most)(1.0e-12)))


@wp.func
def grip(slip: Any, p: Any, o: int):
    """The coefficient of friction at a velocity along the plane."""
    share = wp.length(slip) / p[o + 8]
    return p[o] + p[o + 7] * wp.exp(-share * share)


@wp.func
def hold_up(x: Any, v: Any, m: Any, q: Any, p: Any, o: int):
    n, push = pressed(x, v, m, p, o)
    slip = v - n * wp.dot(n, v)
    pull = (q * p[o + 1] + slip * (type(m)(2.0) * p[o + 2])) * (-m * p[o + 1])
    return n * push + capped(pull, grip(slip, p, o) * push)


@wp.func
def stretch(x: Any, v: Any, m: Any, q: Any, dt: Any, p: Any, o: int):
    n, push = pressed(x, v, m, p, o)
    after = q + v * dt
    after = after - n * wp.dot(n, after)
    slip = v - n * wp.dot(n, v)
    return capped(after, grip(slip, p, o) * push / (m * p[o + 1] * p[o + 1]))


class CoulombGround(TouchTerm):
    """N = m w (w d - 2 z v_n) > 0 at depth d, and T = -m w (w q + 2 z v_t), |T| <= mu N, of the tangential stretch q since the point stuck.

    q grows with the tangential motion and is never longer than mu N / (m w^2), so that a point sticks where it lies, without creep, until
    friction is overcome, and a point that leaves the plane forgets. d at rest is about g / w^2 times the body's mass over what its
    touching points carry. The plane is n . x = offset. Friction may be higher at rest: mu + a exp(-(v_t / v_s)^2) (Stribeck).
    Bristles: Haessig and Friedland, "On the modeling and simulation of friction", 1991.
    """

    name = "coulomb_ground"
    parameters = (
        Parameter("coulomb_friction", 0.4, 0.0, 3.0, "-", "Coulomb friction mu"),
        Parameter("coulomb_rate", 300.0, 10.0, 3000.0, "1/s", "angular frequency w of a point's mass on the plane"),
        Parameter("coulomb_damping", 0.5, 0.0, 2.0, "-", "damping ratio z of that"),
        Parameter("coulomb_normal_x", 0.0, -1.0, 1.0, "-", "the plane's normal, x"),
        Parameter("coulomb_normal_y", 0.0, -1.0, 1.0, "-", "the plane's normal, y"),
        Parameter("coulomb_normal_z", -1.0, -1.0, 1.0, "-", "the plane's normal, z"),
        Parameter("coulomb_offset", 0.0, -10.0, 10.0, "m", "distance of the plane from the origin along its normal"),
        Parameter("coulomb_rest_friction", 0.0, 0.0, 2.0, "-", "a, by how much friction is higher at rest"),
        Parameter("coulomb_speed", 0.05, 1e-3, 2.0, "m/s", "v_s, over which it falls to that of sliding", "log"),
    )
    law = hold_up
    evolve = stretch

    @staticmethod
    def hardness(coulomb_rate, coulomb_damping, **others):
        return coulomb_rate**2, 2 * coulomb_damping * coulomb_rate

    @staticmethod
    def twin(x, v, m, q, *values):
        """The same law in numpy, for one point."""
        friction, rate, damping, n, push = push_of(x, v, m, *values)
        return n * push + shortened(-m * rate * (rate * q + 2 * damping * (v - n * (n @ v))), friction * push)

    @staticmethod
    def twin_evolve(x, v, m, q, dt, *values):
        """How far friction is stretched after a substep, in numpy."""
        friction, rate, _damping, n, push = push_of(x, v, m, *values)
        after = q + v * dt
        return shortened(after - n * (n @ after), friction * push / (m * rate**2))


def push_of(x, v, m, friction, rate, damping, normal_x, normal_y, normal_z, offset, rest_friction, speed):
    """(friction, rate, damping, normal, pressure [N]) in numpy."""
    n = np.array([normal_x, normal_y, normal_z])
    deep, slip = offset - n @ x, v - n * (n @ v)
    friction = friction + rest_friction * np.exp(-(slip @ slip) / speed**2)
    return friction, rate, damping, n, max(0.0, m * rate * (rate * deep - 2 * damping * (n @ v))) if deep > 0 else 0.0


def shortened(pull, most):
    return pull * min(1.0, most / max(np.linalg.norm(pull), 1e-12))
