"""A plan: what hands should do, found by roll-outs of a twin."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...datasets.scenario import Observed
from ...methods.base import Diverged, Twin
from .config import PlanConfig
from .controls import Controls
from .cost import Judge, Outcome
from .goal import Goal
from .guesses import guesses
from .mppi import OPTIMISERS

__all__ = ["Plan", "held", "plan"]

FEW = 8  # frames in which table, workspace and stretch are looked at, beside the last


@dataclass(frozen=True, eq=False)
class Plan:
    """controllers (T, C, 3) m, the ``hand`` (C,) of each, and how far hands are ``moved`` (T, H, 3) m.

    ``predicted`` (T, N, 3) m is what the twin says of the goal's points, with its ``outcome`` and ``cost``; ``best`` the least cost after
    each update; ``seconds`` all in all, of them ``simulated`` in roll-outs.
    """

    controllers: np.ndarray
    hand: np.ndarray
    moved: np.ndarray
    predicted: np.ndarray
    outcome: Outcome
    cost: float
    best: tuple[float, ...]
    rollouts: int
    diverged: int
    seconds: float
    simulated: float


def held(start: Observed, frames: int) -> Observed:
    """Frame 0 of a recording in which hands stay where they are: what a planner may know of where it starts."""
    return replace(start.until(1), controllers=np.repeat(start.controllers[:1], frames, 0))


def plan(
    twin: Twin,
    start: Observed,
    goal: Goal,
    config: PlanConfig,
    *,
    optimiser: str = "mppi",
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> Plan:
    """What hands should do from frame 0 of ``start``, where ``twin`` is placed, so that its points come to ``goal``.

    Only frame 0 is looked at. Raises ValueError for an unknown optimiser, without hands, and where every roll-out diverged.
    """
    from ...datasets.plugins import unknown

    if optimiser not in OPTIMISERS:
        raise unknown("optimiser", optimiser, OPTIMISERS)
    begun, controls, judge = time.perf_counter(), Controls.of(start, config), Judge.of(goal, start, config)
    spent, lost, done, own = 0.0, 0, 0, None

    def positions(ways):
        """Of each path the goal's points (T, N, 3) m, which go the way of their particles; None where it diverged."""
        nonlocal own, spent
        before = time.perf_counter()
        found = twin.rollouts(controls.paths(ways))
        spent += time.perf_counter() - before
        if own is None and (good := next((one for one in found if not isinstance(one, Diverged)), None)):
            own = _particles(good.surface[0], goal.points)
        return [None if isinstance(one, Diverged) else goal.points + one.surface[:, own] - one.surface[0, own] for one in found]

    def cost(ways):
        nonlocal lost, done
        paths = positions(ways)
        lost, done = lost + sum(path is None for path in paths), done + len(paths)
        if progress:
            progress(f"{done} of {config.rollouts} roll-outs", done / config.rollouts)
        return np.array([np.inf if path is None else judge.cost(judge.outcome(_some(path))) for path in paths])

    begin = guesses(controls, goal)
    found = OPTIMISERS[optimiser](cost, controls.feasible, controls.shape, controls.step, config, seed=seed, guesses=begin)
    rolled, ways = spent, found.ways[None]
    path = positions(ways)[0]
    assert path is not None  # what was found did not diverge
    known = controls.paths(ways)[0], controls.hand, controls.moved(ways)[0], path, judge.outcome(path)
    return Plan(*known, found.cost, found.best, done, lost, time.perf_counter() - begun, rolled)


def _particles(particles, points):
    """(N,) the particle that stands for each of ``points``: the nearest in frame 0."""
    from scipy.spatial import cKDTree

    return cKDTree(particles).query(points)[1]


def _some(path):
    """A few frames and the last."""
    return path[np.unique(np.linspace(0, len(path) - 1, FEW + 1).astype(int))]
