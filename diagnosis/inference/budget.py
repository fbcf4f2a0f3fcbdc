"""Where the error of a sound twin comes from, in mm, and what size of an effect would have been found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from .covariance import Layout, Prior, Scatter
from .scan import Signature
from .significance import Significance, fitted_rows

__all__ = ["Budget", "Detectable", "budget", "detectable"]

POWER = 0.95


@dataclass(frozen=True)
class Budget:
    """One part of a motion, from ``begin`` to ``end`` [s] of recording ``record``; all others mm, RMS over its block means.

    error       of the fitted sound twin
    noise       of measured means; ``representation``: what sound twins of other cells, shape, steps and hands are off, what any recording
                is (``Amount.usual``), and what sound recordings are expected to miss; ``parameters``: what their posterior leaves open
    named       what the likeliest effect changes, 0 if none is; ``unexplained``: what error there is beyond the squares of all of these
    fitted      whether its frames were fitted
    """

    record: int
    begin: float
    end: float
    fitted: bool
    error: float
    noise: float
    representation: float
    parameters: float
    named: float
    unexplained: float


@dataclass(frozen=True)
class Detectable:
    """``size`` in mm of motion (RMS) at which a candidate would be found in 95 of 100 recordings; ``unabsorbed``: the share of its whitened
    signature that a sound twin's parameters do not explain."""

    name: str
    words: str
    size: float
    unabsorbed: float


def budget(scatter: Scatter, prior: Prior, residual, posterior, change, missed: np.ndarray | float = 0.0) -> list[Budget]:
    """By part of the motion.

    residual   (B,) m of the sound twin, beside what it is expected to have ``missed`` (B,) m; ``change`` (B,) m, what the named effect's
               refit predicts otherwise, or zeros
    posterior  (B, B) m^2 of what the parameters' posterior leaves open
    """
    layout: Layout = scatter.layout
    squares = {
        "error": (residual + missed) ** 2,
        "noise": np.diag(scatter.noise),
        "representation": np.diag(scatter.expected(prior)) + (residual + missed) ** 2 - residual**2,
        "parameters": np.diag(posterior),
        "named": residual**2 - (residual - change) ** 2,
    }
    found = []
    for record in np.unique(layout.record):
        own = layout.record == record
        times = np.unique(layout.time[own])
        edges = np.r_[0.0, (times[1:] + times[:-1]) / 2, times[-1] + (times[-1] - times[-2]) / 2 if len(times) > 1 else times[-1]]
        for k, time in enumerate(times):
            part = own & (layout.time == time)
            mean = {name: max(0.0, 3e6 * float(np.mean(values[part]))) for name, values in squares.items()}  # three make a place
            rest = mean["error"] - sum(v for name, v in mean.items() if name != "error")
            mm = {name: float(np.sqrt(v)) for name, v in mean.items()}
            fitted = bool(layout.fitted[part].all())
            found.append(
                Budget(int(record), float(edges[k]), float(edges[k + 1]), fitted, unexplained=float(np.sqrt(max(0.0, rest))), **mm)
            )
    return found


def detectable(scatter: Scatter, prior: Prior, test: Significance, catalogue: Sequence[Signature], level: float) -> list[Detectable]:
    """By candidate, of those of several amounts in the direction in which the smallest motion shows.

    The scan finds what exceeds the score that alarms by itself at ``level``.
    """
    rows = np.flatnonzero(scatter.layout.fitted)
    here = scatter.only(rows)
    full, bare = (here.likelihood(prior, parameters=p) for p in (True, False))
    scale = np.sqrt(np.mean(test.misfits))  # scores are in deviations of what is left, not of the covariance
    needed = (test.alarming(level) + norm.ppf(POWER)) * scale
    found = []
    for one in catalogue:
        columns = fitted_rows(one, rows).columns
        ways, all_of_it = full.whitened(columns), bare.whitened(columns)
        strongest = float(np.sqrt(np.linalg.eigvalsh(ways.T @ ways)[-1]))  # deviations for an amount of 1 mm of motion
        share = float(np.trace(ways.T @ ways) / np.trace(all_of_it.T @ all_of_it))
        found.append(Detectable(one.name, one.candidate.words, needed / max(strongest, 1e-12), share))
    return found
