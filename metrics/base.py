"""What a metric is, how one is averaged over frames, and how the metrics of this folder are found.

A metric is one file in this folder that holds a ``METRIC``: an instance of a :class:`Metric`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from ..datasets.collection import nearest
from ..datasets.scenario import Scenario

__all__ = ["Metric", "Prediction", "Score", "get_metric", "metrics", "score"]


class Prediction(Protocol):
    """Predicted positions in metres: all particles (T, M, 3), the tracked ones (T, N, 3), everything on the surface (T, N+S, 3)."""

    @property
    def positions(self) -> np.ndarray: ...

    @property
    def tracked(self) -> np.ndarray: ...

    @property
    def surface(self) -> np.ndarray: ...


class Metric(ABC):
    """A pure function of a prediction and a recording, with what its number means.

    name        what it is called in rows and tables
    unit        unit of the value ("m", or "" for a ratio)
    direction   "lower" or "higher": which is better
    version     raised whenever the same input would give another number
    """

    name: str
    unit: str
    direction: Literal["lower", "higher"]
    version: int

    def __call__(self, prediction: Prediction, scenario: Scenario, frames: Sequence[int]) -> np.ndarray:
        """Values (F,), one per frame of ``frames``. NaN where the recording has nothing to compare with, or the prediction is not finite.

        Raises ValueError where a frame lies outside the prediction or the recording.
        """
        length = min(len(prediction.positions), scenario.frame_count)
        outside = [int(t) for t in frames if not 0 <= t < length]
        if outside:
            raise ValueError(f"{self.name}: frame {outside[0]} is outside the {length} predicted frames (scenario {scenario.name})")
        return np.array(self.per_frame(prediction, scenario, frames), dtype=float).reshape(len(frames))

    @abstractmethod
    def per_frame(self, prediction: Prediction, scenario: Scenario, frames: Sequence[int]) -> Sequence[float]:
        """The values of ``frames``, which are known to exist."""


@dataclass(frozen=True)
class Score:
    """Mean over the scorable frames (NaN if there is none, or the prediction is not finite), frames asked for, frames not scorable."""

    mean: float
    frames: int
    unscorable: int


def score(metric: Metric, prediction: Prediction, scenario: Scenario, frames: Sequence[int]) -> Score:
    """Average ``metric`` over ``frames``.

    A frame that the recording cannot score is left out and counted. A frame that the prediction does not reach (NaN or
    infinity) makes the mean NaN: a roll-out that blew up has no score, not the score of its good beginning.
    """
    values = metric(prediction, scenario, frames)
    finite = np.isfinite(prediction.positions[np.asarray(frames, int)]).all()
    scorable = ~np.isnan(values)
    mean = float(values[scorable].mean()) if finite and scorable.any() else float("nan")
    return Score(mean, len(values), int((~scorable).sum()))


def metrics() -> dict[str, Metric]:
    """Every metric found in this folder, by name."""
    found = {}
    for file in sorted(Path(__file__).parent.glob("*.py")):
        if file != Path(__file__) and "METRIC" in file.read_text(encoding="utf-8"):
            metric = getattr(import_module(f".{file.stem}", __package__), "METRIC", None)
            if metric is not None:
                found[metric.name] = metric
    return found


def get_metric(name: str) -> Metric:
    """The metric called ``name``. An unknown name raises ValueError with the nearest known one."""
    known = metrics()
    if name not in known:
        raise ValueError(f"unknown metric {name!r}; {nearest(name, known)}")
    return known[name]
