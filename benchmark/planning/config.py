"""The constants of planning, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PlanConfig"]


@dataclass(frozen=True)
class PlanConfig:
    """How hands may move, how the search goes, and what an end costs.

    moving       frames in which hands move: 1.5 s at 30 frames/s bring a hand 1.2 m far: up by the length of a rope, and aside
    resting      frames after that in which they rest: 0.5 s, so that an end is more a place than a swing
    segments     of a path: PhysTwin-MPC has four; one more lets a hand rise, cross, go down and pull
    speed        of a hand, at most [m/s]: recorded hands are about as fast, and twins were fitted to those
    aside, above how far from its start a hand may go along each horizontal axis, and upward [m]: an arm's reach over a table
    samples      roll-outs that are simulated together
    updates      of the mean; the search simulates samples x updates roll-outs in all, and so does random shooting
    noise        standard deviation of a segment's velocity at first, over ``speed``: ends of paths then spread by 3 cm along each axis
                 about a guess of geometry. Of 0.25, 0.1 and 0.05, that by which 24 roll-outs of an unfitted rope came nearest (54.8, 51.7
                 and 49.7 mm, as that twin says); that body, number 1100, is in no comparison
    colour       correlation of that noise from segment to segment: white noise mostly cancels itself, 1 would go straight only
    decay        of the noise from update to update: the last is a fifth of the first, as if PhysTwin-MPC's 1/(1 + i) stopped there
    temperature  of the softmax over the spread of the costs (median less least): costs of bodies of any size are then treated alike
    table        cost of a metre that something is pressed below the table: ten times that of a metre off, for there is no such place
    reach        cost of a metre that something leaves the workspace, for the same reason
    stretch      cost [m] of stretch beyond ``most_stretch``: twins stretch without end where hands are imposed, and bodies tear
    most_stretch share by which neighbouring points may part
    """

    moving: int = 46
    resting: int = 15
    segments: int = 5
    speed: float = 0.8
    aside: float = 0.4
    above: float = 0.8
    samples: int = 24
    updates: int = 8
    noise: float = 0.05
    colour: float = 0.5
    decay: float = 0.8
    temperature: float = 0.2
    table: float = 10.0
    reach: float = 10.0
    stretch: float = 0.1
    most_stretch: float = 0.5

    def __post_init__(self):
        for name in ("moving", "segments", "samples", "updates"):
            if int(getattr(self, name)) != getattr(self, name) or getattr(self, name) < (2 if name in ("moving", "samples") else 1):
                raise ValueError(f"{name} must be a whole number > {int(name in ('moving', 'samples'))}, got {getattr(self, name)!r}")
        if self.resting < 0 or int(self.resting) != self.resting:
            raise ValueError(f"resting must be a whole number >= 0 [frames], got {self.resting!r}")
        for name in ("speed", "aside", "above", "noise", "decay", "temperature"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"{name} must be > 0 and finite, got {getattr(self, name)!r}")
        if not 0 <= self.colour < 1:
            raise ValueError(f"colour must lie in [0, 1), got {self.colour!r}")

    @property
    def frames(self) -> int:
        """Of a plan."""
        return self.moving + self.resting

    @property
    def rollouts(self) -> int:
        """That a search simulates."""
        return self.samples * self.updates
