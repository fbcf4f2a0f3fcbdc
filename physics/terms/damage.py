"""A solid that tears at one place when it is strained too far, and does not heal."""

from typing import Any

import numpy as np
import warp as wp

from ..parameters import Parameter
from ..relaxation import settled
from ..strains import deviator, deviator_twin, green, green_twin, poisson, poisson_twin
from .base import Effect
from .places import bell, bell_twin, near
from .stages import BranchTerm

__all__ = ["Damage"]

LOST = -0.95  # share of the stress that torn material adds: with none of it left its cells would turn inside out
TOUGHER = 10.0  # times the strain of tension does a bar bear in compression, as foams and gels do about
TINY = 1e-20  # of a squared strain, where the root has no derivative


@wp.func
def stress(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, p: Any, o: int):
    return stress * (q[0, 0] * type(mu)(LOST))


@wp.func
def tear(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, dt: Any, p: Any, o: int):
    one = type(mu)(1.0)
    nu = poisson(mu, lame)
    strain = green(deformed)
    beside = deviator(strain)
    swell = type(mu)(TOUGHER - 1.0) * wp.trace(strain) / (one - nu - nu)
    shear = type(mu)(6.0 * TOUGHER) * wp.ddot(beside, beside) / ((one + nu) * (one + nu))
    length = (swell + wp.sqrt(swell * swell + shear + type(mu)(TINY))) / type(mu)(2.0 * TOUGHER)
    beyond = wp.max(length / p[o + 1] - one, type(mu)(0.0))
    torn = q[0, 0] + (one - q[0, 0]) * settled(p[o] * bell(home, p, o + 2) * beyond * dt)
    none = one - one
    return wp.diag(type(home)(torn, none, none))


class Damage(BranchTerm):
    """P = (1 - 0.95 d) P_0 of the elasticity's own stress P_0, d' = r w (1 - d) max(0, e - e_c) / e_c, d in [0, 1].

    w = exp(-D^2 / 2 R^2) of the distance D from the place in frame 0. e is the modified von Mises strain of de Vree, Brekelmans and van
    Gils (1995) of the Green strain: that of a bar in tension, and a tenth of it in compression. Kachanov's damage variable with a linear
    overstrain; d' is integrated exactly while F holds still. It is local: the torn zone is as wide as the place's R, or a cell.
    """

    name = "damage"
    parameters = (
        Parameter("damage_rate", 0.0, 0.0, 1000.0, "1/s", "rate of damage at twice the tear strain"),
        Parameter("damage_strain", 0.1, 0.002, 2.0, "-", "strain at which tearing begins", scale="log"),
        *near("damage", "damage_radius"),
    )
    law = stress
    evolve = tear
    effect = Effect(
        name="tearing",
        says="it tears at one place when it is stretched too far",
        amplitudes=("damage_rate",),
        typical={"damage_rate": 20.0},
        shapes={"damage_strain": (0.02, 0.08), "damage_radius": (0.02, 0.05)},
        place="damage",
        within="damage_radius",
        motion="pull it apart harder and harder, and then once more: what tore stays loose",
    )

    @staticmethod
    def twin(stress, deformed, rate, home, mu, lame, q, damage_rate, damage_strain, damage_x, damage_y, damage_z, damage_radius):
        """The same law in numpy."""
        return stress * q[..., :1, :1] * LOST

    @staticmethod
    def twin_evolve(stress, deformed, rate, home, mu, lame, q, dt, damage_rate, damage_strain, damage_x, damage_y, damage_z, damage_radius):
        """The same memory in numpy."""
        nu, strain = poisson_twin(mu, lame), green_twin(deformed)
        beside = deviator_twin(strain)
        swell = (TOUGHER - 1) * np.trace(strain, axis1=-2, axis2=-1) / (1 - 2 * nu)
        shear = 6 * TOUGHER * (beside * beside).sum((-1, -2)) / (1 + nu) ** 2
        beyond = np.maximum((swell + np.sqrt(swell**2 + shear + TINY)) / (2 * TOUGHER) / damage_strain - 1, 0.0)
        w = bell_twin(home, (damage_x, damage_y, damage_z), damage_radius)
        torn = 1 - (1 - q[..., 0, 0]) * np.exp(-damage_rate * w * beyond * dt)
        return torn[..., None, None] * np.diag([1.0, 0, 0])
