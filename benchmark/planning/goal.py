"""Where a body is wanted: a place for its points, or a cloud."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Observed

__all__ = ["Goal"]


@dataclass(frozen=True, eq=False)
class Goal:
    """``points`` (N, 3) m of a body as they start; ``targets`` (N, 3) m where each is wanted, NaN where that is not said, or None;
    ``cloud`` (K, 3) m, the shape that is wanted. Made of a start as it was observed, of nothing else.
    """

    task: str
    points: np.ndarray
    targets: np.ndarray | None
    cloud: np.ndarray

    @classmethod
    def of(cls, task: str, start: Observed, wanted: Callable[[np.ndarray], np.ndarray]) -> Goal:
        """``wanted`` says of points (n, 3) of the body in frame 0 where they should go, NaN where it does not matter."""
        seen, whole = start.points[0][start.visible[0]], start.structure[: start.counts[0] + start.counts[1]]
        whole = whole[start.known[: len(whole)]]
        targets, cloud = wanted(seen), wanted(whole)
        return cls(task, seen, targets, cloud[np.isfinite(cloud).all(1)])

    @property
    def asked(self) -> np.ndarray:
        """(N,) bool, which points are asked for: all of them where only a cloud is wanted."""
        return np.ones(len(self.points), bool) if self.targets is None else np.asarray(np.isfinite(self.targets).all(1))
