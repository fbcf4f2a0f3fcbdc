"""The numbers of the diagnosis, each with its reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

__all__ = ["MEMBERS", "DiagnosisConfig", "of_preset"]


@dataclass(frozen=True)
class DiagnosisConfig:
    """What is chosen, not measured. Lengths in mm, times in s.

    level       false alarms among sound recordings: 3 %, so that the best of a hundred controls still tells 0 from 9 of them
    wandering   p below which tracks are said to wander, of which no twin is asked: nine in ten within five times the median are none.
                Chosen by looking at 80 sound ropes, four with drifting tracks and a crushed box, see results/inference.md
    held        how well recordings say how much of a body a hand holds, as a logarithm: to 15 %, half of what a fit grants it, and twice
                what sound ropes of three engines differ by, all of which are held in one way; see results/inference.md
    strays      how well recordings say how a hand carries what it holds, as a logarithm: a third more or less, half as much again as sound
                recordings of three engines differ by, whose hands are rigid and hold what is near; see results/inference.md
    regions     of a body, whose tracks are averaged: 10 regions x 8 times x 3 components are 240 numbers, as many as a covariance of 300
                takes in a few milliseconds, and fewer than the independent motions of a body of 50 cells
    times       bins of the fitted frames, a quarter of a second or less each in a recording of 2 s
    held_out    bins of the frames that were not fitted, which are a quarter to a third of them
    fewest      tracks seen in a region within a bin, of which a mean and its error can be told: two more than a linear field has
    members     sound twins: a variance from 15 is known to 18 %; 8, for a quick look, tell it to 27 %
    cells       of the reference, by edge over those of the fitted twin; None: as the search of the kind of body has them, of solids half as
                large again, which cost a third, and what they are off by is what members differ in
    finest, coarsest  edge of a member's cells over the reference's. The truth is finer than any twin, so that most members are
    turned      standard deviation of the angle by which a member's grid is turned [degrees]: cells need not follow a body's axes
    dropped     share of the points of frame 0 and of a hand's controllers without which a member's body and hands are told: the mean of
                half is as far from the mean of all as that is from the truth.
    broad       of the prior's standard deviation, by which members' parameters are spread around the fit: within it a Gauss-Newton step is
                right to a few per cent, and beyond it the reference is run again in any case
    dearest     times the reference's steps that a member or a refit may take: what is eight times as stiff takes hundreds of seconds
    floor       standard deviation of what each block mean is off by beside what members are [mm]: they differ in few things, and are too
                much alike in what is fine. The truths of simulators move by 1 to 4 mm when their meshes are made finer. Between recordings
                of one command, in which it is the same, it is nothing
    repeat      standard deviation of what a place is off by where a body is set up anew for the same command [mm], all the time and as
                much again from bin to bin, beside one sound recording: robots repeat to a tenth of it, what is laid or clamped by hand to
                some of it. Two sound ones tell it
    rounds      of absorption, each a step and a run of the reference for every member: after two, some of eight members of two blocks were
                left with 2.4 mm, after four with 1.9, after eight with 1.7 (the largest)
    stiffest    of hands, contact: members' angular frequencies over the reference's, as far up and down (log-uniform)
    motion      prior standard deviation of an effect's motion [mm]: effects that matter move a body by a few mm to a few cm
    restless    share of its motion that a settled twin may miss before another search: a thrown rope missed 12 % in one and 0.5 % in the
                next, 81 other sound ropes 7 % at most (results/inference.md)
    probe       motion by which a signature is measured [mm]: above rounding (0.01 mm) and within the effect's linear part
    refitted    candidates that are refitted nonlinearly, one of each effect: a refit costs as much as half of the members. Which ones,
                evidence of a little and of much of each effect says, which costs as much as three or four of them
    astray      prior standard deviation of each coordinate of a place in such a refit [mm]: places that are tried lie some 5 cm apart
    reshaped    standard deviation, as a factor, of a time, length or speed of an effect from where it was tried in such a refit: times that
                are tried lie a factor of four apart, and others are tried at one or two
    steps       of such a refit, at most, of one to three runs each; it ends where fresh slopes lead nowhere, which take as many runs as it
                has unknowns. Three steps left a wind of 15 mm, nine a hand that gives way (116 mm) far from where refits end, which takes
                twenty, and 24 a slipping hand, which takes 70 runs more (results/inference.md)
    runs        of such a refit, at most: a rope's takes some 60, of an obstacle or a slipping hand up to 270 (results/inference.md), one
                that moves a cable by decimetres would take a thousand of seconds each
    behind      nats by which a refit may be short of another one where its slopes lead, and go on: they may lead farther than they say;
                what it saves and what it could have cost is in results/inference.md, "Refits that cannot keep up"
    parallel    cosine of two whitened signatures above which their effects cannot be told apart: at 0.95 the second explains 90 % of what
                the first does
    clearly     nats by which an effect must be likelier than that nothing is missing to be named: 24 effects, one of which acts in one
                recording of 33, are at even odds then (ln 24 x 33 = 6.7)
    listed      probability that what is missing is one of the effects that are asked, before anything is tried: nobody knows, and 0.8 was
                the first that was tried; what others do is in results/inference.md, "Probabilities of names"
    roaming     standard deviation of where a hand that is not listed may be, from where it held the body in frame 0, in each coordinate
                and bin [mm]: an arm's length
    planned     motions, at most, that members run through where a recording leaves something open, each at twice the cost of the members
    ridges      of what sound recordings are expected to miss, over the scale of how alike they are; chosen by recordings left out
    strengths   of the prior covariance, in members; ``memories`` [s] and ``reaches`` (of the body's extent) of its correlation. They are
                chosen by the score of members left out; 0 is no correlation
    """

    level: float = 0.03
    wandering: float = 1e-5
    held: float = 0.15
    strays: float = 0.3
    regions: int = 10
    times: int = 8
    held_out: int = 3
    fewest: int = 6
    members: int = 16
    cells: float | None = None
    finest: float = 0.6
    coarsest: float = 1.2
    turned: float = 15.0
    dropped: float = 0.5
    broad: float = 0.3
    dearest: float = 4.0
    floor: float = 1.0
    repeat: float = 1.0
    rounds: int = 4
    stiffest: float = 1.5
    motion: float = 20.0
    restless: float = 0.1
    probe: float = 1.0
    refitted: int = 4
    astray: float = 25.0
    reshaped: float = 2.0
    steps: int = 60
    runs: int = 300
    behind: float = 30.0
    parallel: float = 0.95
    clearly: float = 6.7
    listed: float = 0.8
    roaming: float = 500.0
    planned: int = 2
    ridges: tuple[float, ...] = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
    strengths: tuple[float, ...] = (2.0, 4.0, 8.0, 16.0, 32.0)
    memories: tuple[float, ...] = (0.0, 0.15, 0.5, 1.5)
    reaches: tuple[float, ...] = (0.0, 0.15, 0.4)

    def __post_init__(self):
        for name in ("regions", "times", "held_out", "fewest", "rounds", "refitted", "steps"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.members < 4:
            raise ValueError(f"members must be at least 4, got {self.members}: fewer tell no variance")
        if not 0 < self.level < 1:
            raise ValueError(f"level must lie in (0, 1), got {self.level}")
        if not 0 < self.listed < 1:
            raise ValueError(f"listed must lie in (0, 1), got {self.listed}")

    def cells_of(self, body) -> float:
        """``cells`` of a body, of its kind's where this says none."""
        return body.coarse if self.cells is None else self.cells


MEMBERS = {"quick": DiagnosisConfig(members=12), "full": DiagnosisConfig()}  # by preset: 12 tell a variance to 21 %, 16 to 18 %
Value = TypeVar("Value")


def of_preset(known: Mapping[str, Value], preset: str) -> Value:
    """What is ``known`` of a ``preset``. Raises ValueError for an unknown one."""
    if preset not in known:
        raise ValueError(f"unknown preset {preset!r}; known: {', '.join(known)}")
    return known[preset]
