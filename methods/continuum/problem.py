"""What a fit asks: data, noise, loss and priors, and what one place among the unknowns costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .robust import StudentT
from .unknowns import Unknown

__all__ = ["FIRST_DAMPING", "Problem", "State", "posed"]

FIRST_DAMPING = 1e-2  # of the diagonal: a hundredth bends a step a little towards steepest descent


@dataclass(frozen=True)
class State:
    """Where one start is.

    scaled      (n,) the unknowns in the scaled space
    prediction  (R,) there
    cost        negative log posterior, and the ``scale`` of the residuals, in standard deviations of the noise
    jacobian    (R, n) derivative of the prediction by ``scaled``, or None: to be taken; ``age`` secant updates old
    arrived     nothing more is to be gained
    """

    scaled: np.ndarray
    prediction: np.ndarray
    cost: float
    scale: float
    damping: float = FIRST_DAMPING
    jacobian: np.ndarray | None = None
    age: int = 0
    arrived: bool = False


@dataclass(frozen=True)
class Problem:
    """What is asked: ``unknowns`` (n), measured ``data`` (R,), its ``noise`` (R,) as standard deviations, the ``loss`` of residuals.

    ``share``: independent data among the coordinates, over their number; the likelihood counts for so much (1: all are independent).
    """

    unknowns: tuple[Unknown, ...]
    data: np.ndarray
    noise: np.ndarray
    loss: StudentT
    share: float = 1.0

    def values(self, scaled) -> np.ndarray:
        """(B, n) values of (B, n) in the scaled space."""
        return np.array([[u.decode(s) for u, s in zip(self.unknowns, row, strict=True)] for row in scaled]).reshape(
            len(scaled), len(self.unknowns)
        )

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.array([u.ends for u in self.unknowns]).T
        return low, high

    @property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """(n,) means and precisions (0: no prior) in the scaled space."""
        mean = np.array([u.prior[0] if u.prior else 0.0 for u in self.unknowns])
        return mean, np.array([u.prior[1] ** -2 if u.prior else 0.0 for u in self.unknowns])

    def residual(self, prediction) -> np.ndarray:
        """(R,) measured minus predicted, in standard deviations of the noise."""
        return (self.data - prediction) / self.noise

    def place(self, scaled, prediction, **others) -> State:
        """The state at ``scaled`` (n,) with its cost; infinite where the run diverged."""
        if not np.isfinite(prediction).all():
            return State(scaled, prediction, np.inf, 1.0, **others)
        residual = self.residual(prediction)
        scale = self.loss.scale(residual)
        mean, precision = self.prior
        cost = self.share * self.loss.cost(residual, scale) + float(precision @ (scaled - mean) ** 2) / 2
        return State(scaled, prediction, cost, scale, **others)

    def normal(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """((n, n), (n,)) Gauss and Newton's matrix and the negative gradient of the cost, priors included."""
        residual = self.residual(state.prediction)
        weights = self.share * self.loss.weights(residual, state.scale)
        slopes = state.jacobian / self.noise[:, None]
        mean, precision = self.prior
        matrix = (slopes * weights[:, None]).T @ slopes + np.diag(precision)
        return matrix, slopes.T @ (weights * residual) - precision * (state.scaled - mean)


def posed(unknowns: Sequence[Unknown], data, noise, loss: StudentT, independent: float | None) -> tuple[Problem, np.ndarray]:
    """(the problem of the data that count, (R,) which of all do). Raises ValueError for data that fit nothing."""
    if not unknowns:
        raise ValueError("unknowns must be at least one, got none")
    if len({u.name for u in unknowns}) < len(unknowns):
        raise ValueError(f"unknowns must have a name each, got {', '.join(u.name for u in unknowns)}")
    data, noise = np.asarray(data, float), np.asarray(noise, float)
    seen = _seen(data, noise)
    return Problem(tuple(unknowns), data[seen], noise[seen], loss, _share(independent, int(seen.sum()))), seen


def _seen(data, noise) -> np.ndarray:
    """(R,) which data count. Raises ValueError for what is no data."""
    if data.ndim != 1 or not data.size or noise.shape != data.shape:
        raise ValueError(f"data and noise must have one shape (R,) with R > 0, got {data.shape} and {noise.shape}")
    if not (noise > 0).all():
        raise ValueError(f"noise must be > 0, got {noise[~(noise > 0)][0]}")
    seen = np.isfinite(noise)
    if not seen.any():
        raise ValueError("noise must be finite for some data, got none")
    if not np.isfinite(data[seen]).all():
        raise ValueError(f"data must be finite where noise is, got {data[seen][~np.isfinite(data[seen])][0]}")
    return seen


def _share(independent, count) -> float:
    if independent is None:
        return 1.0
    if not independent > 0:
        raise ValueError(f"independent must be > 0, got {independent}")
    return min(1.0, independent / count)
