"""Impulses between particles that come close, averaged over a particle's contacts."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .stages import ContactTerm

__all__ = ["SelfCollision"]


@wp.func
def impulse(xi: Any, xj: Any, vi: Any, vj: Any, mi: Any, mj: Any, p: Any, o: int):
    one = type(mi)(1.0)
    zero = type(mi)(0.0)
    apart = xj - xi
    distance = wp.length(apart)
    relative = vj - vi
    if distance >= p[o] or wp.dot(apart, relative) >= type(mi)(-1.0e-4):
        return type(xi)()
    elasticity = wp.clamp(p[o + 1], zero, one)
    friction = wp.clamp(p[o + 2], zero, type(mi)(2.0))
    n = apart / wp.max(distance, type(mi)(1.0e-6))
    speed = wp.dot(relative, n)
    normal = n * speed
    tangent = relative - normal
    slide = wp.length(tangent)
    keep = wp.max(zero, one - friction * (one + elasticity) * wp.abs(speed) / wp.max(slide, type(mi)(1.0e-6)))
    # i receives minus the sum of PhysTwin's J_n = -(1+e) v_n / (1/m_i + 1/m_j) and J_t = (a - 1) v_t / (1/m_i + 1/m_j)
    return (normal * (one + elasticity) + tangent * (one - keep)) / (one / mi + one / mj)


class SelfCollision(ContactTerm):
    """Restitution and friction between approaching particles closer than ``collision_dist`` (PhysTwin's code).

    Pairs are looked up once a frame; each particle gets the mean of its contacts' impulses (Jacobi), which does not conserve momentum
    where contact counts differ. As published, particles that a spring joins collide too; with ``collide_neighbours`` 0, particles that
    start closer than ``collision_dist`` never do.
    """

    name = "self_collision"
    parameters = (
        Parameter("collision_dist", 0.02, 0.0, 0.5, "m", "distance within which particles can meet"),
        Parameter("collide_object_elas", 0.7, 0.0, 1.0, "-", "restitution between particles"),
        Parameter("collide_object_fric", 0.3, 0.0, 2.0, "-", "Coulomb friction between particles"),
        Parameter("collide_neighbours", 1.0, 0.0, 1.0, "-", "1: particles that start close can meet as well, 0: they cannot"),
    )
    law = impulse
    effect = Effect(
        "self_contact",
        "parts of the body run into one another",
        amplitudes=("collision_dist",),
        typical={"collision_dist": 0.02},
        shapes={"collide_neighbours": (0.0,)},
        motion="folding it onto itself",
    )

    @staticmethod
    def twin(xi, xj, vi, vj, mi, mj, collision_dist, collide_object_elas, collide_object_fric, collide_neighbours):
        """The same law in numpy, for one ordered pair."""
        import numpy as np

        apart, relative = xj - xi, vj - vi
        distance = np.linalg.norm(apart)
        if distance >= collision_dist or apart @ relative >= -1e-4:
            return np.zeros(3)
        n = apart / max(distance, 1e-6)
        normal = n * (relative @ n)
        tangent = relative - normal
        loss = collide_object_fric * (1 + collide_object_elas) * np.linalg.norm(normal) / max(np.linalg.norm(tangent), 1e-6)
        keep = max(0.0, 1 - loss)
        return ((1 + collide_object_elas) * normal + (1 - keep) * tangent) / (1 / mi + 1 / mj)
