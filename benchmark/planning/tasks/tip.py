"""The end of a body that hangs from a hand is brought to a place in the air."""

from __future__ import annotations

import numpy as np

from .base import Scene, Task

__all__ = ["TASKS"]

END = 0.03  # of the body's points, those farthest from the hands, that are asked for: a few centimetres of a rope
AWAY = (0.1, 0.2)  # m, sideways from under where the hands are
RISE = (0.03, 0.08)  # m, above where the end lies: so low that a rope's other end hangs rather than flies


def brought(scene: Scene):
    """The end, as it is shaped, to its new middle; other points may be anywhere."""
    points, random = scene.structure, scene.random
    distance = np.linalg.norm(points - scene.hand, axis=1)
    far = float(np.quantile(distance, 1 - END))
    middle = points[distance >= far].mean(0)
    aside = scene.turned(scene.axes[0], random.uniform(0, 2 * np.pi)) * random.uniform(*AWAY)
    flat = scene.hand - middle
    flat = flat - scene.axes[2] * (flat @ scene.axes[2])
    place = middle + flat + aside + random.uniform(*RISE) * scene.axes[2]

    def wanted(asked):
        away = np.linalg.norm(asked - scene.hand, axis=1)
        own = away >= min(far, away.max())  # of few points none may be as far out as the end is
        return np.where(own[:, None], place, np.nan) * np.ones(3)

    return wanted


TASKS = (Task("tip", "the end of the body that hangs from the hand is at a place in the air", brought, "rope", "lift_shake"),)
