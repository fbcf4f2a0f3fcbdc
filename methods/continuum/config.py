"""What a fit of a continuum does, and the numbers that were chosen, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CONTACTS", "DENSITY", "ELEMENTS", "RESTS", "STARTS", "Config"]

DENSITY = 100.0  # kg/m^3 of every body: without a told mass only ratios to it show in a motion
RESTS = ("as it lies", "equilibrium")
STARTS = ("auto", "rest", "frames")
ELEMENTS = ("own", "springs")
CONTACTS = ("auto", "on", "off")


@dataclass(frozen=True)
class Config:
    """Effort and choices of a fit.

    pitch       edge of a cell over that of ``gridding.grid_of``: one layer of cells bends right to within 1 % (results/continuum.md)
    starts      of the search, spread over the priors
    iterations  of the search, at most, which is made in larger cells (None: as many as suit the kind of body), and of the ``refinement`` in
                those of ``pitch``
    dearest     times the steps of the dearest start that a run of the search may take: a rope that is known exactly asked for 13,000 a
                frame, twenty times as many, for a bending damping that nothing else told
    coarse      how many times as large cells are in the search; None: as suits the kind
    recordings  that are fitted jointly, at most; None: as many as suit the kind of body
    more        times as many recordings as suit the kind of body, where ``recordings`` does not say
    seconds     of each that are fitted, from any frame in which the whole body is known; None: as suits the kind, or all
    start       how a recording starts: at "rest", as its first "frames" say, or "auto": so where frame 0 is no rest (``start``)
    rest        shape: frame 0 "as it lies", or solved such that frame 0 is an "equilibrium" under gravity, ground and grips
    frames      observed frames of each that are fitted, or None: all
    elements    of a solid: cells of its "own", or "springs" on their nodes, as twins have them that are nets of particles
    members     sound twins whose spread says how well each part of a motion can be predicted; 0: all count alike
    grips       whether what hands hold is fitted
    contact     of a sheet or a rope with itself: "on", "off", or "auto": where a sheet lies on itself in frame 0
    """

    pitch: float = 1.0
    starts: int = 3
    iterations: int | None = None
    refinement: int = 4
    dearest: float = 8.0
    coarse: float | None = None
    recordings: int | None = None
    more: float = 1.0
    seconds: float | None = None
    start: str = "auto"
    rest: str = "as it lies"
    frames: int | None = None
    elements: str = "own"
    members: int = 8
    grips: bool = True
    contact: str = "auto"

    def __post_init__(self):
        for name, choices in (("start", STARTS), ("rest", RESTS), ("elements", ELEMENTS), ("contact", CONTACTS)):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}")
