"""What an end of a plan is worth: both directions of the Chamfer distance, points that correspond, table, workspace and stretch."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...datasets.scenario import Observed
from ...metrics.chamfer import one_sided_chamfer
from .config import PlanConfig
from .controls import axes_of
from .goal import Goal

__all__ = ["Judge", "Outcome"]

NEIGHBOURS = 6  # of a point whose distances tell stretch
APART = 0.01  # m, at least, between two points whose distance tells stretch: nearer ones are on either side of a rope or a sheet


@dataclass(frozen=True)
class Outcome:
    """Lengths in m, at the end of a plan; what is violated, in its worst frame.

    point         mean distance of points from where they are wanted, NaN without correspondences
    goal_to_body  mean distance from each point of the goal to the nearest of the body, and ``body_to_goal`` the other direction
    table         how far the deepest point is below the ground, or below where the body's deepest was in frame 0
    reach         how far a point is outside the workspace
    stretch       largest share by which neighbouring points have parted
    """

    point: float
    goal_to_body: float
    body_to_goal: float
    table: float
    reach: float
    stretch: float

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Judge:
    """Scores paths of a goal's points. ``pairs`` (E, 2) are neighbours; ``low``, ``high`` (3,) m the workspace along ``axes``: what holds
    body and hands in frame 0, and as much more as hands may go; ``floor`` [m] how deep the body is in frame 0 at most."""

    goal: Goal
    config: PlanConfig
    pairs: np.ndarray
    axes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    ground: Any
    floor: float

    @classmethod
    def of(cls, goal: Goal, start: Observed, config: PlanConfig) -> Judge:
        from scipy.spatial import cKDTree

        count = min(4 * NEIGHBOURS, len(goal.points))
        distance, other = cKDTree(goal.points).query(goal.points, k=range(1, count + 1))
        pairs = [(i, j) for i, (ds, js) in enumerate(zip(distance, other, strict=True)) for j in js[ds >= APART][:NEIGHBOURS]]
        pairs = np.unique(np.sort(np.array(pairs, int).reshape(-1, 2), axis=1), axis=0)
        axes = axes_of(start.gravity)
        within = np.concatenate([goal.points, start.controllers[0]]) @ axes.T
        aside, above = config.aside, config.above
        floor = 0.0 if start.ground is None else min(0.0, float(start.ground.height(goal.points).min()))
        low, high = within.min(0) - [aside, aside, aside], within.max(0) + [aside, aside, above]
        return cls(goal, config, pairs, axes, low, high, start.ground, floor)

    def outcome(self, path: np.ndarray) -> Outcome:
        """Of the goal's points along ``path`` (T, N, 3) m."""
        path, goal = np.asarray(path, float), self.goal
        end, asked = path[-1], goal.asked
        point = np.nan if goal.targets is None else float(np.linalg.norm(end[asked] - goal.targets[asked], axis=1).mean())
        room = path @ self.axes.T
        table = 0.0 if self.ground is None else float(max(0, self.floor - self.ground.height(path).min()))
        apart = np.linalg.norm(path[:, self.pairs[:, 0]] - path[:, self.pairs[:, 1]], axis=2)
        return Outcome(
            point,
            one_sided_chamfer(goal.cloud, end[asked], norm=2),
            one_sided_chamfer(end[asked], goal.cloud, norm=2),
            table,
            float(max(0, (self.low - room).max(), (room - self.high).max())),
            float(max(0.0, (apart / apart[0] - 1).max(initial=0.0))),
        )

    def cost(self, outcome: Outcome) -> float:
        """m: the mean distance of points where they correspond, else the mean of both directions; and what is violated."""
        config, off = self.config, outcome.point
        if np.isnan(off):
            off = (outcome.goal_to_body + outcome.body_to_goal) / 2
        beyond = max(0.0, outcome.stretch - config.most_stretch)
        return off + config.table * outcome.table + config.reach * outcome.reach + config.stretch * beyond
