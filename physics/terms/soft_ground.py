"""A ground with a soft top, as a blanket on the table: bodies sink into it before the hard plane below stops them."""

from typing import Any

import warp as wp

from ..parameters import Parameter
from .base import Effect
from .ground import Ground, plane, rebound, touch
from .stages import MoveTerm

__all__ = ["SoftGround"]


@wp.func
def sink(x: Any, v: Any, dt: Any, p: Any, o: int):
    n, height = plane(x, p, o)
    zero = type(dt)(0.0)
    elasticity, friction = touch(p, o)
    pad = p[o + 6]
    share = wp.clamp(-height / wp.max(pad, type(dt)(1.0e-6)), zero, type(dt)(1.0))
    press = wp.where(pad > zero, p[o + 7] * share * dt, zero)
    slide = v - n * wp.dot(n, v)
    keep = wp.max(zero, type(dt)(1.0) - friction * press / wp.max(wp.length(slide), type(dt)(1.0e-6)))
    slowed = n * (wp.dot(n, v) + press) + slide * keep
    after = wp.where(press > zero, slowed, v)
    return rebound(x, after, dt, n, height + pad, elasticity, friction)


class SoftGround(MoveTerm):
    """Above the hard plane, now ``pad`` deeper, a layer pushes up by up to ``firm`` per mass, in proportion to how far it is pressed.

    v_n += K s dt with s = -h / d in [0, 1], and friction takes up to mu K s dt of the slip; then the ground's impulses at the plane
    n . x = offset - d. With d = 0 it is ``Ground``. It stands in for ``Ground`` and has its parameters, by the same names.
    """

    name = "soft_ground"
    parameters = (
        *Ground.parameters,
        Parameter("ground_pad", 0.0, 0.0, 0.1, "m", "thickness of the soft layer"),
        Parameter("ground_firm", 30.0, 5.0, 300.0, "m/s^2", "its push per mass where it is pressed flat", "log"),
    )
    law = sink
    effect = Effect(
        "ground_pose",
        "the ground gives way under what lies on it",
        amplitudes=("ground_pad",),
        typical={"ground_pad": 0.01},
        shapes={"ground_firm": (15.0, 60.0)},
        motion="laying it down slowly, and letting it fall",
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
        ground_pad,
        ground_firm,
    ):
        """The same law in numpy, for one particle."""
        import numpy as np

        n = np.array([ground_normal_x, ground_normal_y, ground_normal_z])
        share = np.clip(-(n @ x - ground_offset) / max(ground_pad, 1e-6), 0, 1)
        press = ground_firm * share * dt if ground_pad > 0 else 0.0
        if press > 0:
            slide = v - n * (n @ v)
            slide = slide * max(0.0, 1 - collide_fric * press / max(np.linalg.norm(slide), 1e-6))
            v = n * (n @ v + press) + slide
        plane = ground_normal_x, ground_normal_y, ground_normal_z, ground_offset - ground_pad
        return Ground.twin(x, v, dt, collide_elas, collide_fric, *plane)
