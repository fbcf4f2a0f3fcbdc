"""What a refit of the reference twin would absorb of a run, be it a sound twin's or what was measured, and what is left."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...methods.continuum.predictability import absorbed

__all__ = ["absorb"]

Run = Callable[[np.ndarray], np.ndarray]


def absorb(runs, reference, slopes, sd, run: Run, bounds, *, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """(left (K, B) m, shifts (K, n)) of ``runs`` (K, B) m against a ``reference`` (B,) m.

    slopes  (B, n) m for one prior standard deviation of each parameter, whose prior precision is then 1
    sd      (B,) m, noise of the block means, infinite where they are not fitted; what earlier rounds left is added to it, as a fit would
            hear such data less: of all runs, so that what was measured is one among sound twins if it is sound
    run     shifts (K, n) in prior standard deviations -> (K, B) m, the reference run there, NaN of what diverged
    bounds  ((n,), (n,)) least and largest shifts

    A round is one Gauss-Newton step with the shared slopes; before each but the first, the reference is run where the last one led. The
    last step is left linear. Where such a run diverges, the linear prediction stands for it.
    """
    runs = np.asarray(runs, float)
    base, at = np.tile(reference, (len(runs), 1)), np.zeros((len(runs), slopes.shape[1]))
    heard = np.asarray(sd, float)
    for k in range(rounds):
        if k:
            there = run(at)
            good = np.isfinite(there).all(1, keepdims=True)
            base = np.where(good, there, reference + at @ slopes.T)
        found, _ = absorbed(runs - base + at @ slopes.T, slopes, heard, 1.0)  # the step to ``found`` from nothing, by its prior
        found = np.clip(found, *bounds)
        left = runs - base - (found - at) @ slopes.T
        at = found
        heard = np.hypot(sd, np.sqrt(np.mean(left**2, 0)))
    return left, at
