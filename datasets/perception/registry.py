"""Models of masks and tracks by name."""

from __future__ import annotations

from ...spelling import nearest
from .background import BackgroundMasks
from .base import Masker, Tracker
from .flow import FlowTracks
from .grounded import GroundedSam2
from .models import CoTracker, Sam2
from .tapir import Tapir

__all__ = ["masker", "maskers", "tracker", "trackers"]


def maskers() -> dict[str, type[Masker]]:
    """All there are; the first is the default."""
    return {one.name: one for one in (BackgroundMasks, Sam2, GroundedSam2)}


def trackers() -> dict[str, type[Tracker]]:
    """All there are; the first is the default."""
    return {one.name: one for one in (FlowTracks, CoTracker, Tapir)}


def masker(name: str) -> Masker:
    """Raises ValueError with the nearest name where there is none of that."""
    return _made("masks", name, maskers())


def tracker(name: str) -> Tracker:
    """Raises ValueError with the nearest name where there is none of that."""
    return _made("tracks", name, trackers())


def _made(kind, name, known):
    if name not in known:
        raise ValueError(f"unknown model of {kind} {name!r}; {nearest(name, known)}")
    return known[name]()
