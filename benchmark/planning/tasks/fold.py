"""A cloth is folded in half: what is on the hands' side of its middle comes to lie on the other side."""

from __future__ import annotations

import numpy as np

from .base import Scene, Task

__all__ = ["TASKS"]

LAYER = 0.004  # m, by which the upper layer lies higher: a cloth's thickness and the noise of what is seen


def folded(scene: Scene):
    """Points beyond the line through the middle, across the way to the hands, are mirrored in it."""
    points, up = scene.structure, scene.axes[2]
    middle = points.mean(0)
    way = scene.level(scene.hand - middle)

    def wanted(asked):
        beyond = np.maximum((asked - middle) @ way, 0)[:, None]
        return asked - 2 * beyond * way + LAYER * (beyond > 0) * up

    return wanted


TASKS = (Task("fold", "the cloth is folded in half, the hands' side over the other", folded, "cloth", "fold"),)
