"""One start and one goal, at which several twins try: what each plans, and where another engine knows the body, what that truly does."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...datasets.concealed.world import Unstable
from ...datasets.scenario import Observed, Scenario
from ...methods.base import Budget, Twin
from ...methods.registry import get_method
from .arms import Arm, fitted
from .config import PlanConfig
from .cost import Judge
from .goal import Goal
from .planner import Plan, held, plan
from .tasks import get_task
from .tasks.cloud import cloud_goal
from .truth import Start, Truth, drawn

__all__ = ["Attempt", "Trial"]


@dataclass(frozen=True, eq=False)
class Attempt:
    """Of ``arm`` a ``row`` for a table, its ``plan``, and ``true`` (frames, N, 3) m, where the goal's points truly went; None without."""

    arm: Arm
    row: dict
    plan: Plan | None = None
    true: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Trial:
    """``seen`` is what twins are fitted to, ``shown`` where they plan from, ``goal`` what is wanted there; ``truth`` and its ``start``
    simulate the body in another engine, or are None: then a plan's outcome is what its own twin says. ``known`` are fitted twins."""

    seen: Observed
    shown: Observed
    goal: Goal
    config: PlanConfig
    truth: Truth | None = None
    start: Start | None = None
    known: dict[str, Twin] = field(default_factory=dict)

    @classmethod
    def of_body(cls, body: str, task: str, config: PlanConfig, *, seed: int, hidden: str = "none", goal: str = "") -> Trial:
        """A body that is drawn and recorded in another engine, and a start with new grips. Raises as ``drawn`` and goals do."""
        asked = None if goal else get_task(task)
        shows = (asked and asked.shows) or SHOWS[body]
        truth = drawn(body, shows, seed=seed, hidden=hidden)
        start = truth.start(shows, config.frames)
        shown = held(start.scenario, config.frames)
        wanted = asked.goal(shown, seed=seed) if asked else cloud_goal(goal, shown)
        return cls(truth.recording.observed(), shown, wanted, config, truth, start)

    @classmethod
    def of_recording(cls, recording: Scenario, task: str, config: PlanConfig, *, seed: int, goal: str = "") -> Trial:
        """Frame 0 of a recording, whose body no engine knows. Raises ValueError as goals do."""
        shown = held(recording.initial(), config.frames)
        wanted = cloud_goal(goal, shown) if goal else get_task(task).goal(shown, seed=seed)
        return cls(recording.observed(), shown, wanted, config)

    @property
    def judge(self) -> Judge:
        return Judge.of(self.goal, self.shown, self.config)

    @property
    def still(self) -> float:
        """m, the cost of leaving the body as it is."""
        return self.judge.cost(self.judge.outcome(np.repeat(self.goal.points[None], 2, 0)))

    def attempt(
        self, arm: Arm, *, preset: str = "quick", device: str = "cpu", progress: Callable[[str, float], None] | None = None
    ) -> Attempt:
        """Fit, plan and, where the truth is there, execute. What an arm cannot do is said in its row's ``status``."""
        row = dict(task=self.goal.task, arm=str(arm), still=self.still)
        try:
            twin, row["fit_cpu"] = self._twin(arm, preset, device, progress)
            begun = time.process_time()
            made = plan(twin, self.shown, self.goal, self.config, optimiser=arm.optimiser, seed=arm.seed, progress=progress)
        except (ValueError, RuntimeError) as error:
            return Attempt(arm, row | dict(status=" ".join(str(error).split())))
        row |= dict(status="ok", plan_cpu=time.process_time() - begun, plan_seconds=made.seconds, rollouts=made.rollouts)
        row |= dict(rollouts_per_second=made.rollouts / made.simulated, diverged=made.diverged, frames=self.config.frames)
        row |= dict(twin_cost=made.cost) | {f"twin_{name}": value for name, value in made.outcome.as_dict().items()}
        if self.truth is None or self.start is None:
            return Attempt(arm, row, made)
        try:
            true = self.truth.execute(self.start, made.moved)
        except Unstable as error:
            return Attempt(arm, row | dict(status=f"the truth is unstable: {error}"), made)
        outcome = self.judge.outcome(true)
        row |= {f"true_{name}": value for name, value in outcome.as_dict().items()} | dict(true_cost=self.judge.cost(outcome))
        return Attempt(arm, row, made, true)

    def _twin(self, arm, preset, device, progress):
        """(the twin in the start, CPU seconds of its fit, 0 where it was there). Raises ValueError where it cannot be there."""
        if self.truth and (reason := get_method(arm.method).skip_transfer):
            raise ValueError(f"{arm.method} cannot be placed in another start: {reason}")
        begun = time.process_time()
        twin = fitted(arm, self.seen, budget=Budget(preset), device=device, known=self.known, progress=progress)
        spent = time.process_time() - begun
        return (twin.retarget(self.shown) if self.truth else twin), spent


SHOWS = {"rope": "drag", "cloth": "fold", "plush": "drag"}  # the interaction that a body is fitted in where only a cloud is wanted
