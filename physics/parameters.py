"""Physical parameters: what a number means, where it may lie, and how an optimiser should move it."""

from __future__ import annotations

from dataclasses import dataclass
from math import log

__all__ = ["Parameter"]


@dataclass(frozen=True)
class Parameter:
    """A scalar that a term reads: default ``value`` in ``[low, high]``, its ``unit`` and what it means.

    ``scale`` says whether a search should move it linearly or in its logarithm ("linear" or "log").
    """

    name: str
    value: float
    low: float
    high: float
    unit: str
    meaning: str
    scale: str = "linear"

    def __post_init__(self):
        if not self.low <= self.value <= self.high:
            raise ValueError(f"{self.name} must lie in [{self.low}, {self.high}] {self.unit}, got {self.value}")
        if self.scale not in ("linear", "log"):
            raise ValueError(f"scale of {self.name} must be 'linear' or 'log', got {self.scale!r}")
        if self.scale == "log" and not self.low > 0:
            raise ValueError(f"{self.name} has a logarithmic scale, so its low end must be > 0 {self.unit}, got {self.low}")

    def decode(self, unit: float) -> float:
        """The value at ``unit`` in [0, 1] of the range, on the parameter's scale."""
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** unit)
        return float(self.low + unit * (self.high - self.low))

    def encode(self, value: float) -> float:
        """Where in [0, 1] of the range ``value`` lies: the inverse of ``decode``."""
        if self.scale == "log":
            return log(value / self.low) / log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)
