"""Which numbers of a system somebody may move while it runs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...physics.parameters import Parameter
from ...physics.system import System

__all__ = ["GRAVITY", "changed", "offered"]

GRAVITY = "gravity"
AXES = ("gravity_x", "gravity_y", "gravity_z")
PLACES = ("_x", "_y", "_z", "_offset", "_within", "_reach")  # ends of names that say where something is, which is not of the material
SHAPE = ("natural_a", "natural_b", "natural_kept")  # beginnings of names that say how a body is shaped at rest
INNER = ("controller_velocity", "collide_neighbours", "layer_rate", "layer_thickness", "coulomb_rate", "coulomb_damping", "grip_damping")
INNER += ("grip_hand", "firm_rate", "firm_damping", "slide_hand")


def offered(system: System) -> dict[str, Parameter]:
    """The parameters of the terms with their values in ``system``; gravity by its strength, in the direction that it has."""
    found = {}
    strength = float(np.linalg.norm([system.values.get(axis, 0.0) for axis in AXES]))
    if strength:
        found[GRAVITY] = Parameter(GRAVITY, min(strength, 30.0), 0.0, 30.0, "m/s^2", "strength of gravity")
    for term in system.terms:
        amplitudes = term.stands_for().amplitudes if term.effect is not None else ()
        for p in term.parameters:
            if p.name not in amplitudes and (p.name in (*AXES, *INNER) or p.name.endswith(PLACES) or p.name.startswith(SHAPE)):
                continue
            value = float(np.clip(term.values[p.name], p.low, p.high))
            found[p.name] = Parameter(p.name, value, p.low, p.high, p.unit, f"{term.name}: {p.meaning}", p.scale)
    return found


def changed(system: System, values: Mapping[str, float]) -> dict[str, float]:
    """What ``values`` by the names of ``offered`` are as parameters of the terms of ``system``."""
    found = {name: value for name, value in values.items() if name in system.values}
    if GRAVITY in values:
        g = np.array([system.values[axis] for axis in AXES])
        found |= dict(zip(AXES, g / np.linalg.norm(g) * values[GRAVITY], strict=True))
    return {name: float(value) for name, value in found.items()}
