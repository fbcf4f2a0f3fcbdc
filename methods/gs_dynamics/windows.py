"""Training windows: steps are counted by how far the tool travels, not by frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Observed
from .config import Config
from .place import Place, cells, tool_nodes

__all__ = ["Clip", "prepare", "smooth", "steps", "travel", "usual_paths", "window"]

LAST_SHARE = 0.75  # of the threshold, at which the last frame counts as a step
PASSES = 10  # of the published smoothing
DEVIATIONS = 3.0  # median absolute deviations of a path's length beyond which a track is unusual


@dataclass(frozen=True)
class Clip:
    """One recording, ready to draw windows from.

    points   (F, N, 3) m, z up; rows mean nothing where a window does not list the point
    tools    (F, K, 3) m
    windows  pairs of frames (H + future,) and the points (n,) that are seen in all of them
    """

    points: np.ndarray
    tools: np.ndarray
    windows: tuple[tuple[np.ndarray, np.ndarray], ...]


def prepare(observed: Observed, config: Config) -> Clip:
    """The windows of a recording's observed frames. Those in which fewer than two points are seen throughout are left out."""
    frames, place = observed.observed_frames, Place.of(observed)
    seen = observed.visible
    points = place.upright.local(np.where(seen[..., None], observed.points, 0.0))
    controllers = place.upright.local(observed.controllers[:frames])
    if config.quirks.dropped_tracks:
        seen = seen & usual_paths(points, seen)
    if config.quirks.smoothed_tracks:
        points = smooth(points, seen)
    tools = tool_nodes(controllers, cells(place.controllers, config.tool_radius))
    later, earlier = steps(tools, config.threshold)
    windows = []
    for t in range(frames):
        indices = window(t, later, earlier, history=config.history, future=config.future)
        kept = seen[indices].all(axis=0) & observed.motion_valid[indices[indices < indices[-1]]].all(axis=0)
        if kept.sum() > 1:
            windows.append((indices, np.flatnonzero(kept)))
    return Clip(points, tools, tuple(windows))


def travel(tools, frame: int) -> np.ndarray:
    """(F,) how far [m] the tool node that moved most is in each frame of ``tools`` (F, K, 3) from where it is in ``frame``.

    Unlike a norm over all nodes it does not grow with their number, and unlike a mean a hand at rest does not hide one that moves.
    """
    return np.linalg.norm(tools - tools[frame], axis=2).max(axis=1)


def steps(tools, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """(F,) the frame of the next step after each frame, and (F,) of the step before; the frame itself where there is none.

    A step is the first frame in which the tools (F, K, 3) have travelled ``threshold`` [m]; the last frame is one from 3/4 of it on.
    """
    frames = len(tools)
    later, earlier = np.arange(frames), np.arange(frames)
    for t in range(frames):
        far = travel(tools, t)
        after = t + 1 + np.flatnonzero(far[t + 1 :] >= threshold)
        before = np.flatnonzero(far[:t] >= threshold)
        if len(after):
            later[t] = after[0]
        elif far[-1] >= LAST_SHARE * threshold:
            later[t] = frames - 1
        if len(before):
            earlier[t] = before[-1]
    return later, earlier


def window(t: int, later, earlier, *, history: int, future: int) -> np.ndarray:
    """(history + future,) the frames of a window whose history ends in frame ``t``; where there are no more steps, the last repeats."""
    before, after = [t], [t]
    for _ in range(history - 1):
        before.append(int(earlier[before[-1]]))
    for _ in range(future):
        after.append(int(later[after[-1]]))
    return np.array(before[::-1] + after[1:])


def usual_paths(points, seen) -> np.ndarray:
    """(N,) whether the mean path per frame of a track ``points`` (F, N, 3), where ``seen`` (F, N), is like the others'."""
    both = seen[1:] & seen[:-1]
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=2)
    path = (lengths * both).sum(axis=0) / np.maximum(both.sum(axis=0), 1)
    off = np.abs(path - np.median(path))
    return off <= DEVIATIONS * np.median(off)


def smooth(points, seen, passes: int = PASSES) -> np.ndarray:
    """``points`` (F, N, 3) averaged over those of three neighbouring frames that are ``seen`` (F, N), ``passes`` times; ends stay."""
    weight = seen[..., None].astype(float)
    for _ in range(passes):
        kept = points * weight
        total = np.maximum(weight[:-2] + weight[1:-1] + weight[2:], 1.0)
        inner = np.where(weight[1:-1] > 0, (kept[:-2] + kept[1:-1] + kept[2:]) / total, points[1:-1])
        points = np.concatenate([points[:1], inner, points[-1:]])
    return points
