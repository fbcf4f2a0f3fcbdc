"""What a fit of a continuum does, and the numbers that were chosen, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DENSITY", "Config"]

DENSITY = 100.0  # kg/m^3 of every body: without a told mass only ratios to it show in a motion


@dataclass(frozen=True)
class Config:
    """Effort and choices of a fit.

    pitch       edge of a cell over that of ``gridding.grid_of``: one layer of cells bends right to within 1 % (results/continuum.md)
    starts      of the search, spread over the priors
    iterations  of the search, at most, which is made in larger cells, and of the ``refinement`` in those of ``pitch``
    coarse      how many times as large cells are in the search
    recordings  that are fitted jointly, at most; None: as many as suit the kind of body
    seconds     of each that are fitted, from any frame in which the whole body is known; None: as suits the kind, or all
    start       how a recording starts: at "rest", as its first two "frames" say where they are known, or "auto": at rest if it looks so
    frames      observed frames of each that are fitted, or None: all
    members     sound twins whose spread says how well each part of a motion can be predicted; 0: all count alike
    grips       whether what hands hold is fitted
    """

    pitch: float = 1.0
    starts: int = 3
    iterations: int = 8
    refinement: int = 4
    coarse: float = 1.5
    recordings: int | None = None
    seconds: float | None = None
    start: str = "rest"
    frames: int | None = None
    members: int = 8
    grips: bool = True

    def __post_init__(self):
        if self.start not in ("rest", "frames", "auto"):
            raise ValueError(f"start must be 'rest', 'frames' or 'auto', got {self.start!r}")
