"""Something in the room that the body runs into and the recording does not list."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .places import coordinates
from .stages import BodyTerm

__all__ = ["HiddenObstacle"]

SOFT = 0.002  # m: depth over which the push begins, smoothly
RECOIL = 0.5  # m/s: approaching at this speed doubles the push, leaving at it ends it
FRICTION = 0.3  # Coulomb coefficient, as the ground's usual one
CREEP = 0.05  # m/s: friction is linear in slip below this speed


@wp.func
def fend(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    one = type(m)(1.0)
    zero = type(m)(0.0)
    apart = type(x)()
    apart[0] = x[0] - p[o + 2]
    apart[1] = x[1] - p[o + 3]
    apart[2] = x[2] - p[o + 4]
    distance = wp.max(wp.length(apart), type(m)(1.0e-6))
    deep = wp.max(zero, p[o + 1] - distance)
    n = apart / distance
    speed = wp.dot(v, n)
    push = m * p[o] * deep * deep / (deep + type(m)(wp.static(SOFT))) * wp.max(zero, one - speed / type(m)(wp.static(RECOIL)))
    slip = v - n * speed
    drag = type(m)(wp.static(FRICTION)) / wp.sqrt(wp.dot(slip, slip) + type(m)(wp.static(CREEP * CREEP)))
    return (n - slip * drag) * push


class HiddenObstacle(BodyTerm):
    """A sphere that pushes out what is inside: F = P (n - mu v_t / sqrt(|v_t|^2 + v_c^2)), P = m k d^2 / (d + s) max(0, 1 - v_n / v_r).

    d is the depth, n the outward normal, v_n and v_t the velocity along it and across. The damping is Hunt and Crossley's: in proportion to
    the push, so that nothing sticks. s = 2 mm, v_r = 0.5 m/s, mu = 0.3, v_c = 0.05 m/s. The middle is a place in the room.
    """

    name = "hidden_obstacle"
    parameters = (
        Parameter("hidden_obstacle", 0.0, 0.0, 20000.0, "1/s^2", "push per mass and metre of depth"),
        Parameter("obstacle_radius", 0.05, 0.005, 1.0, "m", "radius of the sphere", "log"),
        *coordinates("obstacle", "middle of the sphere in the room"),
    )
    law = fend
    effect = Effect(
        "hidden_obstacle",
        "something is in the way that the recording does not list",
        amplitudes=("hidden_obstacle",),
        typical={"hidden_obstacle": 2000.0},
        shapes={"obstacle_radius": (0.03, 0.08)},
        place="obstacle",
        within="obstacle_radius",
        roaming=True,
        motion="passing the place from two sides",
    )

    @staticmethod
    def twin(x, v, home, m, hidden_obstacle, obstacle_radius, obstacle_x, obstacle_y, obstacle_z):
        """The same law in numpy."""
        import numpy as np

        apart = x - np.array([obstacle_x, obstacle_y, obstacle_z])
        distance = max(np.linalg.norm(apart), 1e-6)
        deep, n = max(0.0, obstacle_radius - distance), apart / distance
        speed = v @ n
        push = m * hidden_obstacle * deep * deep / (deep + SOFT) * max(0.0, 1 - speed / RECOIL)
        slip = v - n * speed
        return (n - slip * (FRICTION / np.sqrt(slip @ slip + CREEP**2))) * push
