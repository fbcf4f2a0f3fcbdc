"""A ground that rubs more along one direction than across it, as a fabric with a nap or a grooved board."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .ground import Ground, plane, rebound, touch
from .stages import MoveTerm

__all__ = ["DirectionalGround"]

LEVEL = 0.9  # a normal that close to the x axis takes its tangents from the y axis


@wp.func
def tangents(n: Any):
    """Two directions along the plane: that of the x axis as far as it lies in it, and the one a quarter turn on."""
    one = type(n[0])(1.0)
    zero = type(n[0])(0.0)
    steep = wp.abs(n[0]) > type(n[0])(wp.static(LEVEL))
    axis = type(n)(wp.where(steep, zero, one), wp.where(steep, one, zero), zero)
    first = wp.normalize(axis - n * wp.dot(n, axis))
    return first, wp.cross(n, first)


@wp.func
def graze(x: Any, v: Any, dt: Any, p: Any, o: int):
    n, height = plane(x, p, o)
    elasticity, friction = touch(p, o)
    first, second = tangents(n)
    a = wp.dot(v, first)
    b = wp.dot(v, second)
    square = wp.max(a * a + b * b, type(dt)(1.0e-12))
    more = (p[o + 6] * (a * a - b * b) + p[o + 7] * type(dt)(2.0) * a * b) / square
    return rebound(x, v, dt, n, height, elasticity, wp.max(friction + more, type(dt)(0.0)))


class DirectionalGround(MoveTerm):
    """The ground's impulses with mu + a cos 2 phi + b sin 2 phi, phi the direction of the slip in the plane, from the x axis on.

    The excess is sqrt(a^2 + b^2) along half of the angle of (a, b), and as much less across it; friction still points against the slip.
    With a = b = 0 it is ``Ground``, bit for bit. It stands in for ``Ground`` and has its parameters, by the same names.
    """

    name = "directional_ground"
    parameters = (
        *Ground.parameters,
        Parameter("friction_along", 0.0, -1.0, 1.0, "-", "friction above the mean along the x axis, and below it across"),
        Parameter("friction_diagonal", 0.0, -1.0, 1.0, "-", "friction above the mean between the x axis and the one a quarter turn on"),
    )
    law = graze
    effect = Effect(
        "friction_law",
        "the ground rubs more along one direction than across it",
        amplitudes=("friction_along", "friction_diagonal"),
        typical={"friction_along": 0.15, "friction_diagonal": 0.1},
        motion="dragging it over the table in several directions",
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
        friction_along,
        friction_diagonal,
    ):
        """The same law in numpy, for one particle."""
        import numpy as np

        n = np.array([ground_normal_x, ground_normal_y, ground_normal_z])
        axis = np.eye(3)[1 if abs(n[0]) > LEVEL else 0]
        first = axis - n * (n @ axis)
        first /= np.linalg.norm(first)
        a, b = v @ first, v @ np.cross(n, first)
        more = (friction_along * (a * a - b * b) + friction_diagonal * 2 * a * b) / max(a * a + b * b, 1e-12)
        friction = max(collide_fric + more, 0.0)
        plane = ground_normal_x, ground_normal_y, ground_normal_z, ground_offset
        return Ground.twin(x, v, dt, collide_elas, friction, *plane)
