"""A task: a goal that is made for a start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np

from ....datasets.scenario import Observed
from ..controls import axes_of
from ..goal import Goal

__all__ = ["Scene", "Task", "get_task", "tasks"]


@dataclass(frozen=True, eq=False)
class Scene:
    """A start as tasks see it: ``start``, whose frame 0 is looked at, ``axes`` (3, 3) of the room, the third upward, and ``random``."""

    start: Observed
    axes: np.ndarray
    random: np.random.Generator

    @property
    def structure(self) -> np.ndarray:
        """(S, 3) m, what is known of the surface in frame 0."""
        count = self.start.counts[0] + self.start.counts[1]
        return self.start.structure[:count][self.start.known[:count]]

    @property
    def hand(self) -> np.ndarray:
        """(3,) m, the middle of all controllers."""
        return self.start.controllers[0].mean(0)

    def level(self, way) -> np.ndarray:
        """(3,) the unit vector along the horizontal part of ``way``; along the first axis where it has none."""
        flat = self.axes[:2].T @ (self.axes[:2] @ np.asarray(way))
        size = np.linalg.norm(flat)
        return flat / size if size > 1e-9 else self.axes[0]

    def turned(self, way, angle: float) -> np.ndarray:
        """``way`` turned by ``angle`` [rad] about the upward axis."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_rotvec(angle * self.axes[2]).apply(way)


@dataclass(frozen=True)
class Task:
    """``name``; ``says``, what is wanted, in one line; ``wanted`` makes of a scene what says where points (n, 3) of the body should go.

    body  of ``datasets.concealed`` that it is measured with, "" for none
    shows  the interaction that such a body is fitted in
    """

    name: str
    says: str
    wanted: Callable[[Scene], Callable[[np.ndarray], np.ndarray]]
    body: str = ""
    shows: str = ""

    def goal(self, start: Observed, *, seed: int = 0) -> Goal:
        """The goal for frame 0 of ``start``; what is left open is drawn from ``seed``. Raises ValueError where the task makes no sense."""
        scene = Scene(start, axes_of(start.gravity), np.random.default_rng(seed))
        if len(scene.structure) < 3 or not start.visible[0].any():
            raise ValueError(f"task {self.name} needs points of the body in frame 0 (scenario {start.name})")
        return Goal.of(self.name, start, self.wanted(scene))


@cache
def tasks() -> dict[str, Task]:
    """All tasks by name, from every file of this folder that has ``TASKS``."""
    names = sorted(f.stem for f in Path(__file__).parent.glob("*.py") if f.stem not in ("__init__", "base"))
    modules = [import_module(f".{name}", __package__) for name in names]
    return {task.name: task for module in modules for task in getattr(module, "TASKS", ())}


def get_task(name: str) -> Task:
    """The task called ``name``. Raises ValueError with the nearest known one."""
    from ....datasets.plugins import unknown

    if name not in tasks():
        raise unknown("task", name, tasks())
    return tasks()[name]
