"""A plane that particles bounce off and slide on, with the time of impact resolved inside the substep."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .stages import MoveTerm

__all__ = ["Ground", "plane", "rebound", "touch"]


@wp.func
def plane(x: Any, p: Any, o: int):
    """The ground's normal, and how high above it a particle is."""
    n = type(x)()
    n[0] = p[o + 2]
    n[1] = p[o + 3]
    n[2] = p[o + 4]
    return n, wp.dot(n, x) - p[o + 5]


@wp.func
def rebound(x: Any, v: Any, dt: Any, n: Any, height: Any, elasticity: Any, friction: Any):
    """Position and velocity after a substep above the ground or with an impact on it."""
    one = type(dt)(1.0)
    zero = type(dt)(0.0)
    speed = wp.dot(n, v)
    if height + speed * dt < zero and speed < type(dt)(-1.0e-4):
        normal = n * speed
        tangent = v - normal
        slide = wp.length(tangent)
        keep = wp.max(zero, one - friction * (one + elasticity) * wp.abs(speed) / wp.max(slide, type(dt)(1.0e-6)))
        after = tangent * keep - normal * elasticity
        impact = -height / speed
        return x + v * impact + after * (dt - impact), after
    return x + v * dt, v


@wp.func
def touch(p: Any, o: int):
    """The ground's restitution and friction, within their bounds."""
    zero = type(p[o])(0.0)
    return wp.clamp(p[o], zero, type(p[o])(1.0)), wp.clamp(p[o + 1], zero, type(p[o])(2.0))


@wp.func
def bounce(x: Any, v: Any, dt: Any, p: Any, o: int):
    n, height = plane(x, p, o)
    elasticity, friction = touch(p, o)
    return rebound(x, v, dt, n, height, elasticity, friction)


class Ground(MoveTerm):
    """Restitution and Coulomb friction as impulses: v_n -> -e v_n, v_t -> max(0, 1 - mu (1+e) |v_n| / |v_t|) v_t (PhysTwin's code).

    The impact happens at t* = -h / v_n within the substep; a particle that already is below the plane has t* < 0 and is pulled back
    along its velocity, as published. The plane is n . x = offset; its normal is taken as given, not normalised.
    """

    name = "ground"
    parameters = (
        Parameter("collide_elas", 0.5, 0.0, 1.0, "-", "restitution of the ground"),
        Parameter("collide_fric", 0.3, 0.0, 2.0, "-", "Coulomb friction of the ground"),
        Parameter("ground_normal_x", 0.0, -1.0, 1.0, "-", "ground normal, x"),
        Parameter("ground_normal_y", 0.0, -1.0, 1.0, "-", "ground normal, y"),
        Parameter("ground_normal_z", -1.0, -1.0, 1.0, "-", "ground normal, z"),
        Parameter("ground_offset", 0.0, -10.0, 10.0, "m", "distance of the plane from the origin along its normal"),
    )
    law = bounce

    @staticmethod
    def twin(x, v, dt, collide_elas, collide_fric, ground_normal_x, ground_normal_y, ground_normal_z, ground_offset):
        """The same law in numpy, for one particle."""
        import numpy as np

        n = np.array([ground_normal_x, ground_normal_y, ground_normal_z])
        height, speed = n @ x - ground_offset, n @ v
        if not (height + speed * dt < 0 and speed < -1e-4):
            return x + v * dt, v
        tangent = v - n * speed
        loss = collide_fric * (1 + collide_elas) * abs(speed) / max(np.linalg.norm(tangent), 1e-6)
        after = tangent * max(0.0, 1 - loss) - n * speed * collide_elas
        impact = -height / speed
        return x + v * impact + after * (dt - impact), after
