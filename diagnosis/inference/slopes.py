"""Slopes of runs by parameters, corrected by the runs that are made anyway."""

from __future__ import annotations

import numpy as np

__all__ = ["corrected"]

SHORT = 0.01  # prior standard deviations: rounding of runs, some 1e-6 m, over less than this makes slopes of its own


def corrected(slopes, step, change):
    """``slopes`` (B, n) m that say the ``change`` (B,) m which a ``step`` (n,) in prior standard deviations made (Broyden 1965).

    What a step along ``SHORT`` or less changes says nothing of slopes but rounding; they stay.
    """
    square = float(step @ step)
    if not square > SHORT**2:
        return slopes
    return slopes + np.outer(change - slopes @ step, step / square)
