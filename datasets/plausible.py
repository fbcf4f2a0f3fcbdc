"""How the fields of a recording fit together: hands at the body, tracks on it, cameras that see it, one unit for all.

Where a recording cannot be what it says, as where hands are out of reach, that is an error; what somebody may have meant is a warning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .findings import Findings, count, error, warning
from .upright import BELOW, LARGE, in_metres, upright

__all__ = ["plausible"]

REACH = 0.08  # m, the widest controller radius that the published search may choose: a hand farther away holds nothing
SEEN_SHARE = 0.5  # of the body, in a camera whose matrix is turned round, to be sure that it is that
LOOKS = 20  # frames in which a camera is looked for the body


def plausible(values: Mapping[str, Any]) -> Findings:
    """The findings about ``values``, sound fields of a ``Scenario`` by name; what is not among them is not looked at."""
    points, visible = values.get("points"), values.get("visible")
    if points is None or visible is None:
        return
    body, longest = points[0], "points"
    for name in ("surface", "interior"):
        part = values.get(name, ())
        if len(part) and (yield from _on_body(name, "particle", part, points[0], max(_length(points[0]), _length(part)), 0)):
            longest = longest if _length(body) > LARGE else name
            body = np.concatenate([body, part])
    yield from in_metres(body, longest)
    if (twins := len(body) - len(np.unique(body, axis=0))) > 0:
        yield warning("points", f"{twins} particle{'s' * (twins > 1)} of frame 0 lie on another one: no spring can join them")
    if not values.get("timed", True):
        yield warning("fps", "was not recorded: speeds, frequencies and damping times are as uncertain as it is")
    if not values.get("correspond", True):
        yield warning("points", "do not correspond from frame to frame: tracks and coordinates cannot be scored")
    if len(unseen := np.flatnonzero(~visible.any(1))):
        what = count(unseen >= 0, "frame")
        yield warning("visible", f"is False for every point in {what}, first in frame {unseen[0]}: they cannot be scored")
    ground = values.get("ground")
    if ground is not None and (below := ground.height(points[visible]) < -BELOW).any():
        yield warning("points", f"{count(below, 'visible row')} more than {1000 * BELOW:g} mm below the table")
    if "gravity" in values and values.get("controllers") is not None:
        yield from upright(values["gravity"], ground, points, visible, values["controllers"])
    if values.get("correspond", True):
        yield from _leaps(points, visible, _length(body))
    if values.get("colors") is not None and not ((values["colors"][visible] >= 0) & (values["colors"][visible] <= 1)).all():
        yield warning("colors", "must lie in [0, 1] at visible points, and does not")
    if values.get("controllers") is not None:
        yield from _hands(values["controllers"], values.get("grips"), body)
    if values.get("tracks") is not None:
        yield from _tracks(values["tracks"], points, visible, body)
    yield from _cameras(values.get("cameras", ()), points, visible, body)


def _hands(controllers, grips, body):
    if not controllers.shape[1]:
        yield warning("controllers", "is empty: nothing drives the body")
        return
    hands = controllers[0] if grips is None else controllers[0][grips < 0]  # a driven marker is a point of the body
    if not len(hands):
        return
    from scipy.spatial import cKDTree

    tree = cKDTree(body)
    reach = max(REACH, float(np.median(tree.query(body, k=2)[0][:, 1])) if len(body) > 1 else 0.0)  # coarse markers reach farther
    distance = tree.query(hands)[0]
    far = distance > reach
    if far.all() and len(hands) == controllers.shape[1]:
        rule = f"must be within reach of the body, {reach:.3g} m"
        yield error("controllers", f"{rule}, got {distance.min():.3g} m from it to the nearest in frame 0")
    elif far.any():
        yield warning("controllers", f"{count(far, 'controller')} more than {reach:.3g} m away from the body in frame 0")


def _tracks(tracks, points, visible, body):
    annotated = np.isfinite(tracks).all(-1)
    if not len(annotated) or not annotated[0].any():
        yield warning("tracks", "no track is annotated in frame 0: the track error cannot be scored")
    if not annotated.any():
        return
    first = int(annotated.any(1).argmax())
    there = body if first == 0 else points[first][visible[first]]
    if not len(there):
        return
    yield from _on_body("tracks", "track", tracks[first][annotated[first]], there, _length(body), first)


def _on_body(name, noun, found, there, length, frame):
    """Whether any of the points ``found`` of ``frame`` is on a body of that length [m] of which the points ``there`` are known."""
    from scipy.spatial import cKDTree

    limit = length + REACH
    distance = cKDTree(there).query(found)[0]
    far = distance > limit
    if far.all():
        rule = f"must lie on the body, in its units and axes, at most {limit:.3g} m from its points"
        yield error(name, f"{rule}, got {distance.min():.3g} m to the nearest in frame {frame}")
    elif far.any():
        yield warning(name, f"{count(far, noun)} more than {limit:.3g} m away from the body in frame {frame}")
    return not far.all()


def _leaps(points, visible, length):
    """Noise moves some tracks, and a hand the body bit by bit: only what is missing or joined moves all of it by its length at once."""
    both = visible[1:] & visible[:-1]
    with np.errstate(invalid="ignore", over="ignore"):
        step = np.where(both, np.linalg.norm(np.diff(points, axis=0), axis=2), np.inf).min(axis=1)
    leaps = both.any(axis=1) & (step > length)
    if length and leaps.any():
        at, times = int(leaps.argmax()), count(leaps, "time")
        said = f"all leap at once by more than the body's length, {length:.3g} m, {times}, first by {step[at]:.3g} m after frame {at}"
        yield warning("points", f"{said}: are frames missing, or recordings joined?")


def _length(body):
    return float(np.ptp(body, axis=0).max())


def _cameras(cameras: Sequence, points, visible, body):
    frames = np.unique(np.linspace(0, len(points) - 1, LOOKS).astype(int))
    everything = np.concatenate([body, *(points[t][visible[t]] for t in frames)])
    for number, camera in enumerate(cameras):
        name, turn, centre = f"camera_to_world of camera {number}", camera.camera_to_world[:3, :3], camera.camera_to_world[:3, 3]
        if not _sees(camera, (everything - centre) @ turn).any():
            if _sees(camera, body @ turn.T + centre).mean() >= SEEN_SHARE:
                yield error(name, "must lead from camera to world, got its inverse: only that sees the body")
            else:
                yield warning(name, "does not see the body in any frame: is it camera to world, in metres?")
        elif (np.abs(centre - body.mean(0)) < np.ptp(body, axis=0) / 2).all():
            yield warning(name, "places the camera inside of the body")


def _sees(camera, local):
    """Which of the points ``local`` (P, 3), in the camera's axes, are in its image."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        pixel = (local @ camera.intrinsics.T)[:, :2] / local[:, 2:]
        return (local[:, 2] > 0) & (pixel >= 0).all(-1) & (pixel < (camera.width, camera.height)).all(-1)
