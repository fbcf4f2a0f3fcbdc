"""The one interface that every method implements, and the trajectory that every twin returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..datasets.scenario import Observed, Scenario

__all__ = ["Budget", "Diverged", "Method", "Trajectory", "Twin", "spread_evenly"]


class Diverged(RuntimeError):
    """A simulation blew up: ``frame`` is the first frame with a non-finite or absurdly far particle."""

    def __init__(self, message: str, frame: int):
        super().__init__(message)
        self.frame = frame


@dataclass(frozen=True)
class Trajectory:
    """Positions (T, M, 3) float32 in metres, particles in the order tracked | surface | interior; ``counts`` says how many of each."""

    positions: np.ndarray
    counts: tuple[int, int, int]

    def __post_init__(self):
        shape = np.shape(self.positions)
        if len(shape) != 3 or shape[1:] != (sum(self.counts), 3):
            raise ValueError(f"positions must have shape (frames, {sum(self.counts)}, 3), got {shape}")

    @property
    def tracked(self) -> np.ndarray:
        """(T, N, 3) the tracked points."""
        return self.positions[:, : self.counts[0]]

    @property
    def surface(self) -> np.ndarray:
        """(T, N+S, 3) everything on the surface: tracked and surface particles."""
        return self.positions[:, : self.counts[0] + self.counts[1]]


@dataclass(frozen=True)
class Budget:
    """How much work a fit may do. Each method states in its own ``presets`` what a preset means for it."""

    preset: str = "quick"

    def __post_init__(self):
        if self.preset not in ("quick", "full"):
            raise ValueError(f"preset must be 'quick' or 'full', got {self.preset!r}")


class Twin(ABC):
    """A fitted, simulable object, placed in frame 0 of one recording. ``note`` is what a table says of it, if anything.

    ``looks_ahead`` is True where a frame may depend on what the controllers do after it, as where frames between steps are interpolated.
    """

    note = ""
    looks_ahead = False

    @abstractmethod
    def rollout(self, controllers: np.ndarray) -> Trajectory:
        """Simulate from frame 0 while the controllers follow ``controllers`` (T, C, 3) metres. Raises Diverged."""

    def rollouts(self, controllers: np.ndarray) -> list[Trajectory | Diverged]:
        """A roll-out for each of ``controllers`` (B, T, C, 3) metres, or the ``Diverged`` that it raised.

        A twin that can step them together does so in a method of its own, to the same numbers.
        """
        found: list[Trajectory | Diverged] = []
        for path in controllers:
            try:
                found.append(self.rollout(path))
            except Diverged as error:
                found.append(error)
        return found

    @abstractmethod
    def retarget(self, target: Observed) -> Twin:
        """The same object placed in frame 0 of another recording.

        May look at ``target``'s frame 0 and controllers only; where exactly two frames are given (``Scenario.start_frames``), at frame 1
        too, for the velocity at the start.
        """

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write the twin as npz and json files into ``folder`` (no pickle)."""

    @classmethod
    @abstractmethod
    def load(cls, folder: Path) -> Twin:
        """The twin that ``save`` wrote."""


def spread_evenly(recordings: Sequence, most: int | None) -> list:
    """At most so many of ``recordings`` (None: all), evenly spread from the first to the last."""
    most = len(recordings) if most is None else min(most, len(recordings))
    return [recordings[k] for k in np.unique(np.linspace(0, len(recordings) - 1, most).astype(int))]


class Method(ABC):
    """A way of making a twin from recordings. One file, one class, one name.

    ``twin_class`` is the class of what ``fit`` returns, by which saved twins are loaded; a property where it is imported late.

    Where ``builds_on`` names another method, ``fit`` takes a further option ``start``: that method's twin of the same recordings with the
    same budget, seed and device, or None where the caller has none, which ``fit`` then makes itself.

    ``reads_images`` names the kinds of images (color, depth, mask, human_mask) that ``fit`` looks at, those of the method it builds on
    included. A twin is remembered by what it was fitted on, and images that nobody looks at are not read for that.

    ``appearance`` says what its roll-outs are shown with: "corrected", "as-published", or some switches of the published appearance
    (``appearance.config.quirks_named``).
    """

    name: str
    twin_class: type[Twin]
    builds_on: str | None = None
    reads_images: tuple[str, ...] = ()
    appearance: str = "corrected"
    skip_transfer: str | None = None  # why no twin of this method can be placed in another recording; its transfer rows say so

    @abstractmethod
    def fit(
        self,
        observed: Sequence[Observed],
        *,
        budget: Budget,
        seed: int = 0,
        device: str = "cpu",
        progress: Callable[[str, float], None] | None = None,
    ) -> Twin:
        """Fit one twin on one or several recordings of one object; it comes back placed in the first.

        ``progress(stage, fraction)`` may be called as work goes on. Deterministic for a seed on one device.
        """

    def skip(self, scenario: Scenario | Observed) -> str | None:
        """Why this method cannot run on ``scenario``, or None."""
        return None

    def skip_jointly(self, scenarios: Sequence[Scenario]) -> str | None:
        """Why no twin can be fitted on all of these recordings of one object at once, each of which it can run on; or None."""
        return None
