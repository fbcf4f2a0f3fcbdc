"""The axis of a rope that was filmed: a smooth curve through the middle of its points, and how thick it is around it."""

from __future__ import annotations

import numpy as np

from .kinds import farthest_ways

__all__ = ["axis_of", "resampled"]

ROUNDS = 4  # of curve and projection (Hastie and Stuetzle 1989)
SMOOTH = 1.5  # widths of the rope, over which its points are averaged: shorter ones follow the noise, longer ones cut bends
FEWEST = 6  # points of which a line can be told
FOLDED = 1.3  # times the way through a rope's points from neighbour to neighbour, which is never shorter than its axis: by then it is none
TURNED = 120.0  # degrees by which an axis turns from one of ``PARTS`` to the next. Of 263 ropes those in one line turn by at most 30, and
# five by 153 and more: their points lie in two lines side by side, where the ground or a camera is told wrongly. So sharp a hinge is as
# stiff as 1 / cos^2 of half its angle, and steps are hundreds of times as short
PARTS = 22  # of a rope's length
BETWEEN = 8  # places in each, from which a turn is looked for
ENDS = 0.005  # share of the points that may stick out beyond an end
SKIN = 0.8  # quantile of the points' distances from the axis that is the radius: some are inside, and noise throws others out


def axis_of(points, spacing: float, width: float) -> tuple[np.ndarray, float]:
    """((K, 3) m, places along the middle of a rope's ``points`` (M, 3), ``spacing`` apart and about ``width`` across; radius [m]).

    Raises ValueError where the points follow no single line: the curve through them then goes to and fro, or there and back.
    """
    points = np.asarray(points, float)
    along = farthest_ways(points)
    length = float(np.ptp(along))
    step = max(width, 2 * spacing)
    for _ in range(ROUNDS):
        curve = _through(points, along, step)
        along, apart = _projected(points, curve)
    if np.ptp(along) > FOLDED * length:
        raise ValueError(f"a rope's points must follow one line, got one of {np.ptp(along):.2f} m through points {length:.2f} m long")
    low, high = np.quantile(along, [ENDS, 1 - ENDS])
    axis = resampled(curve, max(2, round((high - low) / (0.5 * step)) + 1), low, high)
    if (turned := _turned(axis)) > TURNED:
        raise ValueError(
            f"a rope's points must follow one line, got one that turns back by {turned:.0f} degrees: they lie in two lines "
            "side by side, as where cameras do not agree"
        )
    return axis, float(np.quantile(apart, SKIN))


def _turned(axis) -> float:
    """Degrees, the most by which ``axis`` (K, 3) turns from one part of its length to the next."""
    places = resampled(axis, PARTS * BETWEEN + 1)
    ways = places[BETWEEN:] - places[:-BETWEEN]
    ways = ways / np.linalg.norm(ways, axis=1)[:, None]
    return float(np.degrees(np.arccos(np.clip((ways[BETWEEN:] * ways[:-BETWEEN]).sum(1), -1.0, 1.0)).max()))


def resampled(curve, count: int, low: float | None = None, high: float | None = None) -> np.ndarray:
    """(count, 3) m, evenly along ``curve`` (K, 3) from ``low`` to ``high`` m of its arc: a cubic, straight on beyond its ends."""
    from scipy.interpolate import CubicSpline

    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    at = np.linspace(arc[0] if low is None else low, arc[-1] if high is None else high, count)
    inside = np.clip(at, arc[0], arc[-1])
    spline = CubicSpline(arc, curve, bc_type="natural") if len(curve) > 2 else CubicSpline(arc, curve, bc_type=((2, 0.0), (2, 0.0)))
    return spline(inside) + (at - inside)[:, None] * spline(inside, 1)


def _through(points, along, step):
    """(K, 3) m: averages of ``points`` whose place ``along`` [m] is near, half a ``step`` apart, without the drift of averages at ends."""
    at = np.linspace(along.min(), along.max(), max(3, round(np.ptp(along) / (0.5 * step)) + 1))
    off = along - at[:, None]
    far = np.sort(np.abs(off), axis=1)[:, min(FEWEST, len(points)) - 1 :][:, :1]  # where points are missing, over as many of the next
    weight = np.exp(-0.5 * (off / np.maximum(SMOOTH * step / 2, far)) ** 2)
    found = np.empty((len(at), 3))
    for k, (w, x) in enumerate(zip(weight, off, strict=True)):  # a line through what is near, at its place
        basis = np.stack([np.ones_like(x), x], 1)
        found[k] = np.linalg.lstsq(basis.T @ (w[:, None] * basis), basis.T @ (w[:, None] * points), rcond=1e-9)[0][0]
    return found


def _projected(points, curve):
    """((M,) m along ``curve``, straight on beyond its ends, (M,) m from it)."""
    start, way = curve[:-1], np.diff(curve, axis=0)
    long = np.linalg.norm(way, axis=1)
    arc = np.concatenate([[0.0], np.cumsum(long)])[:-1]
    share = np.einsum("msi,si->ms", points[:, None] - start, way) / np.maximum(long, 1e-12) ** 2
    low, high = np.zeros(len(way)), np.ones(len(way))
    low[0], high[-1] = -np.inf, np.inf
    share = np.clip(share, low, high)
    apart = np.linalg.norm(points[:, None] - start - share[..., None] * way, axis=2)
    which = apart.argmin(1)
    row = np.arange(len(points))
    return arc[which] + share[row, which] * long[which], apart[row, which]
