"""The hands of a recording: which controllers are one hand, how it moves and turns, and which points of the body it holds."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...datasets.scenario import Observed
from .held import firmness_of

__all__ = ["Hand", "bar_of", "carry", "frames_of", "groups_of", "hands_of", "labels_of", "steadied"]

HAND = 0.05  # m, between neighbouring controllers of one hand, at all times
MOMENTS = 32  # frames in which that is looked up
STEADY = 0.2  # s
NARROW = 3e-3  # m, RMS: controllers within that of a line do not tell the turn about it
BAR, SLENDER = 0.1, 4.0  # a hand whose controllers are spread over that length [m], and over that many times their width, is a bar
BESIDE = 0.01  # m, between the places along it that hold the body
ROUNDS = 4  # of weights that trust single controllers less, the farther they are from the rigid motion of all
SOFT = 1.5  # spacings of the body's points, from a hand to where it holds half
FINGER = 0.02  # m: and at least that, for tracked points lie on the back of fingers, and what is held under them


@dataclass(frozen=True, eq=False)
class Hand:
    """A rigid group of controllers.

    controllers  (c,) indices of the recording's
    rotation     (T, 3, 3), how it has turned since frame 0, and ``centre`` (T, 3) m, the middle of its controllers: what it carries is at
                 centre[t] + rotation[t] @ (x - centre[0])
    points       (H,) structure points that it holds, and ``firmness`` (H,) how firmly, in (0, 1]
    turns        whether its turning is told by its controllers: all of it, all but about their line ("line"), or nothing ("point")
    notes        what was assumed, a sentence each
    """

    controllers: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    points: np.ndarray
    firmness: np.ndarray
    turns: str = "all"
    notes: tuple[str, ...] = ()

    def carried(self, points) -> np.ndarray:
        """(T, n, 3) m, where ``points`` (n, 3) of frame 0 would be were they carried along."""
        return carry(self.rotation, self.centre, points)


def carry(rotation, centre, points) -> np.ndarray:
    """(T, n, 3) m, where a rigid motion by ``rotation`` (T, 3, 3) since frame 0 about a ``centre`` (T, 3) m takes ``points`` (n, 3) m."""
    return np.einsum("tij,nj->tni", rotation, np.asarray(points) - centre[0]) + centre[:, None]


def hands_of(recording: Observed, *, radius: float | None = None) -> tuple[Hand, ...]:
    """The hands of a recording, and what each holds, from who moved with whom in the frames that were observed.

    radius [m] from a hand's controllers at which it holds a point half; 2 cm, or 1.5 spacings of the structure points where that is more,
    unless given.

    A driven marker holds its point, firmly, and no other. Raises ValueError for a hand that holds nothing though it came near the body.
    """
    if radius is not None and not (np.isfinite(radius) and radius > 0):
        raise ValueError(f"radius must be > 0 [m], got {radius}")
    radius = max(SOFT * recording.spacing, FINGER) if radius is None else radius
    return tuple(_hand(recording, k, members, radius) for k, members in enumerate(groups_of(recording.controllers)))


def groups_of(controllers) -> tuple[np.ndarray, ...]:
    """Indices of ``controllers`` (T, C, 3) [m], hand by hand; see ``labels_of``."""
    label = labels_of(controllers)
    groups = [np.flatnonzero(label == k) for k in np.unique(label)]
    return tuple(sorted(groups, key=lambda group: group[0]))


def labels_of(controllers) -> np.ndarray:
    """(C,) which hand each of ``controllers`` (T, C, 3) [m] is of: those that stay within ``HAND`` of each other, link by link."""
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial.distance import pdist

    frames, count = controllers.shape[:2]
    if count < 2:
        return np.ones(count, int)
    moments = np.unique(np.linspace(0, frames - 1, min(MOMENTS, frames)).astype(int))
    apart = np.max([pdist(controllers[t]) for t in moments], axis=0)
    return fcluster(linkage(apart), HAND, "distance")


def frames_of(points) -> tuple[np.ndarray, np.ndarray, str]:
    """(rotation (T, 3, 3) since frame 0, centre (T, 3) m, what tells the rotation) of one hand's ``points`` (T, c, 3) [m].

    Least squares (Kabsch 1976), with less weight for points that move against the others. Two points, or ones in a line, tell all but the
    turn about that line: there it is the least from frame to frame. One tells none.
    """
    home = points[0]
    weight = np.ones(len(home)) / len(home)
    spread = np.linalg.svd(home - home.mean(0), compute_uv=False) / np.sqrt(len(home))
    told = "all" if (spread > NARROW)[:2].sum() == 2 and len(home) > 2 else "line" if spread[0] > NARROW else "point"
    for _ in range(ROUNDS if len(home) > 3 else 1):
        centre = np.einsum("c,tcd->td", weight, points)
        rotation = _rotations(points - centre[:, None], weight, told)
        carried = carry(rotation, centre, home)
        stray = np.sqrt(np.mean(np.sum((points - carried) ** 2, axis=2), axis=0))
        scale = max(2 * float(np.median(stray)), 1e-6)
        weight = 1 / (1 + (stray / scale) ** 2)
        weight /= weight.sum()
    return rotation, centre, told


def bar_of(points) -> np.ndarray | None:
    """(k, 3) m, places along the middle line of a hand whose controllers ``points`` (c, 3) [m] are a bar, as of a hanger; None: they are
    not. An even spread over a length L has a deviation of L / sqrt(12).
    """
    middle = points.mean(0)
    _, spread, axes = np.linalg.svd(points - middle)
    length = spread[0] * np.sqrt(12 / len(points))
    if len(points) < 3 or length < BAR or spread[0] < SLENDER * spread[1]:
        return None
    along = (points - middle) @ axes[0]
    return middle + np.linspace(along.min(), along.max(), int(np.ceil(np.ptp(along) / BESIDE)) + 1)[:, None] * axes[0]


def steadied(rotation, fps: float) -> np.ndarray:
    """(T, 3, 3), ``rotation`` (T, 3, 3) since frame 0 without what jumps from frame to frame: a hand's few points tell it to a degree.

    A quadratic through ``STEADY`` seconds of entries (Savitzky and Golay 1964), made orthogonal again, since its own frame 0. On three
    development bodies, against the simulated hands: 1.00 degrees RMS become 0.77.
    """
    from scipy.signal import savgol_filter

    window = 2 * round(STEADY * fps / 2) + 1
    if window < 5 or len(rotation) < window:
        return rotation
    u, _, vt = np.linalg.svd(savgol_filter(rotation, window, 2, axis=0))
    turned = u @ (np.linalg.det(u @ vt)[:, None, None] ** np.array([0, 0, 1])[:, None] * vt)
    return turned @ turned[0].T


def _rotations(arms, weight, told):
    """(T, 3, 3) that take ``arms`` (T, c, 3) of frame 0 to those of each frame."""
    if told == "point":
        return np.broadcast_to(np.eye(3), (len(arms), 3, 3)).copy()
    if told == "line":
        return _least_turns(arms, weight)
    u, _, vt = np.linalg.svd(np.einsum("c,ci,tcj->tij", weight, arms[0], arms))
    vt[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
    return np.swapaxes(u @ vt, 1, 2)


def _least_turns(arms, weight):
    """The same where the arms lie in a line: the products of the least turns of it from frame to frame."""
    from scipy.spatial.transform import Rotation

    along = np.linalg.svd(np.sqrt(weight)[:, None] * arms[0])[2][0]
    line = np.einsum("c,c,tcd->td", weight, arms[0] @ along, arms)
    line /= np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-12)
    turned = [Rotation.identity()]
    for a, b in pairwise(line):
        axis = np.cross(a, b)
        sine = np.linalg.norm(axis)
        turned.append(Rotation.from_rotvec(axis / max(sine, 1e-12) * np.arctan2(sine, a @ b)) * turned[-1])
    return np.stack([turn.as_matrix() for turn in turned])


def _hand(recording, number, members, radius):
    rotation, centre, told = frames_of(recording.controllers[:, members])
    rotation = steadied(rotation, recording.fps)
    empty = np.zeros(0)
    hand = Hand(members, rotation, centre, empty.astype(int), empty, told)
    firmness, notes = firmness_of(recording, number, hand, radius)
    held = np.flatnonzero(firmness)
    if told == "point":
        notes += ("its controllers do not tell how it turns; it is taken not to turn",)
    if told == "line":
        notes += ("its controllers do not tell how it turns about their line; it is taken to turn least",)
    return Hand(members, rotation, centre, held, firmness[held], told, notes)
