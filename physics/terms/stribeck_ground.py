"""A ground that holds on more to what rests on it than to what slides."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .ground import Ground, plane, rebound, touch
from .stages import MoveTerm

__all__ = ["StribeckGround"]


@wp.func
def slip(x: Any, v: Any, dt: Any, p: Any, o: int):
    n, height = plane(x, p, o)
    elasticity, friction = touch(p, o)
    slide = (v - n * wp.dot(n, v)) / p[o + 7]
    return rebound(x, v, dt, n, height, elasticity, friction + p[o + 6] * wp.exp(-wp.dot(slide, slide)))


class StribeckGround(MoveTerm):
    """The ground's impulses with mu(v_t) = mu_k + a exp(-(v_t / v_s)^2), v_t the speed along the plane before the impact (Stribeck).

    Static friction is mu_k + a, and passes into the kinetic mu_k around the speed v_s; with a = 0 it is ``Ground``, bit for bit. It
    stands in for ``Ground`` and has its parameters, by the same names: a system has one or the other.
    """

    name = "stribeck_ground"
    parameters = (
        *Ground.parameters,
        Parameter("friction_excess", 0.0, 0.0, 2.0, "-", "static friction above kinetic friction"),
        Parameter("friction_speed", 0.05, 1e-3, 2.0, "m/s", "speed over which friction falls from static to kinetic", "log"),
    )
    law = slip
    effect = Effect(
        "friction_law",
        "static friction on the ground exceeds kinetic friction",
        amplitudes=("friction_excess",),
        typical={"friction_excess": 0.4},
        shapes={"friction_speed": (0.02, 0.2)},
        motion="dragging it over the table slowly, then faster",
    )

    @staticmethod
    def twin(
        x,
        v,
        dt,
        collide_elas,
        collide_fric,
        ground_normal_x,
        ground_normal_y,
        ground_normal_z,
        ground_offset,
        friction_excess,
        friction_speed,
    ):
        """The same law in numpy, for one particle."""
        import numpy as np

        n = np.array([ground_normal_x, ground_normal_y, ground_normal_z])
        slide = (v - n * (n @ v)) / friction_speed
        friction = collide_fric + friction_excess * np.exp(-(slide @ slide))
        plane = ground_normal_x, ground_normal_y, ground_normal_z, ground_offset
        return Ground.twin(x, v, dt, collide_elas, friction, *plane)
