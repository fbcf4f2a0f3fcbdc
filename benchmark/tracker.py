"""What the tracker says, as a yardstick for twins: PhysTwin's supplement compares its track error with that of its own training tracks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..methods.base import Method, Trajectory, Twin

__all__ = ["Tracker"]

OWN_RECORDING = "a tracker knows the recording that it tracked, and no other"


@dataclass(frozen=True)
class Tracked(Twin):
    """``positions`` (T, N, 3) m: the tracked points of a whole recording."""

    positions: np.ndarray

    def rollout(self, controllers):
        return Trajectory(self.positions, (self.positions.shape[1], 0, 0))

    def retarget(self, target):
        """Raises ValueError: there is no such thing."""
        raise ValueError(OWN_RECORDING)

    def save(self, folder):
        Path(folder).mkdir(parents=True, exist_ok=True)
        np.savez_compressed(Path(folder) / "twin.npz", positions=self.positions)

    @classmethod
    def load(cls, folder):
        with np.load(Path(folder) / "twin.npz", allow_pickle=False) as arrays:
            return cls(arrays["positions"])


class Tracker(Method):
    """The recording's own tracked points, test frames too: no twin and no competitor, for it has seen what it is scored on.

    A point that is not seen stays where it was seen last. These are the tracks that twins are fitted to (pseudo-labels), lifted from a 2D
    tracker and filtered; annotated tracks are matched with them in frame 0, as with a twin's particles.
    """

    name = "tracker"
    whole = True
    twin_class = Tracked
    skip_transfer = OWN_RECORDING

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        one = observed[0]
        frames = np.arange(one.observed_frames)[:, None]
        last = np.maximum.accumulate(np.where(one.visible, frames, 0), axis=0)  # frame 0 is finite, seen or not
        return Tracked(np.take_along_axis(one.points, last[..., None], axis=0).astype(np.float32))
