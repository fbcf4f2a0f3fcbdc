"""A body from a recording: what kind it is, what it fills in frame 0, its skin, and the grid around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Observed
from ...datasets.spacing import spacing
from ...physics.grids import Grid
from .gridding import grid_of, spread_over
from .inside import inside_of
from .kinds import GROWTH, KINDS, kind_of
from .unseen import FOLDED, complete, has_depth, is_one_sided, shortest_chord, upwards

__all__ = ["SolidBody", "body_of"]

FEWEST = 20  # points in frame 0 that tell a body's shape
THINNEST = 0.004  # m: noise of a millimetre on either side of a skin makes nothing look 3 mm thick
RESOLVED = 0.6  # of the points' spacing, below which a thickness is that of their noise
MARKERS = 0.1  # of a body's points: fewer tracks are markers on it, which stand off its skin
SKIN = 0.6  # of a cell's size, from one point of the surface to the next


@dataclass(frozen=True, eq=False)
class SolidBody:
    """A body at rest, which is frame 0 of its recording. Lengths in m, in the room.

    kind       rope, sheet or solid; ``evidence`` the figures that told it, and their meaning in ``words``
    samples    (P, 3) m, evenly filling the inside
    volume     m^3, and ``thickness`` m, the median over the inside of the local one
    surface    (S, 3) m, points evenly spread over the skin; ``area`` m^2 of the whole of it
    grid       the cells around it; None of a rope or a sheet that no grid was asked of
    rest       (M, 3) m, the recording's structure points
    notes      what was completed or assumed, a sentence each
    """

    kind: str
    evidence: dict
    samples: np.ndarray
    volume: float
    thickness: float
    surface: np.ndarray
    area: float
    grid: Grid | None
    rest: np.ndarray
    notes: tuple[str, ...] = ()


def body_of(recording: Observed, *, kind: str | None = None, pitch: float | None = None) -> SolidBody:
    """The body of a recording, from its points in frame 0.

    kind   of ``KINDS``; told from the recording unless given. A solid gets a grid
    pitch  edge of a cell [m], which asks for a grid of any kind; unless given as ``gridding.grid_of``
           says, such that whole cells span the body

    Raises ValueError where there are too few points, or a grid is asked of a body that lies in a plane or is too thin.
    """
    if kind is not None and kind not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
    if pitch is not None and not (np.isfinite(pitch) and pitch > 0):
        raise ValueError(f"pitch must be > 0 [m], got {pitch}")
    where = f" (scenario {recording.name})"
    points, spacing = _known(recording, where)
    notes = []
    if not recording.counts[1] + recording.counts[2] and kind in (None, "solid"):
        points, notes = _completed(recording, points, spacing, surely=kind == "solid")
    try:
        inside = inside_of(points, spacing)
    except ValueError:
        inside = None
    chord = shortest_chord(recording, 2 * inside.thickness) if inside else np.nan
    told, evidence = kind_of(points, inside, spacing, None if np.isnan(chord) else bool(chord < FOLDED))
    evidence |= {"told": told, "shortest_chord": chord}
    if kind not in (None, told):
        notes.append(f"said to be a {kind}; from its points it would be a {told}")
    kind = kind or told
    if kind != "solid" and pitch is None:
        return _ungridded(recording, kind, evidence, inside, notes)
    _refuse_thin(inside, spacing, kind, where)
    assert inside is not None  # or it would have been too thin
    if evidence["growth"] > GROWTH:
        notes.append(f"how much its points enclose is uncertain: {100 * evidence['growth']:.0f} % more if gaps a fifth wider are closed")
    grid, samples = grid_of(inside, pitch, where)
    surface = spread_over(inside, SKIN * grid.size.min())
    return SolidBody(
        kind, evidence, samples, inside.volume, inside.thickness, surface, inside.area, grid, recording.structure, tuple(notes)
    )


def _known(recording, where):
    """Points of the body in frame 0 that were seen, are driven or come from a shape prior, and their spacing [m]; no few markers."""
    tracked = recording.known[: recording.counts[0]].copy()
    given = len(recording.surface) + len(recording.interior)
    if tracked.sum() < MARKERS * given:
        tracked[:] = False
    tracked[recording.grips[recording.grips >= 0]] = True
    points = np.concatenate([recording.points[0, tracked], recording.surface, recording.interior])
    points = np.unique(points, axis=0)
    if not np.isfinite(points).all():
        raise ValueError(f"the points of a body must be finite in frame 0, {int((~np.isfinite(points)).any(1).sum())} are not{where}")
    if len(points) < FEWEST:
        raise ValueError(f"a body must have at least {FEWEST} points in frame 0 that were seen or supplied, got {len(points)}{where}")
    return points, spacing(points)


def _completed(recording, points, spacing, *, surely):
    """``points`` and what their other side may be, where they are one side of a solid; and notes on that."""
    up, ground = upwards(recording, points, spacing)
    if not is_one_sided(points, up, spacing):
        return points, []
    if not (surely or has_depth(recording, points, up, spacing, ground)):
        return points, ["only one side was seen, and nothing says that there is depth behind it: taken for all of the body"]
    more, note = complete(points, spacing, up, ground)
    return np.concatenate([points, more]), [note]


def _ungridded(recording, kind, evidence, inside, notes):
    nothing = np.zeros((0, 3))
    if inside is None:
        return SolidBody(kind, evidence, nothing, 0.0, 0.0, nothing, 0.0, None, recording.structure, tuple(notes))
    surface = spread_over(inside, max(SKIN * inside.thickness, inside.radius / 2))
    samples = inside.scattered(1000)
    return SolidBody(
        kind, evidence, samples, inside.volume, inside.thickness, surface, inside.area, None, recording.structure, tuple(notes)
    )


def _refuse_thin(inside, spacing, kind, where):
    if inside is None:
        raise ValueError(f"a {kind} whose points lie in a plane is too thin to grid{where}")
    least = max(THINNEST, RESOLVED * spacing)
    if inside.thickness < least:
        raise ValueError(
            f"a {kind} {1e3 * inside.thickness:.1f} mm thick is too thin to grid: points {1e3 * spacing:.1f} mm apart tell "
            f"{1e3 * least:.1f} mm and more{where}"
        )
