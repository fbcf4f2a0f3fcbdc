"""Where a search begins: hands at rest, and hands that bring what they hold to where it is wanted, straight or in an arc."""

from __future__ import annotations

import numpy as np

from .controls import Controls
from .goal import Goal

__all__ = ["guesses", "wanted_shifts"]

HELD = 10  # points that stand for what a hand holds, the nearest to it that are asked for: a few square centimetres of a tracked body


def wanted_shifts(controls: Controls, goal: Goal) -> np.ndarray:
    """(H, 3) m along the room's axes, how far what each hand holds is from where it is wanted; of a mere cloud, its middle from the body's.

    A guess of geometry alone, the same for every twin.
    """
    hands = int(controls.hand.max()) + 1
    if goal.targets is None:
        return np.tile((goal.cloud.mean(0) - goal.points.mean(0)) @ controls.axes.T, (hands, 1))
    points, targets, found = goal.points[goal.asked], goal.targets[goal.asked], np.zeros((hands, 3))
    for hand in range(hands):
        middle = controls.controllers[controls.hand == hand].mean(0)
        near = np.argsort(np.linalg.norm(points - middle, axis=1))[:HELD]
        found[hand] = (targets[near] - points[near]).mean(0) @ controls.axes.T
    return found


def guesses(controls: Controls, goal: Goal) -> np.ndarray:
    """(3, K, H, 3) m, feasible way points: hands stay; go straight by ``wanted_shifts``; go there in half a circle over that way."""
    segments, hands, _ = controls.shape
    shifts, share = wanted_shifts(controls, goal), np.minimum(1, np.arange(1, segments + 1) / max(segments - 1, 1))
    straight = share[:, None, None] * shifts
    height = np.linalg.norm(shifts[:, :2], axis=1) / 2
    arc = straight + np.sin(np.pi * share)[:, None, None] * height[:, None] * np.array([0.0, 0.0, 1.0])
    return controls.feasible(np.stack([np.zeros((segments, hands, 3)), straight, arc]))
