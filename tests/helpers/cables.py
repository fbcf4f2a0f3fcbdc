"""Marked cables, driven at some of their markers."""

import numpy as np
from twinbench.datasets.scenario import Observed
from twinbench.methods.continuum.rods import GRAVITY

DOWN = np.array([0, 0, -GRAVITY])


def cable(points, driven, *, controllers=None, gravity=DOWN, fps=30.0, name="cable") -> Observed:
    """A cable with markers at ``points`` (n, 3) or (F, n, 3), those ``driven`` held where they are or led along ``controllers``."""
    points = np.atleast_3d(points) if np.ndim(points) == 3 else np.asarray(points, float)[None]
    seen = np.ones(points.shape[:2], bool)
    led = points[:, list(driven)] if controllers is None else controllers
    between = np.concatenate([points[0, :-1] + share * np.diff(points[0], axis=0) for share in (0.25, 0.5, 0.75)])
    return Observed(
        name=name,
        points=points,
        visible=seen,
        motion_valid=seen,
        controllers=led,
        interior=between,
        grips=np.array(driven),
        gravity=gravity,
        fps=fps,
    )
