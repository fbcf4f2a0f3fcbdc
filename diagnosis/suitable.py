"""What recordings must have to be diagnosed: each thing that is missing is one error that says which recording, which rule and how much."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..datasets.scenario import ANOTHER_INTERACTION, Scenario
from ..methods.continuum.bodies import Body, bodies_of
from ..methods.continuum.body import body_of
from .config import DiagnosisConfig
from .ground import sunk
from .inference.blocks import Blocks, is_marked
from .inference.controls import Controls
from .inference.peers import FEWEST, are_members

__all__ = ["has_continuum", "suitable", "unseen_below"]

FRAMES = 12  # train frames: eight bins of fewer are single frames, whose noise is no mean's
POINTS = 20  # tracked points that are seen in frame 0: two regions of ten
MARKERS = 3  # that are seen in frame 0 and not driven, where there are markers: fewer show no shape
EXTENT = 0.02, 5.0  # m: beyond it, units are wrong or nothing of the tables' bodies is meant
SEEN = 0.2  # of points that no hand drives, and frames: of less, most means are of nothing
LIKE = 1.6  # in size, of two recordings of one object: poses and views differ by less


def has_continuum(one: Scenario, fitted_on: Sequence[Scenario] = ()) -> bool:
    """Whether a continuum is asked of a recording unless somebody says otherwise: of what is tracked all over, and of a cable with markers
    that stands alone, where frozen controls say how far a twin of such a body is off. Of markers beside sound recordings a net of springs
    still names more, and that a body lies below the told ground, which shows in frame 0, it alone says.
    """
    config = DiagnosisConfig()
    marked = is_marked(one, config)
    if not one.correspond or (one.visible[0].sum() < POINTS and not marked) or ((one.grips >= 0).any() and not marked):
        return False
    try:
        kind = _body(one).kind
        Blocks.of(one, config)
    except ValueError:  # no such body, or too few tracks for means of them
        return False
    if sunk(one.observed()) > 0 or (marked and fitted_on):
        return False
    return Controls.of(kind, config, marked=marked) is not None


def unseen_below(recordings: Sequence[Scenario]) -> Scenario | None:
    """Of several recordings the first in which no body is seen and that lies below the told ground, or None: nothing can be fitted to it,
    and what is wrong shows in its frame 0.
    """
    for one in recordings if len(recordings) > 1 else ():
        if sunk(one.observed()) > 0:
            try:
                _body(one)
            except ValueError:
                return one
    return None


def suitable(
    recordings: Sequence[Scenario],
    transfer: Sequence[Scenario] = (),
    *,
    fitted_on: Sequence[Scenario] = (),
    against: Sequence[Scenario] = (),
    config: DiagnosisConfig | None = None,
) -> None:
    """Raises ValueError for recordings that are not of one object, or that no verdict can rest on, be it alone or beside others: of the
    same command (``against``), or in which nothing is missing (``fitted_on``).
    """
    if not recordings:
        raise ValueError("at least one recording must be given, got none")
    first, config = recordings[0], config or DiagnosisConfig()
    if is_marked(first, config) and len(recordings) != 1 and not are_members(first, fitted_on, config):
        beside = f"unless beside at least {FEWEST} sound ones, got {len(recordings)} beside {len(fitted_on)}"
        raise ValueError(f"markers are asked one recording at a time, {beside} (scenario {first.name})")
    recordings = [*recordings, *fitted_on, *against]
    for one in recordings:
        _enough(one, config)
        _fittable(one)
    for one in transfer:
        _enough(one, config)
    for k, one in enumerate(transfer):
        for other in (*recordings, *transfer[:k]):
            if one.interaction == other.interaction:
                raise ValueError(f"{ANOTHER_INTERACTION}, got the same as {other.name} (scenario {one.name})")
    for k, one in enumerate(recordings):
        for other in recordings[:k]:
            if one.interaction == other.interaction:
                raise ValueError(f"recordings must differ, got {other.name} twice (scenario {one.name})")
    body = _body(first)
    for one in (*recordings[1:], *transfer):
        _alike(body, first, one)


def _fittable(one: Scenario) -> None:
    """What is fitted must be seen in enough frames; of a transfer recording, what is seen is compared."""
    if one.split.train_end < FRAMES:
        raise ValueError(f"a diagnosis needs at least {FRAMES} train frames, got {one.split.train_end} (scenario {one.name})")
    predicted = np.setdiff1d(np.arange(one.points.shape[1]), one.grips)  # what hands drive need not be seen: it is told
    if (share := float(one.visible[: one.split.train_end, predicted].mean())) < SEEN:
        raise ValueError(f"points must be seen in at least {SEEN:.0%} of train frames, got {share:.1%} (scenario {one.name})")


def _enough(one: Scenario, config: DiagnosisConfig) -> None:
    if not one.correspond:
        raise ValueError(f"points must correspond from frame to frame for a diagnosis (scenario {one.name})")
    seen = one.points[0][one.visible[0]]
    marked, free = is_marked(one, config), np.setdiff1d(np.flatnonzero(one.visible[0]), one.grips)
    if marked and len(free) < MARKERS:
        raise ValueError(
            f"a diagnosis needs at least {MARKERS} markers seen in frame 0 that no hand drives, got {len(free)} (scenario {one.name})"
        )
    if not marked and len(seen) < POINTS:
        raise ValueError(f"a diagnosis needs at least {POINTS} points seen in frame 0, got {len(seen)} (scenario {one.name})")
    extent = float(np.ptp(seen, axis=0).max())
    if not EXTENT[0] <= extent <= EXTENT[1]:
        units = ": these look like millimetres, and metres are meant" if EXTENT[0] <= extent / 1000 <= EXTENT[1] else ""
        raise ValueError(f"a body must be {EXTENT[0]} to {EXTENT[1]} m long, got {extent:.3g} m{units} (scenario {one.name})")


def _body(one: Scenario) -> Body:
    """Raises ValueError where no body is seen in frame 0; tracks of one that lies below the told ground may have been raised onto it."""
    try:
        return bodies_of([one.observed()])[0]
    except ValueError as error:
        below = f"; {one.name} lies below the told ground in frame 0: ask it alone" if sunk(one.observed()) else ""
        raise ValueError(f"{error}{below}") from None


def _alike(first: Body, recording: Scenario, one: Scenario) -> None:
    """Of one kind, or such that one may be taken for the other. And of about one size: the root mean square distance from the middle of a
    solid, which no pose changes much.
    """
    body = _body(one)
    if body.kind != first.kind and not _mistaken(recording, one):
        folded = "; a sheet that begins folded looks like a solid: fit one in which it lies open" if body.kind == "sheet" else ""
        where = f"(scenario {one.name})"
        raise ValueError(f"recordings must show one object, got a {first.kind} in {recording.name} and a {body.kind} {where}{folded}")
    if not body.kind == first.kind == "solid":
        return
    sizes = [float(np.sqrt(((b.structure - b.structure.mean(0)) ** 2).sum(1).mean())) for b in (first, body)]
    if not 1 / LIKE <= sizes[1] / sizes[0] <= LIKE:
        said = f"{1e3 * sizes[0]:.0f} mm around its middle in {recording.name} and {1e3 * sizes[1]:.0f} mm"
        raise ValueError(f"recordings must show one object, got one of {said} (scenario {one.name})")


def _mistaken(recording: Scenario, one: Scenario) -> bool:
    """Whether both may be of one kind all the same. A plush that is ten times as long as wide, which is a rope, may touch itself in one of
    them: lengths are alike then, over their width and in metres. A sheet that begins folded looks like a solid that is as long.
    """
    told = [body_of(each.observed()).evidence for each in (recording, one)]
    slender = ("length_over_width", "length")
    alike = {("rope", "solid"): slender, ("solid", "rope"): slender, ("sheet", "solid"): ("length",)}
    names = alike.get(tuple(each["told"] for each in told), ())
    return bool(names) and all(max(pair) <= LIKE * min(pair) for pair in ([each[name] for each in told] for name in names))
