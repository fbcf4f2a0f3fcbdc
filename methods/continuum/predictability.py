"""How well a sound twin can predict each coordinate of a recording, from a small ensemble of sound twins.

Twins of one body that differ in what nobody knows (mesh, contact, step, grip) part in the course of a motion. What a fit of the parameters
would absorb of that is no error of prediction; what it cannot is, and data there are not to be heard. One Gauss-Newton step with the
reference's Jacobian tells the two apart (approximation error: Kaipio and Somersalo 2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Predictability", "absorbed", "predictability", "smoothed"]

ROUNDS = 3  # of absorption, each weighted by the spread that the last one left, as the fit will be
FEWEST = 4  # members of whose spread something is to be known: a variance of three degrees of freedom


@dataclass(frozen=True)
class Predictability:
    """spread (R,): root mean square of what members' fits leave, in the unit of the data; sd (R,): with the noise; shifts (K, n): what fits
    absorbed, in the scaled space of the unknowns; members (K,): those that did not diverge."""

    spread: np.ndarray
    sd: np.ndarray
    shifts: np.ndarray
    members: np.ndarray

    @property
    def weight(self) -> np.ndarray:
        """(R,) 1 / (noise^2 + spread^2), for squares of residuals."""
        return self.sd**-2


def absorbed(apart, jacobian, sd, precision: float | Sequence[float] | np.ndarray = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """(shifts (K, n), what they leave (K, R)) of a Gauss-Newton step from the reference to each of K runs ``apart`` (K, R) from it.

    jacobian (R, n); sd (R,) by which the step weighs; precision (n,) of the unknowns' priors around the reference.
    """
    weighted = jacobian / np.asarray(sd)[:, None] ** 2
    matrix = weighted.T @ jacobian + np.diag(np.broadcast_to(np.asarray(precision, float), jacobian.shape[1:]))
    shifts = np.linalg.lstsq(matrix, weighted.T @ np.asarray(apart).T, rcond=1e-12)[0].T
    return shifts, apart - shifts @ jacobian.T


def smoothed(squares, block, time, width: float) -> np.ndarray:
    """(R,) ``squares`` averaged within each ``block`` (R,) at each ``time`` (R,), then by a normal kernel in time of ``width`` (0: not)."""
    squares, out = np.asarray(squares, float), np.empty(len(squares))
    for name in np.unique(block):
        own = np.flatnonzero(block == name)
        times, at, count = np.unique(time[own], return_inverse=True, return_counts=True)
        mean = np.bincount(at, squares[own]) / count
        if width > 0:
            near = np.exp(-0.5 * np.square(np.minimum(np.abs(times[:, None] - times), 40 * width) / width)) * count
            mean = near @ mean / near.sum(1)
        out[own] = mean[at]
    return out


def predictability(
    runs, reference, jacobian, noise, *, block, time, width: float, precision: float | Sequence[float] | np.ndarray = 0.0
) -> Predictability:
    """How well each of R coordinates can be predicted.

    runs, reference  (K, R) of the members and (R,) of the twin that is fitted; a member that diverged has NaN and is left out
    jacobian         (R, n) of the reference by its unknowns in the scaled space; ``precision`` (n,) of their priors
    noise            (R,) standard deviation, infinite where nothing was measured
    block, time      (R,) which coordinates share a spread (a track, a region), and when they were measured; ``width`` of smoothing, in the
                     unit of time

    Raises ValueError with fewer than four members that did not diverge, and where shapes do not agree.
    """
    runs, reference, jacobian, noise = (np.asarray(a, float) for a in (runs, reference, jacobian, noise))
    block, time = np.asarray(block), np.asarray(time, float)
    count = len(reference)
    if runs.ndim != 2 or runs.shape[1] != count or any(len(a) != count for a in (jacobian, noise, block, time)):
        shapes = ", ".join(str(np.shape(a)) for a in (runs, reference, jacobian, noise, block, time))
        raise ValueError(f"runs (K, R), reference (R,), jacobian (R, n), noise, block and time (R,) must share R, got {shapes}")
    if not (np.isfinite(width) and width >= 0):
        raise ValueError(f"width must be >= 0, got {width}")
    if not (noise > 0).all() or not np.isfinite(noise).any():
        raise ValueError("noise must be > 0 and finite for some data")
    alive = np.flatnonzero(np.isfinite(runs).all(1))
    if len(alive) < FEWEST:
        raise ValueError(f"at least {FEWEST} members must not diverge, got {len(alive)} of {len(runs)}")
    sd, seen = noise, np.isfinite(noise)
    spread = np.zeros(count)
    for _ in range(ROUNDS):
        shifts, left = absorbed((runs[alive] - reference)[:, seen], jacobian[seen], sd[seen], precision)
        spread[seen] = np.sqrt(smoothed(np.mean(left**2, 0), block[seen], time[seen], width))
        sd = np.hypot(noise, spread)
    return Predictability(spread, sd, shifts, alive)
