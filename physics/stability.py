"""How long a substep may be."""

from __future__ import annotations

import math

import numpy as np

from .system import System

__all__ = ["stable_step", "stable_substeps"]


def stable_step(system: System) -> float:
    """The longest stable substep [s] of the semi-implicit step, by a bound that never overestimates it near rest.

    With stiffness matrix K, damping matrix C and masses m, v <- v - dt (K x + C v) / m and x <- x + dt v are stable while
    lam dt^2 + 2 mu dt < 4 for the largest eigenvalues lam of K/m and mu of C/m (characteristic polynomial
    z^2 - (2 - mu dt - lam dt^2) z + (1 - mu dt)). Gershgorin bounds both by twice the largest sum over a particle's springs:
    lam <= 2 max sum(Y / L0) / m, mu <= 2 max sum(c) / m. Stiffening with stretch (F grows, L0 stays) is not in it.
    """
    stiffness, damping = np.zeros(system.particle_count), np.zeros(system.particle_count)
    dashpot = system.values.get("dashpot_damping", 0.0)
    for end in system.springs.T:
        inside = end < system.particle_count
        np.add.at(stiffness, end[inside], (system.stiffness / system.rest)[inside])
        np.add.at(damping, end[inside], dashpot)
    free = np.setdiff1d(np.arange(system.particle_count), system.grips)
    if not len(free):
        return math.inf
    lam = 2 * float((stiffness[free] / system.masses[free]).max())
    mu = 2 * float((damping[free] / system.masses[free]).max())
    if lam == 0:
        return 2 / mu if mu > 0 else math.inf
    return (math.sqrt(mu * mu + 4 * lam) - mu) / lam


def stable_substeps(systems, frame_seconds: float, *, safety: float = 0.5, least: int = 10) -> int:
    """Substeps per frame that keep every system's substep below ``safety`` times its stable step."""
    step = min(stable_step(s) for s in systems)
    return max(least, math.ceil(frame_seconds / (safety * step)) if math.isfinite(step) else least)
