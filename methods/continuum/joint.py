"""Several recordings of one object: which of them, from which frame to which, their bodies, and how they start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...datasets.scenario import Observed
from ..base import spread_evenly
from .bodies import Body, bodies_of
from .config import Config
from .scene import Scene
from .start import starts_at_rest
from .windows import can_begin_anywhere, window

__all__ = ["placed", "scenes_of"]


def scenes_of(observed: Sequence[Observed], config: Config, *, seed: int = 0) -> tuple[list[Observed], list[Scene], Body]:
    """(what is fitted of each recording, its scene, and the body of the first recording in its frame 0).

    The first recording is among them, the others spread over all. A window that begins later starts as it moves there.
    """
    first = bodies_of(observed[:1], times=config.pitch, elements=config.elements)[0]
    most = config.recordings or round(config.more * first.recordings)
    seconds = config.seconds or first.seconds
    used = spread_evenly(observed, most)
    bodies = bodies_of(used, kind=first.kind, times=config.pitch, elements=config.elements)
    random, windows, scenes = np.random.default_rng(seed), [], []
    for one, body in zip(used, bodies, strict=True):
        cut, begins = _window(one, seconds, random)
        windows.append(cut)
        scenes.append(placed(cut, body, config) if not begins else _under_way(cut, body, config))
    return windows, scenes, bodies[0]


def placed(recording: Observed, body: Body, config: Config, seen: Observed | None = None) -> Scene:
    """The scene of a recording from its frame 0 on, which starts as ``config`` says, by the first frames of what was ``seen`` of it."""
    seen = recording if seen is None else seen
    found = starts_at_rest(seen) if config.start != "frames" else None
    contact = meets_itself(body, config)
    if found and (found.rest or config.start == "rest"):
        return Scene.of(recording, body, still=found.still, contact=contact)
    why = f": {found.words}" if found else ""
    return Scene.of(
        recording, body, speeds=body.speeds(seen), contact=contact, notes=(f"its start velocity is told by its first frames{why}",)
    )


def meets_itself(body: Body, config: Config) -> bool:
    """Whether layers or strands of a body meet; raises ValueError where that is asked for and its kind cannot."""
    if config.contact == "on" and not body.thickness:
        raise ValueError(f"contact of a body with itself is for sheets and ropes, got a {body.kind}")
    return config.contact == "on" or (config.contact == "auto" and body.is_folded)


def _under_way(cut: Observed, body: Body, config: Config) -> Scene:
    there = body.laid(cut)
    return Scene.of(cut, there, speeds=there.speeds(cut), contact=meets_itself(body, config))


def _window(recording, seconds, random):
    """(the window, the frame of the recording in which it begins): one drawn from those that are whole, or the first frames."""
    count = int(min(recording.observed_frames, np.ceil(min(seconds, 1e6) * recording.fps)))
    begins = np.flatnonzero(can_begin_anywhere(recording)[: recording.observed_frames - count + 1])
    first = int(random.choice(begins)) if len(begins) else 0
    return window(recording, first, first + count), first
