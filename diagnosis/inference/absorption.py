"""What a refit of the reference twin would absorb of a run, be it a sound twin's or what was measured, and what is left."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .slopes import corrected

__all__ = ["absorb"]

Run = Callable[[np.ndarray], np.ndarray]
SHORTER = 0.3  # times the step that led to something worse


def absorb(runs, reference, slopes: np.ndarray, sd: np.ndarray, run: Run, bounds, *, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """(left (K, B) m, shifts (K, n)) of ``runs`` (K, B) m against a ``reference`` (B,) m: what is left is against real runs of it.

    Where runs are recordings, each has a reference of its own, (K, B), and ``slopes`` (K, B, n).
    slopes  (B, n) m for one prior standard deviation of each parameter, whose prior precision is then 1
    sd      (B,) m, noise of the block means, infinite where they are not fitted; what is left so far is added to it, as a fit would hear
            such data less: of all runs, so that what was measured is one among sound twins if it is sound
    run     shifts (K, n) in prior standard deviations -> (K, B) m, the reference run there, NaN of what diverged
    bounds  ((n,), (n,)) least and largest shifts

    A round is one Gauss-Newton step of each, after which the reference is run; a step that is no better is not taken, and the next is
    shorter. Slopes start as the shared ones, and each run's own are corrected by what its steps missed (``slopes``).
    """
    runs = np.asarray(runs, float)
    count, size = len(runs), slopes.shape[-1]
    base: np.ndarray = np.broadcast_to(np.asarray(reference, float), runs.shape)
    at: np.ndarray = np.zeros((count, size))
    ways: np.ndarray = np.broadcast_to(slopes, (count, *slopes.shape[-2:])).copy()
    reach: np.ndarray = np.ones(count)
    for _ in range(rounds):
        heard = np.hypot(sd, np.sqrt(np.mean((runs - base) ** 2, 0)))
        trial = np.array(
            [np.clip(a + r * _step(x - b, w, heard, a), *bounds) for a, r, x, b, w in zip(at, reach, runs, base, ways, strict=True)]
        )
        there = run(trial)
        better = _cost(runs - there, heard, trial) < _cost(runs - base, heard, at)
        for k in np.flatnonzero(better):
            ways[k] = corrected(ways[k], trial[k] - at[k], there[k] - base[k])
        base, at = np.where(better[:, None], there, base), np.where(better[:, None], trial, at)
        reach = np.where(better, 1.0, SHORTER * reach)
    return runs - base, at


def _step(left, slopes, heard, at) -> np.ndarray:
    """(n,) from ``at`` to the likeliest shifts, by slopes and the prior around nothing."""
    ways = slopes / heard[:, None]
    return np.linalg.solve(ways.T @ ways + np.eye(len(at)), ways.T @ (left / heard) - at)


def _cost(left, heard, at) -> np.ndarray:
    """(K,) twice the negative log posterior; infinite of what diverged."""
    found = np.sum((left / heard) ** 2, 1) + np.sum(at**2, 1)
    return np.where(np.isfinite(found), found, np.inf)
