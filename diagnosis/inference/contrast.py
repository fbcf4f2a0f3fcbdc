"""Recordings of one command, of which all but the first are known to be sound: how far the first differs, beyond what twins say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Scenario
from .blocks import Blocks

__all__ = ["Contrast", "as_long", "check_hands", "comparable", "inputs_apart", "until"]

HANDS = 0.005  # m, root mean square over frames: what a robot repeats, and what a tracker of hands sees differently
BEGINS = 0.01  # m between the middles of the body in frame 0


@dataclass(frozen=True, eq=False)
class Contrast:
    """matrix (B, A): block means of the first recording less the mean of the others' of the same place and time, of A block means of all.

    rows (B,) which of the A are the first recording's; ``others`` (B, S) those of S sound recordings; ``bins`` (B,) the bins of time
    sites (B,) which values are of one place and component; ``repeat`` m, by how much recordings of one command differ, all the time and
    from bin to bin
    """

    matrix: np.ndarray
    rows: np.ndarray
    others: np.ndarray
    bins: np.ndarray
    sites: np.ndarray
    repeat: float = 0.0

    @classmethod
    def of(cls, blocks: Sequence[Blocks], repeat: float = 0.0) -> Contrast:
        """Raises ValueError where no place and time is seen in all of them."""
        first, *sound = blocks
        common = [c for c in first.cells if all(c in one.cells for one in sound)]
        if not common:
            raise ValueError("recordings that are compared must show the same parts of the body at the same time, got none in common")
        starts = np.r_[0, np.cumsum([3 * len(one.cells) for one in blocks])]
        places = [
            np.array([start + 3 * np.flatnonzero(one.cells == c)[0] for c in common]) for start, one in zip(starts, blocks, strict=False)
        ]
        rows, *others = [(at[:, None] + np.arange(3)).ravel() for at in places]
        matrix, each = np.zeros((len(rows), starts[-1])), np.arange(len(rows))
        matrix[each, rows] = 1.0
        for one in others:
            matrix[each, one] = -1 / len(others)
        at = np.repeat(np.array(common), 3)
        sites = 3 * (at % first.count) + np.tile(np.arange(3), len(common))
        return cls(matrix, rows, np.stack(others, 1), at // first.count, sites, repeat)

    @property
    def set_up(self) -> np.ndarray:
        """(B, k) m, what k independent numbers add to how far recordings of one command differ: two sound recordings tell it, one does not.

        Each site is off all the time, and each of the B values by itself.
        """
        if self.others.shape[1] > 1 or not self.repeat:
            return np.zeros((len(self.rows), 0))
        return self.repeat * np.c_[self.sites[:, None] == np.unique(self.sites), np.eye(len(self.rows))].astype(float)

    def repeats(self, off, variance) -> np.ndarray:
        """(B,) m^2: what the mean of S sound recordings and one more differ by beyond noise, from how far the sound ones differ.

        off, variance (A,) m, m^2 of what twins miss and of its noise. One sound recording says nothing of it: zeros.
        """
        count = self.others.shape[1]
        if count < 2:
            return np.zeros(len(self.rows))
        spread = np.var(off[self.others], axis=1, ddof=1) - variance[self.others].mean(1)
        mean = np.array([spread[self.bins == b].mean() for b in self.bins])
        return np.maximum(0.0, mean) * (1 + 1 / count)


def comparable(case: Scenario, sound: Scenario) -> Scenario:
    """``sound`` in the frames of ``case``, whose command it had.

    Raises ValueError where frame rate, hands, further inputs, the body's place in frame 0 or the length say that it was another one.
    """
    where = f" (scenario {sound.name})"
    if sound.fps != case.fps:
        raise ValueError(f"recordings that are compared must have one frame rate, got {case.fps:g} and {sound.fps:g}{where}")
    sound = as_long(sound, case)
    if sound.controllers.shape[1] != case.controllers.shape[1]:
        hands = f"{case.controllers.shape[1]} and {sound.controllers.shape[1]}"
        raise ValueError(f"recordings that are compared must have the same controllers, got {hands}{where}")
    if case.controllers.shape[1]:
        check_hands(case, sound)
    if (differ := _inputs_differ(case.actuation, sound.actuation)) is not None:
        raise ValueError(f"further inputs must be those of the recording they are compared with, got {differ}{where}")
    middles = [one.points[0][one.visible[0]].mean(0) for one in (case, sound)]
    if (far := float(np.linalg.norm(middles[1] - middles[0]))) > BEGINS:
        raise ValueError(f"bodies must begin within {1e3 * BEGINS:g} mm of each other, got {1e3 * far:.1f} mm{where}")
    return sound


def check_hands(case: Scenario, sound: Scenario) -> None:
    """Raises ValueError where hands, of which both have as many for as long, go otherwise."""
    apart = float(np.sqrt(((sound.controllers - case.controllers) ** 2).sum(-1).mean()))
    if apart > HANDS:
        told = f"{1e3 * HANDS:g} mm of those they are compared with, got {1e3 * apart:.1f} mm (scenario {sound.name})"
        raise ValueError(f"hands must be within {told}")


def inputs_apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(A,) RMS by which inputs (T, A) differ, over the standard deviation of the ``other``."""
    return np.sqrt(((one - other) ** 2).mean(0)) / np.maximum(other.std(0), 1e-12)


def _inputs_differ(one, other) -> str | None:
    """How far further inputs differ, in words; None where they do not."""
    if one is None or other is None or one.shape != other.shape:
        told = ["none" if a is None else f"{a.shape}" for a in (one, other)]
        return None if one is None and other is None else f"{told[0]} and {told[1]}"
    if np.allclose(one, other):
        return None
    share = inputs_apart(one, other)
    return f"input {int(share.argmax())} that differs by {share.max():.2g} of how far it varies"


def until(case: Scenario, sound: Sequence[Scenario]) -> Scenario:
    """The first frames of ``case``, as many as the shortest of ``sound`` has too; the same share of them may be fitted."""
    count = min(one.frame_count for one in (case, *sound))
    return case if count == case.frame_count else case.shortened(count, round(case.split.train_end * count / case.frame_count))


def as_long(sound: Scenario, case: Scenario) -> Scenario:
    """The first frames of ``sound``, as many as ``case`` has, with its split.

    Raises ValueError where it is shorter.
    """
    count = case.frame_count
    if sound.frame_count < count:
        raise ValueError(
            f"a sound recording must be as long as the one that it is compared with, {count} frames, got {sound.frame_count} "
            f"(scenario {sound.name})"
        )
    return sound.shortened(count, case.split.train_end)
