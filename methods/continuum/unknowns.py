"""What a fit may change: bounds, scale and prior of each number, and points spread over all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, exp, isfinite, log

import numpy as np

__all__ = ["Unknown", "members", "rounded_up", "spread"]


@dataclass(frozen=True)
class Unknown:
    """A number between ``low`` and ``high`` [``unit``] that a fit starts at ``value``.

    scale  "linear" or "log": the scaled space, in which steps are taken and the covariance is stated, is the value or its natural logarithm
    prior  (mean, standard deviation) of a normal distribution in the scaled space, or None: even within the bounds
    turn   step of finite differences in the scaled space; None: a twentieth of the prior's standard deviation, or 1/200 of the range
    """

    name: str
    value: float
    low: float
    high: float
    unit: str
    scale: str = "linear"
    prior: tuple[float, float] | None = None
    turn: float | None = None

    def __post_init__(self):
        if self.scale not in ("linear", "log"):
            raise ValueError(f"scale of {self.name} must be 'linear' or 'log', got {self.scale!r}")
        if not (isfinite(self.low) and isfinite(self.high) and self.low < self.high):
            raise ValueError(f"bounds of {self.name} must be finite and low < high [{self.unit}], got {self.low}, {self.high}")
        if not self.low <= self.value <= self.high:
            raise ValueError(f"{self.name} must lie in [{self.low}, {self.high}] {self.unit}, got {self.value}")
        if self.scale == "log" and not self.low > 0:
            raise ValueError(f"{self.name} has a logarithmic scale, so its low end must be > 0 {self.unit}, got {self.low}")
        if self.prior is not None and not (isfinite(self.prior[0]) and isfinite(self.prior[1]) and self.prior[1] > 0):
            raise ValueError(f"prior of {self.name} must be a finite mean and a standard deviation > 0, got {self.prior}")
        if self.turn is not None and not (isfinite(self.turn) and self.turn > 0):
            raise ValueError(f"turn of {self.name} must be > 0, got {self.turn}")

    def encode(self, value: float) -> float:
        """``value`` in the scaled space."""
        return log(value) if self.scale == "log" else float(value)

    def decode(self, scaled) -> float:
        """The value at ``scaled``, never outside of the bounds by rounding."""
        return min(max(exp(scaled) if self.scale == "log" else float(scaled), self.low), self.high)

    @property
    def ends(self) -> tuple[float, float]:
        """The bounds in the scaled space."""
        return self.encode(self.low), self.encode(self.high)

    def holds(self, scaled: float) -> bool:
        """Whether ``scaled`` lies within the bounds."""
        low, high = self.ends
        return low <= scaled <= high

    @property
    def sd(self) -> float:
        """Standard deviation in the scaled space before anything is measured: the prior's, or that of an even distribution."""
        low, high = self.ends
        return self.prior[1] if self.prior else (high - low) / np.sqrt(12)

    @property
    def difference(self) -> float:
        """Step of finite differences in the scaled space, at most half of the range."""
        low, high = self.ends
        step = self.turn or (self.prior[1] / 20 if self.prior else (high - low) / 200)
        return min(step, (high - low) / 2)

    def quantile(self, share):
        """Where in the scaled space ``share`` (...) in (0, 1) of the prior lies, bounds applied."""
        from scipy.special import ndtr, ndtri

        low, high = self.ends
        if self.prior is None:
            return low + np.asarray(share) * (high - low)
        mean, sd = self.prior
        below, above = ndtr((low - mean) / sd), ndtr((high - mean) / sd)
        if not above > below:
            raise ValueError(f"prior of {self.name} must have some mass within [{self.low}, {self.high}] {self.unit}, got {self.prior}")
        return np.clip(mean + sd * ndtri(below + np.asarray(share) * (above - below)), low, high)


def spread(unknowns: Sequence[Unknown], count: int, *, seed: int = 0) -> np.ndarray:
    """(count, n) values that fill the priors evenly: a scrambled Sobol sequence (Owen 1998)."""
    return np.array([[u.decode(u.quantile(s)) for u, s in zip(unknowns, row, strict=True)] for row in _sobol(len(unknowns), count, seed)])


def members(ranges: Sequence[Unknown], count: int, *, choices: Mapping[str, Sequence] | None = None, seed: int = 0) -> list[dict]:
    """``count`` members of an ensemble: by name, a value of each range and one of each of the ``choices``, evenly spread."""
    choices = dict(choices or {})
    if empty := [name for name, options in choices.items() if not len(options)]:
        raise ValueError(f"choices must have at least one option each, got none for {', '.join(empty)}")
    found = []
    for row in _sobol(len(ranges) + len(choices), count, seed):
        values = {u.name: u.decode(u.quantile(s)) for u, s in zip(ranges, row, strict=False)}
        picked = {name: options[int(s * len(options))] for (name, options), s in zip(choices.items(), row[len(ranges) :], strict=True)}
        found.append(values | picked)
    return found


def _sobol(dimensions: int, count: int, seed: int) -> np.ndarray:
    """(count, dimensions) in (0, 1)."""
    from scipy.stats import qmc

    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    if not dimensions:
        return np.zeros((count, 0))
    power = max(0, int(np.ceil(np.log2(count))))  # the first points of a longer sequence, which is even in powers of two only
    tiny = np.finfo(float).eps
    return np.clip(qmc.Sobol(dimensions, scramble=True, seed=seed).random_base2(power)[:count], tiny, 1 - tiny)


def rounded_up(value: float, step: float = 0.1) -> float:
    """``value`` > 0 rounded up to a power of 1 + ``step``, 0 to 0: steps that are chosen by it stay the same in a search."""
    return (1 + step) ** ceil(log(value) / log(1 + step) - 1e-9) if value > 0 else 0.0
