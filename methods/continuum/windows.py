"""Windows of recordings: short stretches of many say more of a body than long ones of few, whose errors have grown for long."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...datasets.scenario import Observed

__all__ = ["can_begin_anywhere", "window"]


def window(recording: Observed, first: int, last: int) -> Observed:
    """Frames [first, last) of ``recording``, as one that begins there; points that were not tracked are known in frame 0 alone."""
    if not 0 <= first < last <= recording.observed_frames:
        raise ValueError(f"frames must lie in [0, {recording.observed_frames}), got [{first}, {last}) (scenario {recording.name})")
    if first == 0 and last == recording.observed_frames:
        return recording
    cut = {name: getattr(recording, name)[first:last] for name in ("points", "visible", "motion_valid")}
    cut |= dict(colors=None if recording.colors is None else recording.colors[first:last], cameras=(), images=None)
    cut |= dict(controllers=recording.controllers[first:])
    cut |= dict(actuation=None if recording.actuation is None else recording.actuation[first:])
    if first:
        cut |= dict(surface=np.zeros((0, 3)), interior=np.zeros((0, 3)))
    return replace(recording, **cut)


def can_begin_anywhere(recording: Observed) -> np.ndarray:
    """(F,) the frames in which all of a body is seen that is known by its markers: another can only begin in frame 0."""
    markers = len(recording.surface) == 0 and (recording.grips >= 0).any()
    return np.asarray(recording.visible.all(1)) if markers else np.arange(recording.observed_frames) == 0
