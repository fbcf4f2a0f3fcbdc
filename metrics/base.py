"""What a metric is, how one is averaged over frames, and how metrics are found.

A metric is one file in this folder that holds a ``METRIC``: an instance of a :class:`Metric`; or ``METRICS``, a tuple of them, where one
formula is applied as published and as it should be; or what the entry points ``twinbench.metrics`` of an installed package name, see
``datasets/plugins.py``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, overload

import numpy as np

from ..datasets.plugins import Kind, Origin, discover, one_line, said, unknown
from ..datasets.scenario import Camera, Scenario

__all__ = ["Metric", "Prediction", "Rendered", "Score", "Unscorable", "get_metric", "lacking", "metrics", "score", "scores"]

# what rows say beside their metrics, so that no metric can be called so
_COLUMNS = """collection scenario sources method task seed preset split appearance data_checksum images_checksum code_checksum
status reason diverged_frame note frames
fit_seconds rollout_seconds peak_memory_mib peak_device_memory_mib device commit python numpy torch warp twinbench date"""
COLUMNS = frozenset(_COLUMNS.split())


class Unscorable(ValueError):
    """There is nothing to compare, for the reason that the message gives: the value is NaN."""


class Prediction(Protocol):
    """Predicted positions in metres: all particles (T, M, 3), the tracked ones (T, N, 3), everything on the surface (T, N+S, 3)."""

    @property
    def positions(self) -> np.ndarray: ...

    @property
    def tracked(self) -> np.ndarray: ...

    @property
    def surface(self) -> np.ndarray: ...


class Rendered(Prediction, Protocol):
    """A prediction that can be looked at."""

    def image(self, camera: Camera, frame: int) -> np.ndarray:
        """(H, W, 4) floats in [0, 1]: colour over black (premultiplied) and opacity. Raises Unscorable where there is no appearance."""
        ...


class Metric(ABC):
    """A pure function of a prediction and a recording, with what its number means.

    name        what it is called in rows and tables
    unit        unit of the value ("m", "dB", or "" for a ratio)
    direction   "lower" or "higher": which is better
    version     raised whenever the same input would give another number
    images      whether it looks at images; then a prediction should be :class:`Rendered`
    pooled      whether a table averages it over the frames of all recordings together, instead of recording by recording
    """

    name: str
    unit: str
    direction: Literal["lower", "higher"]
    version: int
    images: bool = False
    pooled: bool = False

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

    def unavailable(self) -> str | None:
        """Why this metric has no value for any recording here (a package or a file that cannot be had), or None. Asked often: cheap."""
        return None

    def reason(self, prediction: Prediction, scenario: Scenario, frame: int) -> str:
        """Why ``frame``, which came out as NaN, has no value."""
        return f"frame {frame}: the recording has nothing to compare with"


@dataclass(frozen=True)
class Score:
    """Mean over the scorable frames (NaN if there is none, or the prediction is not finite), frames asked for, frames not scorable.

    ``reason`` says why the first of those is not; "" where all are.
    """

    mean: float
    frames: int
    unscorable: int
    reason: str = field(default="", repr=False)


@dataclass(frozen=True)
class Positions:
    """Predicted positions (T, M, 3) as an array: its first particles are the recording's tracked points, then come its surface points."""

    positions: np.ndarray
    counts: tuple[int, int]

    @classmethod
    def of(cls, array, scenario: Scenario) -> Positions:
        """Raises ValueError where ``array`` holds neither the tracked points alone, nor these with the surface, nor all particles."""
        array, counts = np.asarray(array, float), scenario.counts
        allowed = (counts[0], sum(counts[:2]), sum(counts))
        if array.ndim != 3 or array.shape[2] != 3 or array.shape[1] not in allowed:
            rule = f"(frames, particles, 3) with {' or '.join(map(str, dict.fromkeys(allowed)))} particles"
            raise ValueError(f"positions must have shape {rule} (scenario {scenario.name}), got {array.shape}")
        return cls(array, (counts[0], counts[1] if array.shape[1] > counts[0] else 0))

    @property
    def tracked(self) -> np.ndarray:
        return self.positions[:, : self.counts[0]]

    @property
    def surface(self) -> np.ndarray:
        return self.positions[:, : sum(self.counts)]


