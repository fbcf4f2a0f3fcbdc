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
    z^2 - (2 - mu dt - lam dt^2) z + (1 - mu dt)). Gershgorin bounds both by the largest row sum over a free particle's springs, in
    which a spring counts twice where its other end is free as well. A Maxwell branch a Y that relaxes by s = 1 - exp(-dt / tau) a substep
    makes a spring 1 + a + a s / (2 - s) times as stiff at that limit (where z = -1), and s / (2 - s) = tanh(dt / (2 tau)). The bound holds
    for stretched springs too (the law is linear and the transverse stiffness of a spring in tension stays below Y / L0); strong compression
    and fast rotation with dashpots are not in it.
    """
    free = np.ones(system.particle_count + system.controllers.shape[1], bool)
    free[system.particle_count :] = False
    free[system.grips[system.grips >= 0]] = False
    stiffness, damping = np.zeros(len(free)), np.zeros(len(free))
    dashpot = system.values.get("dashpot_damping", 0.0)
    for end, other in (system.springs.T, system.springs.T[::-1]):
        times = 1 + free[other]
        np.add.at(stiffness, end, times * system.stiffness / system.rest)
        np.add.at(damping, end, times * dashpot)
    inside = np.flatnonzero(free)
    if not len(inside):
        return math.inf
    lam = float((stiffness[inside] / system.masses[inside]).max())
    mu = float((damping[inside] / system.masses[inside]).max())

    def limit(times):
        bound = mu + math.sqrt(mu * mu + 4 * lam * times)
        return 4 / bound if bound > 0 else math.inf

    branch = system.values.get("branch_stiffness", 0.0)
    if not branch:
        return limit(1.0)
    # the branch relaxes less in the substep that it leaves than in a longer one, so this does not overestimate either
    return limit(1 + branch * (1 + math.tanh(limit(1 + branch) / (2 * system.values["relaxation_time"]))))


def stable_substeps(systems, frame_seconds: float, *, safety: float = 0.5, least: int = 10) -> int:
    """Substeps per frame that keep every system's substep below ``safety`` times its stable step."""
    step = min(stable_step(s) for s in systems)
    return max(least, math.ceil(frame_seconds / (safety * step)) if math.isfinite(step) else least)
