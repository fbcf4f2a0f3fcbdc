"""How a recording starts: whether its body is at rest in frame 0, and how fast its points move there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Observed

__all__ = ["Speeds", "Start", "seen_velocity", "start_velocity", "starts_at_rest"]

FIRST = 3  # frames that tell whether the first is a rest
SLOW = 0.02  # m/s: slower is rest whatever the noise; it is 0.7 mm a frame at 30 frames a second
SURE = 3.0  # standard errors by which a motion must stand out
SHARE = 0.5  # of the next frame's speed, below which a body has only just set off: from rest at a constant pull it has a third of it
ROUNDS = 5  # of weights that trust single tracks less, the farther they are from the field
WIDE = 4.0  # median strays at which a track counts half
FEWEST = 12  # tracks that tell an affine field; fewer tell a rigid one, and fewer than 4 a translation


@dataclass(frozen=True)
class Start:
    """Whether frame 0 is a rest, and ``still``: an equilibrium. Where nothing says so it is taken for both.

    speed  m/s, RMS over the tracks between frames 0 and 1, and its standard error; later, m/s, the same between frames 1 and 2
    """

    rest: bool
    speed: float
    error: float
    later: float
    words: str
    still: bool = True


@dataclass(frozen=True, eq=False)
class Speeds:
    """What is known of how fast a body moves in frame 0.

    places    (n, 3) m in frame 0, ``velocity`` (n, 3) m/s there, ``weight`` (n,) how far each is trusted
    noise     m/s, of a coordinate of the velocity
    """

    places: np.ndarray
    velocity: np.ndarray
    weight: np.ndarray
    noise: float = 0.0

    @classmethod
    def of(cls, places, velocity) -> Speeds:
        """All of them trusted alike."""
        return cls(places, velocity, np.ones(len(places)))


def starts_at_rest(recording: Observed) -> Start:
    """Whether nothing moves in frame 0: nothing moves from there to frame 1 either, or at most half as fast as one frame later.

    The latter is a body that sets off in frame 0, as its hand does or because it is let go: frame 0 is an equilibrium unless it goes
    farther in the first frames than any hand does. The tracks' velocities are averaged as an
    affine field, so that noise hardly enters. Fewer than three frames say nothing: they are taken for a rest.
    """
    if not recording.correspond:
        return Start(True, 0.0, float("inf"), 0.0, "clouds, whose points do not correspond, say nothing; rest is assumed")
    if recording.observed_frames < FIRST:
        return Start(True, 0.0, float("inf"), 0.0, f"fewer than {FIRST} frames were observed and say nothing; rest is assumed")
    seen = _seen_first(recording)
    if not seen.any():
        return Start(True, 0.0, float("inf"), 0.0, f"no track was seen in all of the first {FIRST} frames; rest is assumed")
    home = recording.points[0, seen]
    steps = np.diff(recording.points[:FIRST, seen], axis=0) * recording.fps
    now, after = (_field(home, step, home, rounds=1) for step in steps)
    error = _noise(recording.points[:, seen], recording.visible[:, seen]) * recording.fps * np.sqrt(2 * _columns(len(home)) / len(home))
    speed, later = _rms(now), _rms(after)
    led = np.linalg.norm(recording.controllers[FIRST - 1] - recording.controllers[0], axis=1).max(initial=0.0)
    still = _rms(now + after) < max(SLOW * (FIRST - 1), SURE * error, led * recording.fps)
    rest = speed < max(SLOW, SURE * error, SHARE * later)
    words = (
        f"{int(seen.sum())} tracks move at {1e3 * speed:.1f} +- {1e3 * error:.1f} mm/s from frame 0 to 1 and at {1e3 * later:.1f} mm/s "
        f"from frame 1 to 2"
    )
    return Start(bool(rest), speed, error, later, words, bool(still))


def _seen_first(recording: Observed) -> np.ndarray:
    """(N,) bool, the tracks that were seen in all of the first frames, those that nobody drives if there are any."""
    seen = np.asarray(recording.visible[:FIRST].all(0))
    free = seen & ~np.isin(np.arange(len(seen)), recording.grips)
    return free if free.any() else seen


def start_velocity(recording: Observed) -> np.ndarray:
    """(M, 3) m/s, a smooth velocity of the structure points, from what the tracks do between the first two frames.

    The difference of frames 0 and 1 over their time, which is the velocity between them, fitted by an affine field v = a + B x with less
    weight for tracks that do something else. Of few tracks a rigid field a + w x x (fewer than 12) or a translation (fewer than 4).
    Raises ValueError where fewer than two frames were observed, or no track in both.
    """
    seen = _seen_twice(recording)
    first, second = recording.points[0, seen], recording.points[1, seen]
    return _field(first, (second - first) * recording.fps, recording.structure)


def seen_velocity(recording: Observed) -> Speeds:
    """What tracks that nobody drives do between the first two frames.

    Weights are those of ``start_velocity``, 1 where a dozen tracks or fewer were seen. The noise is told by the jitter of all frames; where
    there are fewer than five, by what the tracks are off that field, and so few tracks count as exact. Raises ValueError as it does.
    """
    seen = _seen_twice(recording)
    free = seen & ~np.isin(np.arange(len(seen)), recording.grips)
    seen = free if free.any() else seen
    first, second = recording.points[0, seen], recording.points[1, seen]
    velocity, count = (second - first) * recording.fps, int(seen.sum())
    weight, off = np.ones(count), 0.0
    if count > FEWEST:
        field, weight = _fitted(first, velocity, ROUNDS)
        off = np.sqrt(np.average(((velocity - field(first)) ** 2).mean(1), weights=weight) * count / (count - FEWEST / 3))
    if recording.observed_frames > FIRST + 1:
        off = np.sqrt(2) * recording.fps * _noise(recording.points[:, seen], recording.visible[:, seen])
    return Speeds(first, velocity, weight, float(off))


def _seen_twice(recording):
    """(N,) bool, the tracks that were seen in frames 0 and 1."""
    if not recording.correspond:
        raise ValueError(f"a start velocity needs points that correspond from frame to frame, got clouds (scenario {recording.name})")
    if recording.observed_frames < 2:
        raise ValueError(f"a start velocity needs two observed frames, got {recording.observed_frames} (scenario {recording.name})")
    seen = np.asarray(recording.visible[:2].all(0))
    if not seen.any():
        raise ValueError(f"a start velocity needs a track that was seen in frames 0 and 1, got none (scenario {recording.name})")
    return seen


def _rms(vectors):
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _noise(points, visible):
    """White noise [m] of a coordinate of ``points`` (F, n, 3), from third differences: a smooth motion leaves only noise in them.

    Their variance is 1 + 9 + 9 + 1 = 20 times its own. The median of the tracks' medians, so that fast motion hardly counts as noise.
    """
    third = np.diff(np.where(visible[..., None], points, np.nan), 3, axis=0)
    size = np.sort(np.abs(third), axis=0)  # what is NaN comes last
    known = np.isfinite(size).sum(0)
    middle = np.take_along_axis(size, np.maximum(known // 2, 0)[None], axis=0)[0][known > 3] if len(size) else np.zeros(0)
    return float(np.median(middle) / 0.6745 / np.sqrt(20)) if len(middle) else 0.0


def _field(points, velocity, at, *, rounds=ROUNDS):
    """(K, 3) the smooth field of ``velocity`` (n, 3) at ``points`` (n, 3), where ``at`` (K, 3) is."""
    field, _ = _fitted(points, velocity, rounds)
    return field(at)


def _fitted(points, velocity, rounds):
    """(the smooth field of ``velocity`` (n, 3) at ``points`` (n, 3) as a function of places (K, 3), (n,) how far each is trusted)."""
    middle = points.mean(0)
    size = max(float(np.sqrt(np.mean(np.sum((points - middle) ** 2, axis=1)))), 1e-9)
    columns = _columns(len(points))
    basis, wanted = _basis((points - middle) / size, columns), velocity.reshape(-1)
    weight = np.ones(len(points))
    for _ in range(rounds):
        root = np.repeat(np.sqrt(weight), 3)
        solution = np.linalg.lstsq(basis * root[:, None], wanted * root, rcond=1e-6)[0]
        stray = np.linalg.norm((wanted - basis @ solution).reshape(-1, 3), axis=1)
        weight = 1 / (1 + (stray / max(WIDE * np.median(stray), 1e-9)) ** 2)
    return lambda at: (_basis((at - middle) / size, columns) @ solution).reshape(-1, 3), weight


def _columns(count):
    """Numbers of the field that so many tracks tell."""
    return 3 if count < 4 else 6 if count < FEWEST else 12


def _basis(x, columns):
    """(3 n, columns): a translation, turns, and stretches and shears, of points ``x`` (n, 3)."""
    fields = [np.broadcast_to(e, x.shape) for e in np.eye(3)]
    fields += [np.cross(e, x) for e in np.eye(3)]
    strains = [np.diag(e) for e in np.eye(3)] + [
        np.outer(a, b) + np.outer(b, a) for a, b in zip(np.eye(3), np.eye(3)[[1, 2, 0]], strict=True)
    ]
    fields += [x @ strain for strain in strains]
    return np.stack([f.reshape(-1) for f in fields[:columns]], axis=1)
