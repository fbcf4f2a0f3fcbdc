"""One recording on the way into a report: the error of every frame, and pictures or points of some."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ...datasets.scenario import Scenario
from ...diagnosis.page.arrays import packed, some
from ...diagnosis.page.document import plain
from ...methods.base import Trajectory
from ...metrics.base import Metric, Unscorable
from ..status import Stopped, as_status
from .exhibits import Exhibit, Replay
from .pictures import Recorded, encoded

__all__ = ["show"]

POINTS, HANDS = 300, 60  # more cannot be told apart in a small drawing
LEFT = 3.0  # radii of the scene from its centre: who is farther has left it, and would cost everything else its resolution
DIGITS = 7  # of an error in a curve

COLUMNS = ("method", "task", "status", "reason", "diverged_frame", "note", "frames")


def show(
    replay: Replay, exhibit: Exhibit, rows: Sequence[Mapping], *, frames: int, progress: Callable[[str], None] = lambda label: None
) -> dict:
    """The exhibit as the page reads it, of about ``frames`` of its frames.

    ``rows`` as the tables have them; ``curves`` by metric and method, one error per frame in the metric's unit, None where there is none;
    ``reasons`` by method, why there is no roll-out, or none to its end; ``kept``, the frames of which there are ``pictures`` (data
    addresses, WebP) or, where ``no_pictures`` says why not, ``points`` (metres).
    """
    scenario, rows = replay.load(exhibit.name), exhibit.rows(rows)
    rollouts, reasons = replay.play_exhibit(exhibit, rows, progress=progress)
    metrics = {name: metric for name, metric in replay.settings.metrics.items() if not metric.images}
    split, whole = scenario.split, scenario.frame_count
    kept = some(whole, frames, [0, split.train_end - 1, min(split.train_end, whole - 1), whole - 1])
    progress("pictures")
    pictures, missing = _pictures(scenario, rollouts, kept, wanted=replay.settings.images)
    found: Any = plain(
        {
            "collection": exhibit.collection,
            "name": exhibit.name,
            "sources": exhibit.sources,
            "transfer": exhibit.transfer,
            "seed": exhibit.seed,
            "methods": list(exhibit.rollouts),
            "frames": whole,
            "fps": scenario.fps,
            "train_end": 0 if exhibit.transfer else split.train_end,
            "rows": [_row(row, replay.settings.metrics) for row in rows],
            "curves": {name: _curves(metric, rollouts, scenario) for name, metric in metrics.items()},
            "reasons": reasons,
            "kept": kept,
            "pictures": pictures,
            "no_pictures": missing,
            "points": None if pictures else _points(scenario, rollouts, kept),
        }
    )
    return found


def _row(row: Mapping, metrics: Mapping[str, Metric]) -> dict:
    found = {name: row[name] for name in COLUMNS}
    return found | {"values": {m: row[m] for m in metrics}, "missing": {m: row[f"{m}_reason"] for m in metrics if row[f"{m}_reason"]}}


def _finite(trajectory: Trajectory) -> int:
    """Frames before the first that is not finite."""
    lost = np.flatnonzero(~np.isfinite(trajectory.positions).all(axis=(1, 2)))
    return int(lost[0]) if len(lost) else len(trajectory.positions)


def _curves(metric: Metric, rollouts: Mapping[str, Trajectory], scenario: Scenario) -> dict[str, list[float | None]]:
    """By method the error in every frame but the first, which every twin is given."""
    found = {}
    for method, trajectory in rollouts.items():
        curve = np.full(scenario.frame_count, np.nan)
        try:
            with as_status():
                curve[1 : _finite(trajectory)] = metric(trajectory, scenario, range(1, _finite(trajectory)))
        except Stopped:  # then the rows failed by it too, and say why
            continue
        found[method] = [None if np.isnan(value) else float(f"{value:.{DIGITS}g}") for value in curve]
    return {method: curve for method, curve in found.items() if any(value is not None for value in curve)}


def _pictures(scenario: Scenario, rollouts: Mapping[str, Any], kept: list[int], *, wanted: bool) -> tuple[dict | None, str]:
    """What camera 0 recorded beside what it would have seen of each roll-out, or None and why there is nothing of the kind."""
    if not wanted:
        return None, "no metric of this run looks at images"
    try:
        recorded = Recorded(scenario)
        seen = [recorded.picture(frame) for frame in kept]
    except Unscorable as error:
        return None, str(error)
    shown, reasons = {}, []
    for method, trajectory in rollouts.items():
        end = _finite(trajectory)
        try:
            shown[method] = [encoded(trajectory.image(recorded.camera, frame)) if frame < end else None for frame in kept]
        except Unscorable as error:
            reasons.append(str(error))
    if reasons and not shown:
        return None, reasons[0]
    width, height = recorded.camera.width, recorded.camera.height
    outlines = [recorded.outline(frame) for frame in kept]
    return {"width": width, "height": height, "recorded": seen, "outlines": outlines, "methods": shown}, ""


def _points(scenario: Scenario, rollouts: Mapping[str, Trajectory], kept: list[int]) -> dict:
    """What was seen, the controllers and every twin's surface, thinned, with the ``centre`` and ``radius`` [m] of the scene."""
    seen = np.where(scenario.visible[..., None], scenario.points, np.nan)
    known = np.concatenate([scenario.points[scenario.visible], scenario.controllers.reshape(-1, 3)])
    low, high = known.min(0), known.max(0)
    centre, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    up = -scenario.gravity if scenario.gravity.any() else np.array([0.0, 0.0, 1.0])

    def thinned(positions: np.ndarray, most: int) -> dict:
        chosen = np.array(positions[np.ix_(kept, some(positions.shape[1], most, []))], float)
        gone = ~(np.linalg.norm(chosen - centre, axis=-1) < LEFT * radius)  # NaN counts as gone
        return packed(np.where(gone[..., None], np.nan, chosen))

    return {
        "centre": centre,
        "radius": radius,
        "up": up / np.linalg.norm(up),
        "recorded": thinned(seen, POINTS),
        "hands": thinned(scenario.controllers, HANDS),
        "methods": {method: thinned(trajectory.surface, POINTS) for method, trajectory in rollouts.items()},
    }
