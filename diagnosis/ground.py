"""Whether a body lies where the ground is told to be, without any simulation."""

from __future__ import annotations

import numpy as np

from ..datasets.scenario import Observed
from .sightings import noise_of

__all__ = ["is_raised", "sunk"]

SHARE = 0.1  # of the particles that must be as deep: not a few strays
STRAYS = 1.28  # standard deviations that one in ten normal errors exceeds
DEEP = 0.005  # m below the ground that soft contact and a rounded edge explain
PINNED, EDGE = 0.7, 0.1  # share of the particles exactly on the ground: of a flat sheet, half of whose errors point down; and to spare
ON = 1e-6  # m


def sunk(recording: Observed) -> float:
    """How clearly a body is below the told ground in frame 0: from 0, where it need not be, up.

    log of its depth over ``DEEP``: what a tenth of its particles is deeper than, tracking noise deducted. Published recordings raise what
    was seen below the ground onto it; then the share of particles that lie exactly there tells, beyond what errors bring.
    """
    if recording.ground is None:
        return 0.0
    height = recording.ground.height(recording.structure)
    early = slice(len(recording.points) // 2)  # frames that may be fitted
    tracks = np.where(recording.visible[early, :, None], recording.points[early], np.nan)
    depth = -(np.quantile(height, SHARE) + STRAYS * noise_of(tracks))
    return max(0.0, float(np.log(max(depth, 1e-9) / DEEP)), (_pinned(recording) - PINNED) / EDGE)


def is_raised(recording: Observed) -> bool:
    """Whether so much of a body lies exactly on the told ground in frame 0 that it was raised onto it: how far below it lay is lost."""
    return recording.ground is not None and _pinned(recording) > PINNED


def _pinned(recording: Observed) -> float:
    """Share of the particles that lie exactly on the ground in frame 0."""
    return float((np.abs(recording.ground.height(recording.structure)) < ON).mean()) if recording.ground else 0.0
