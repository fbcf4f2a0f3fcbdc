"""Parts of recordings, fitted or held out, and what a twin under its observer is off by in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .fit import Frames, Task, counted, floor_of
from .model import Model
from .replica import Replica

__all__ = ["MARGIN", "Part", "finite", "innovations", "judged", "nobody"]

MARGIN = 1.2  # on a twin's substeps, for numbers beside its own


@dataclass(frozen=True)
class Part:
    """Frames [first, last) of recording ``index`` in a task: what is fitted, or what is held out."""

    name: str
    index: int
    first: int
    last: int


def innovations(
    task: Task, model: Model, rows: Sequence[Mapping[str, float]], parts: Sequence[Part], substeps: Sequence[int]
) -> tuple[list[np.ndarray], list[Frames]]:
    """Per part (B, R) weighted innovations of ``rows`` of parameter values, each part's weights normalised to 1, and what its frames mean.

    ``substeps`` a frame by recording of the task.
    """
    out, frames = [], []
    runs = {}
    for part in parts:
        if part.index not in runs:
            simulator = task.simulators[part.index]
            last = max(p.last for p in parts if p.index == part.index)
            mine = [{**row, "observer_bandwidth": task.bandwidth} for row in rows]
            runs[part.index] = simulator.run(model.terms, mine, last, substeps=substeps[part.index])
        simulator, found = task.simulators[part.index], runs[part.index]
        seen = simulator.replica.sightings.position[part.first : part.last]
        there = counted(simulator.replica, part.first, part.last)
        gap = np.where(there[None, ..., None], seen[None] - found[:, part.first : part.last], 0.0)
        out.append((gap / np.sqrt(max(1, there.sum()))).reshape(len(rows), -1))
        frames.append(Frames.of_seen([there], [floor_of(simulator.replica, task.finest)]))
    return out, frames


def finite(columns: np.ndarray) -> np.ndarray:
    """(R, K) slopes, 0 by what makes a twin blow up: that explains nothing."""
    return np.where(np.isfinite(columns).all(0), columns, 0.0)


def nobody(replica: Replica) -> np.ndarray:
    """No node at all."""
    return np.zeros(0, int)


def judged(task: Task, part: Part, leave: Callable[[Replica], np.ndarray]) -> np.ndarray:
    """(R,) 1 where a residual of ``part`` counts, 0 at the nodes that ``leave`` names."""
    replica = task.simulators[part.index].replica
    counted = np.ones(len(replica.nodes))
    counted[leave(replica)] = 0.0
    return np.repeat(np.tile(counted, part.last - part.first), 3)
