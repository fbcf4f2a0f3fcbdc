"""Whether cameras are turned against hands, told by what hands hold: it moves as they do, but for a turn of all that cameras see.

What is seen of a track that a hand carries by d is turned by w: d + w x d, to first order, beside what it lags by, as of a hand that is
reported late. Cameras that are wrong are moved as well, so that what a hand holds need not be seen beside it: of the tracks around, those
count that go with the hand best, all by the same turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..datasets.scenario import Observed
from .carried import FEWEST, beside

__all__ = ["Turn", "cameras_rather", "turn_of"]

NEAR, MOST = 0.09, 60  # m around a hand's points in frame 0, and tracks there, the nearest ones
HELD = 4  # one track in so many goes with the hand
SEEN = 6  # frames in which a track must be seen there
ALIKE = 8  # frames in a row and tracks side by side that err as one
USUAL = np.radians(4.0)  # deviation of a turn of cameras that are wrong
ROUNDS = 12
ALL = 0.5  # of wrong cameras are so all alike
# mean and deviation of how clear a turn is: of 110 sound ropes, blocks and cloths, -0.42 at most, and of the same whose tracks were turned
# by 1, 2 and 4 degrees and moved by 1 cm for each
SOUND, WRONG = (-1.65, 0.63), (0.63, 0.78)


@dataclass(frozen=True, eq=False)
class Turn:
    """by (3,) rad, how what is seen is turned; ``clear``: log of how much that moves what a hand holds over what is left, both RMS."""

    by: np.ndarray
    clear: float


def turn_of(recording: Observed) -> Turn | None:
    """By the hand that tells it most clearly; None where no hand's points tell how it moves and turns, or too few tracks are around."""
    found = (_turn(one.carried, one.gone) for one in beside(recording, NEAR, MOST))
    return max((one for one in found if one), key=lambda one: one.clear, default=None)


def _turn(carried, gone) -> Turn | None:
    """Of tracks that a hand would have ``carried`` (T, n, 3) [m], and that are ``gone`` [m], NaN where that says nothing."""
    told, pace = np.isfinite(gone).all(2), np.gradient(carried, axis=0)
    kept = told.sum(0) >= SEEN
    if kept.sum() < FEWEST:
        return None
    carried, gone, pace, told = carried[:, kept], gone[:, kept], pace[:, kept], told[:, kept]
    strays = np.where(told[..., None], gone - carried, 0.0)
    ways = np.zeros((*carried.shape, 4))  # what a turn about each axis does, and a lag of a frame
    ways[..., :3] = np.cross(np.eye(3)[:, None, None], carried[None]).transpose(1, 2, 3, 0)
    ways[..., 3] = pace
    ways[~told] = 0.0
    squares, along = np.einsum("tnij,tnik->njk", ways, ways), np.einsum("tnij,tni->nj", ways, strays)
    whole, count = np.sum(strays**2, (0, 2)), told.sum(0)
    most, prior = max(FEWEST - 1, len(count) // HELD), np.diag([USUAL**-2] * 3 + [1e-9])
    sizes = np.zeros(4)
    for _ in range(ROUNDS):
        left = np.maximum(whole - 2 * along @ sizes + np.einsum("j,njk,k->n", sizes, squares, sizes), 0.0) / count
        held = np.argsort(left)[:most]
        square = float(np.mean(left[held])) + 1e-12
        precision, pull = squares[held].sum(0) / (ALIKE * square), along[held].sum(0) / (ALIKE * square)
        sizes = np.linalg.solve(precision + prior, pull)
    moved = np.einsum("j,njk,k->n", sizes[:3], squares[held][:, :3, :3], sizes[:3]) / count[held]
    return Turn(sizes[:3], float(0.5 * np.log((np.mean(moved) + 1e-12) / square)))


def cameras_rather(recordings: Sequence[Observed]) -> float:
    """Logarithm of how much likelier what is seen beside hands is if cameras are wrong than if the ground is; 0 where no hand tells.

    Where one camera of several is wrong, hands that others see say nothing of it: that nothing is turned speaks for the ground a little.
    """
    from scipy.stats import norm

    turns = [turn.clear for turn in map(turn_of, recordings) if turn]
    every = sum(float(norm.logpdf(clear, *WRONG) - norm.logpdf(min(clear, WRONG[0]), *SOUND)) for clear in turns)
    return float(np.logaddexp(np.log(ALL) + every, np.log(1 - ALL))) if turns else 0.0