@overload
def score(metric: Metric | str, prediction: Prediction | np.ndarray, scenario: Scenario, frames: Sequence[int] | None = None) -> Score: ...
@overload
def score(
    metric: Sequence[Metric | str], prediction: Prediction | np.ndarray, scenario: Scenario, frames: Sequence[int] | None = None
) -> dict[str, Score]: ...
def score(metric, prediction, scenario, frames=None):
    """Average ``metric``, by name or itself, over ``frames``: by default the test frames, or where there are none all after frame 0.

    ``prediction`` is a roll-out, or positions in metres as an array (T, M, 3): the recording's tracked points in their order, then, if
    wanted, its surface and interior points. Several metrics give a dictionary by name.

    A frame that the recording cannot score is left out and counted. A frame that the prediction does not reach (NaN or
    infinity) makes the mean NaN: a roll-out that blew up has no score, not the score of its good beginning. Raises ValueError for an
    unknown name, a wrong shape, and a frame that is not there.
    """
    several = not isinstance(metric, str | Metric)
    found = [get_metric(one) if isinstance(one, str) else one for one in (metric if several else [metric])]
    if isinstance(prediction, np.ndarray):
        prediction = Positions.of(prediction, scenario)
    if frames is None:
        frames = scenario.split.test or range(1, scenario.frame_count)
    values = scores({one.name: one for one in found}, prediction, scenario, frames)
    return values if several else values[found[0].name]


def lacking(metric: Metric) -> str | None:
    """Why ``metric`` has no value for any recording here, or None. One that raises when it is asked has none."""
    try:
        return metric.unavailable()
    except Exception as error:
        return said(error)


def scores(
    metrics: Mapping[str, Metric],
    prediction: Prediction,
    scenario: Scenario,
    frames: Sequence[int],
    *,
    faults: dict[str, str] | None = None,
) -> dict[str, Score]:
    """Average each of ``metrics`` over ``frames``, as ``score`` does. Those that look at images go through the frames side by side, so that
    a prediction that keeps its last image makes each once for all of them.

    Where ``faults`` is given, a metric that raises has no value, and what it said is put there under its name; the others go on.
    """
    missing = {name: None if metric.images and scenario.images is None else lacking(metric) for name, metric in metrics.items()}
    values = {name: np.full(len(frames), np.nan) for name in metrics}
    finite = bool(np.isfinite(prediction.positions[np.asarray(frames, int)]).all())

    def fill(name, these):
        if not missing[name]:
            values[name][these] = metrics[name](prediction, scenario, frames[these])

    def average(name):
        return _average(metrics[name], values[name], missing[name], finite, prediction, scenario, frames)

    def guarded(work, name, *given):
        if faults is None:
            return work(name, *given)
        try:
            return work(name, *given)
        except Exception as error:
            values[name][:] = np.nan
            missing[name] = faults[name] = said(error)
            return average(name)

    for name in (name for name, metric in metrics.items() if not metric.images):
        guarded(fill, name, slice(None))
    for i in range(len(frames)):
        for name in (name for name, metric in metrics.items() if metric.images):
            guarded(fill, name, slice(i, i + 1))
    return {name: guarded(average, name) for name in metrics}


def _average(metric, values, missing, finite, prediction, scenario, frames) -> Score:
    scorable = ~np.isnan(values)
    mean = float(values[scorable].mean()) if finite and scorable.any() else float("nan")
    reason = missing or ("" if finite else "the prediction is not finite")
    if not (reason or scorable.all()):
        reason = metric.reason(prediction, scenario, frames[int(np.flatnonzero(~scorable)[0])])
    return Score(mean, len(values), int((~scorable).sum()), reason)


def _accept(metric: Metric, origin: Origin, known) -> Metric:
    if metric.name in COLUMNS or metric.name.endswith(("_unscorable", "_reason")):
        raise ValueError(f"its name must not be {metric.name!r}, which is a column of results")
    if metric.direction not in ("lower", "higher"):
        raise ValueError(f"direction must be 'lower' or 'higher', got {metric.direction!r}")
    if not (isinstance(metric.unit, str) and metric.unit == one_line(metric.unit)):
        raise ValueError(f"unit must be a string, '' for a ratio, got {metric.unit!r}")
    if type(metric.version) is not int or metric.version < 1:
        raise ValueError(f"version must be a whole number >= 1, got {metric.version!r}")
    for flag in ("images", "pooled"):
        if not isinstance(getattr(metric, flag), bool):
            raise ValueError(f"{flag} must be True or False, got {getattr(metric, flag)!r}")
    return metric


KIND = Kind("metric", "twinbench.metrics", ("metrics",), ("METRIC", "METRICS"), Metric, _accept, made=True)


def metrics() -> dict[str, Metric]:
    """Every metric by name, ours, then those of other packages; those of images come last."""
    return dict(sorted(discover(KIND).things.items(), key=lambda item: item[1].images))


def get_metric(name: str) -> Metric:
    """The metric called ``name``. An unknown name raises ValueError with the nearest known one."""
    known = metrics()
    if name not in known:
        raise unknown("metric", name, known)
    return known[name]
