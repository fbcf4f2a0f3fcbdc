"""Which unit lengths have and which way gravity points: millimetres, and data whose up is the recording's down, are recognised.

What cannot be otherwise is an error. Where somebody may have meant it, it is a warning, which ``Collection.load`` says as well.
"""

from __future__ import annotations

import numpy as np

from .findings import Findings, error, warning

__all__ = ["BELOW", "LARGE", "in_metres", "upright"]

SMALL, LARGE = 0.01, 10.0  # m: bodies that tables and cameras are made for
BELOW = 1e-3  # m: noise of depth cameras at the table
DEEP = 0.1  # m below the table: beyond what a calibration of cameras may be off by
SHARE = 0.95  # of points and hands, or of frames, that must lie so: a few tracks are always wrong
TOWARDS = 0.5  # cosine of gravity and the ground's normal, from which gravity points away from a table however that leans


def in_metres(body: np.ndarray, longest: str = "points") -> Findings:
    """Findings about the unit of ``body`` (P, 3), its points of frame 0; ``longest`` is the field that makes it as long as it is."""
    extent = float(np.ptp(body, axis=0).max())
    if extent > LARGE:
        thousandth = f": are these millimetres? Then it is {extent / 1000:.3g} m" if SMALL <= extent / 1000 <= LARGE else ""
        yield error(longest, f"must be in metres, got a body that is {extent:.3g} m long in frame 0{thousandth}")
    elif extent < SMALL:
        yield warning("points", f"the body is {extent:.3g} m long in frame 0: are the units metres?")


def upright(gravity, ground, points, visible, controllers) -> Findings:
    """Findings about ``gravity`` (3,) beside the ``ground``, a Plane or None, ``points`` (T, N, 3) and ``controllers`` (T, C, 3)."""
    size = float(np.linalg.norm(gravity))
    if not size or not visible.any():
        return
    up = -np.asarray(gravity) / size
    if ground is None:
        yield from _held(up, points, visible, controllers)
    elif -up @ ground.normal > TOWARDS:
        yield error("gravity", f"must point to the table, got {_rounded(gravity)}, away from it along its normal {_rounded(ground.normal)}")
    else:
        heights = np.concatenate([ground.height(points[visible]), ground.height(controllers).ravel()])
        if (heights < -BELOW).mean() >= SHARE and heights.min() < -DEEP:
            below = f"points and hands lie up to {-heights.min():.2g} m below the table"
            turned = f"gravity {_rounded(-gravity)} and a ground with the normal {_rounded(-ground.normal)}"
            turned += f" and the offset {0.0 - ground.offset:g}"
            lower = f"Unless the table lies lower than at its offset {ground.offset:g}, turned round: {turned}"
            yield error("gravity", f"points upwards for these data, got {_rounded(gravity)}: {below}. {lower}")


def _held(up, points, visible, controllers):
    """Without a table a body hangs from what holds it."""
    if not controllers.shape[1]:
        return
    hands = (controllers @ up).max(axis=1)  # (T,)
    seen = visible.any(axis=1)
    above = [((points[t][visible[t]] @ up) > hands[t]).mean() >= SHARE for t in np.flatnonzero(seen)]
    if np.mean(above) >= SHARE:
        yield warning("gravity", f"may point upwards for these data: {_rounded(-up)} is down, and the body lies above what holds it")


def _rounded(vector):
    return [round(float(x), 2) + 0.0 for x in vector]
