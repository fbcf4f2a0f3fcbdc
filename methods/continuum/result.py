"""What a fit found: values, how sure they are, and what kept it from being surer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .unknowns import Unknown

__all__ = ["Fit", "concluded"]

DOMINATED = 0.7  # of the standard deviation before, above which the data said less than the prior: 1 / sqrt(2)
LOOSEST = 30.0  # standard deviations of what no data constrain, in those before: ten times the bounds, and matrices stay regular
EDGE = 1e-9  # of the range: so near a bound is at it


@dataclass(frozen=True)
class Fit:
    """Where a fit ended.

    scaled         (n,) the unknowns in their scaled space, and their posterior ``covariance`` (n, n) there, by Laplace's approximation:
                   inverse of J' J / (noise^2 c) + prior precisions, c the inflation of a robust fit (``StudentT.inflation``)
    costs          negative log posterior before each iteration and at the end
    scale          of the residuals, in standard deviations of the noise; 1 where the model is as good as the data
    prediction     (R,) at the end, NaN at data that did not count; ``weights`` (R,) in [0, 1] of each, 1 for the best heard
    runs, batches  how much was simulated
    at_bounds      names of unknowns that ended at a bound: their covariance is not to be trusted
    unconstrained  names of those that the data said less about than the prior or the bounds
    notes          what else is to be known
    """

    unknowns: tuple[Unknown, ...]
    scaled: np.ndarray
    covariance: np.ndarray
    costs: tuple[float, ...]
    scale: float
    prediction: np.ndarray
    weights: np.ndarray
    runs: int
    batches: int
    at_bounds: tuple[str, ...]
    unconstrained: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def values(self) -> dict[str, float]:
        return {u.name: u.decode(s) for u, s in zip(self.unknowns, self.scaled, strict=True)}

    @property
    def sd(self) -> dict[str, float]:
        """Standard deviations in the scaled space; of a logarithmic scale they are relative errors."""
        return {u.name: float(s) for u, s in zip(self.unknowns, np.sqrt(np.diag(self.covariance)), strict=True)}

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """The central interval of a value that holds ``level`` of its posterior, cut at its bounds."""
        from scipy.special import ndtri

        names = [u.name for u in self.unknowns]
        if name not in names:
            raise ValueError(f"unknown must be one of {', '.join(names)}, got {name!r}")
        if not 0 < level < 1:
            raise ValueError(f"level must lie in (0, 1), got {level}")
        k = names.index(name)
        half = ndtri((1 + level) / 2) * np.sqrt(self.covariance[k, k])
        return self.unknowns[k].decode(self.scaled[k] - half), self.unknowns[k].decode(self.scaled[k] + half)

    def draws(self, count: int, *, seed: int = 0) -> np.ndarray:
        """(count, n) values from the posterior, cut at their bounds."""
        random = np.random.default_rng(seed)
        rows = random.multivariate_normal(self.scaled, self.covariance, count, method="eigh")
        return np.array([[u.decode(s) for u, s in zip(self.unknowns, row, strict=True)] for row in rows])


def concluded(problem, state, *, costs: Sequence[float], runs: int, batches: int, notes: Sequence[str], seen: np.ndarray) -> Fit:
    """The ``Fit`` of a search that ended at ``state``; ``seen`` (all R,) says which data count."""
    unknowns, loss = problem.unknowns, problem.loss
    residual = problem.residual(state.prediction)
    before = np.array([u.sd for u in unknowns])
    slopes = state.jacobian / problem.noise[:, None]
    measured = problem.share / loss.inflation(residual, state.scale) * slopes.T @ slopes
    _, precision = problem.prior
    values, ways = np.linalg.eigh((measured + np.diag(precision)) * np.outer(before, before))  # scaled, so that units do not matter
    ways = ways * before[:, None]
    covariance = (ways / np.maximum(values, LOOSEST**-2)) @ ways.T
    sd = np.sqrt(np.diag(covariance))
    low, high = problem.bounds
    edge = EDGE * (high - low)
    at = (state.scaled <= low + edge) | (state.scaled >= high - edge)
    vague = sd > DOMINATED * before
    weights, prediction = np.zeros(len(seen)), np.full(len(seen), np.nan)
    weights[seen], prediction[seen] = loss.weights(residual, state.scale), state.prediction
    return Fit(
        unknowns,
        state.scaled,
        covariance,
        tuple(costs),
        state.scale,
        prediction,
        weights / max(weights.max(), 1e-300),
        runs,
        batches,
        tuple(u.name for u, a in zip(unknowns, at, strict=True) if a),
        tuple(u.name for u, a in zip(unknowns, vague, strict=True) if a),
        tuple(notes),
    )
