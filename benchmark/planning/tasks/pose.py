"""A body is moved over the table to a pose: turned about the upward axis and shifted, its shape as it is."""

from __future__ import annotations

import numpy as np

from .base import Scene, Task

__all__ = ["TASKS"]

TURN = (0.3, 0.8)  # rad: hands that go straight do not turn a body that follows them stiffly
SHIFT = (0.08, 0.16)  # m: about half of the body's length


def posed(scene: Scene):
    """Points as one rigid body."""
    points, random = scene.structure, scene.random
    middle, angle = points.mean(0), random.choice([-1, 1]) * random.uniform(*TURN)
    shift = scene.turned(scene.axes[0], random.uniform(0, 2 * np.pi)) * random.uniform(*SHIFT)

    def wanted(asked):
        return middle + scene.turned(asked - middle, angle) + shift

    return wanted


TASKS = (Task("pose", "the body lies elsewhere on the table, turned", posed, "plush", "drag"),)
