"""Physical parameters: what a number means, where it may lie, and how an optimiser should move it."""

from __future__ import annotations

from dataclasses import dataclass

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
