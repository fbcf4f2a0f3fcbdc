"""What hands could do next with a body: a library of motions for the grips that it is in, each said in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..datasets.scenario import Observed

__all__ = ["TELLING", "VISIBLE", "Motion", "Setting", "figures", "motions", "outcome_words"]

HIGH = 0.9  # of the body's extent above the table: then it hangs free
RISE = 0.6  # m/s, of lifting
LYING = 0.02  # m: hands that need not rise by more do not lift
WIDE = (0.05, 0.2)  # m, between which swings reach to either side
FAST, SLOW = 0.35, 0.9  # s from one side of a swing to the other
TELLING = 3.0  # least D of a motion that is worth the while: two readings are told apart in 93 of 100 recordings (D / 2 deviations)
VISIBLE = 0.005  # m: what eyes can tell
STILL = 0.6  # s of rest at the end


@dataclass(frozen=True)
class Setting:
    """The hands that hold a body, and the room around.

    start    (C, 3) m, hand points in frame 0; hand (C,) which hand each belongs to; centre (H, 3) m, the two farthest apart first
    up       away from gravity; line: along the held edge, level; face: level and across it, as a sheet that hangs there faces
    reach    m, the body's extent
    lift     m, by which hands must rise until it hangs free of the table
    table    whether there is one
    """

    start: np.ndarray
    hand: np.ndarray
    centre: np.ndarray
    up: np.ndarray
    line: np.ndarray
    face: np.ndarray
    reach: float
    lift: float
    table: bool
    fps: float

    @classmethod
    def of(cls, recording: Observed, nodes: np.ndarray, hand: np.ndarray) -> Setting:
        """Of a recording, points (n, 3) m of its body in frame 0, and which ``hand`` (C,) each controller belongs to.

        Raises ValueError where nobody holds the body.
        """
        start = recording.controllers[0]
        if not len(start):
            raise ValueError(f"{recording.name}: nobody holds the body, so that no motion can be planned")
        hand = _farthest_first(start, hand)
        centre = np.stack([start[hand == h].mean(0) for h in range(hand.max() + 1)])
        gravity = np.asarray(recording.gravity, float)
        up = -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])
        reach = float(np.linalg.norm(np.ptp(nodes, axis=0)))
        line = _level(centre[1] - centre[0], up) if len(centre) > 1 else np.cross(up, _level(nodes.mean(0) - centre[0], up))
        height = np.inf if recording.ground is None else float(recording.ground.height(centre).min())
        lift = max(0.0, HIGH * reach - height)
        return cls(start, hand, centre, up, line, np.cross(up, line), reach, lift, recording.ground is not None, recording.fps)

    @property
    def wide(self) -> float:
        return float(np.clip(0.35 * self.reach, *WIDE))

    @property
    def span(self) -> float:
        """m, between the first two hands."""
        return float(np.linalg.norm(self.centre[1] - self.centre[0])) if len(self.centre) > 1 else 0.0

    def path(self, times, moves, turns=None, *, abrupt: bool = False) -> np.ndarray:
        """(T, C, 3) hand points [m] that at ``times`` [s] are ``moves`` (K, H, 3) or (K, 3) [m] from the start, turned by ``turns`` [rad].

        They pass them smoothly (with the least jerk, at rest in each), or ``abrupt``: at even speed; and rest for a while at the end.
        """
        from scipy.spatial.transform import Rotation

        hands = len(self.centre)
        times = np.append(times, times[-1] + STILL)
        keys = []
        for given in (moves, np.zeros((len(moves), 3)) if turns is None else turns):
            given = np.asarray(given, float)
            given = np.repeat(given[:, None], hands, 1) if given.ndim == 2 else given
            keys.append(np.concatenate([given, given[-1:]]))
        t = np.arange(int(np.ceil(times[-1] * self.fps)) + 1) / self.fps
        k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        s = np.clip((t - times[k]) / np.diff(times)[k], 0, 1)
        s = (s if abrupt else s**3 * (10 - 15 * s + 6 * s * s))[:, None, None]
        move, turn = ((1 - s) * key[k] + s * key[k + 1] for key in keys)
        arm = self.start - self.centre[self.hand]
        out = np.empty((len(t), len(self.start), 3))
        for h in range(hands):
            mine = self.hand == h
            turned = np.einsum("tij,cj->tci", Rotation.from_rotvec(turn[:, h]).as_matrix(), arm[mine])
            out[:, mine] = self.centre[h] + move[:, h][:, None] + turned
        return out

    def lifted(self, times, moves, turns=None, **options) -> np.ndarray:
        """A path that begins with lifting the body off the table."""
        times, moves = np.asarray(times, float), np.asarray(moves, float)
        if self.lift <= LYING:
            return self.path(times, moves, turns, **options)
        rise = max(0.4, self.lift / RISE)
        moves = np.concatenate([np.zeros_like(moves[:1]), moves + self.lift * self.up])
        turns = None if turns is None else np.concatenate([np.zeros_like(turns[:1]), turns])
        return self.path(np.append(0.0, times + rise), moves, turns, **options)


@dataclass(frozen=True)
class Motion:
    """A motion by name, what to do in words, and the hand points' path (T, C, 3) [m]."""

    name: str
    says: str
    controllers: np.ndarray


def motions(setting: Setting) -> list[Motion]:
    """All motions that the hands can make here."""
    found = []
    for name, make in LIBRARY.items():
        made = make(setting)
        if made is not None:
            says, path = made
            lifts = setting.lift > LYING and make not in ON_THE_TABLE
            found.append(Motion(name, f"lift it by {_cm(setting.lift)}, then {says}" if lifts else says, path))
    return found


def _farthest_first(start, label):
    """(C,) hands numbered anew, the two farthest apart first."""
    from scipy.spatial.distance import cdist

    label = np.unique(label, return_inverse=True)[1]
    centre = np.stack([start[label == h].mean(0) for h in range(label.max() + 1)])
    apart = cdist(centre, centre)
    first = np.unravel_index(int(apart.argmax()), apart.shape)
    order = list(dict.fromkeys([*sorted(int(h) for h in first), *range(len(centre))]))
    return np.argsort(order)[label]


def outcome_words(readings, motion: Motion, at: str, seconds: float, axis: np.ndarray, up: np.ndarray, offsets, within: float) -> str:
    """What to do, where to look, and what each outcome means of two ``readings`` with a ``name`` and a clause that each ``says``.

    at  in words, a place that either puts ``offsets`` [m] from a hand along ``axis`` (3,), give or take ``within``, after ``seconds``
    """
    a, b = readings
    upright = np.array_equal(axis, up)
    first, second, border = (_place_words(value, axis, upright) for value in (*offsets, sum(offsets) / 2))
    return (
        f"To tell {a.name} from {b.name}: {motion.says}. Then look at {at}, {seconds:.1f} s after the start: "
        f"if {a.says}, it is {first} the hand; if {b.says}, {second} it, give or take {1000 * within:.0f} mm. The border is {border} it."
    )


def figures(motion: Motion, separation: float, others: dict[str, float], fps: float) -> dict:
    """What ``diagnosis.json`` keeps of a plan: the motion and its seconds, D of it and of the others that were looked into."""
    shown = {name: round(d, 2) for name, d in sorted(others.items(), key=lambda item: -item[1])}
    seconds = round(len(motion.controllers) / fps, 2)
    return {"motion": motion.name, "seconds": seconds, "separation": round(separation, 2), "others": shown}


def _place_words(metres: float, axis: np.ndarray, upright: bool) -> str:
    """How far something is from a hand, along ``axis`` (3,), which points up if ``upright``."""
    if upright:
        return f"{1000 * abs(metres):.0f} mm {'above' if metres > 0 else 'below'}"
    way = ", ".join(f"{c:.2f}" for c in np.sign(metres or 1.0) * axis + 0.0)
    return f"{1000 * abs(metres):.0f} mm towards ({way}) from"


def _level(way, up):
    """The level part of ``way`` as a unit vector; any level one where it has none."""
    flat = way - (way @ up) * up
    if np.linalg.norm(flat) < 1e-6:
        flat = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    return flat / np.linalg.norm(flat)


def _cm(metres):
    return f"{100 * metres:.0f} cm"


def _hold(s):
    return "hold it still for two seconds", s.lifted([0.0, 1.4], np.zeros((2, 3)))


def _swing(way, words, seconds):
    def make(s):
        side = s.wide * getattr(s, way)
        times = seconds * np.array([0, 0.7, 1.7, 2.7, 3.7])
        says = f"swing it to and fro {words}, {_cm(2 * s.wide)} in {seconds:.2g} s each way, and stop"
        return says, s.lifted(times, np.array([0, 1, -1, 1, -1])[:, None] * side)

    return make


def _turn(s):
    """All hands about the vertical through their middle."""
    from scipy.spatial.transform import Rotation

    middle = s.centre.mean(0)
    angles = np.array([0, 0.5, 1]) * np.pi / 2
    moves = [Rotation.from_rotvec(a * s.up).apply(s.centre - middle) - (s.centre - middle) for a in angles]
    turns = angles[:, None] * s.up
    return "turn it by 90 degrees about the vertical within 0.8 s, and hold it still", s.lifted([0.0, 0.4, 0.8], np.array(moves), turns)


def _roll(s):
    """The first hand about the line of the held edge, half a turn; of one hand, so that the body takes another pose."""
    turns = np.zeros((2, len(s.centre), 3))
    turns[1, 0] = np.pi * s.line
    moves = np.zeros((2, len(s.centre), 3))
    words = "turn one hand by half a turn about the line to the other" if s.span else "turn the hand over, by half a turn"
    return f"{words}, within 0.8 s, and hold it still", s.lifted([0.0, 0.8], moves, turns)


def _reverse(s):
    out, times = 2 * s.wide * s.face, [0.0, 0.25, 0.75, 1.0]
    says = f"jerk it aside, face-on, by {_cm(2 * s.wide)} in 0.25 s, rest for half a second, and jerk it back"
    return says, s.lifted(times, np.stack([0 * out, out, out, 0 * out]), abrupt=True)


def _hard_stop(s):
    out = 2 * s.wide * s.face
    says = f"carry it face-on over {_cm(4 * s.wide)} in {2 * FAST:.2g} s, and stop at once"
    return says, s.lifted([0.0, 2 * FAST], np.stack([-out, out]) + out, abrupt=True)


def _sweep(s):
    halves = np.geomspace(0.5, 0.1, 12)
    heights = 0.1 * s.wide * np.append(0, (-1.0) ** np.arange(12) * np.linspace(2, 1, 12))
    says = f"shake it up and down by some {_cm(0.4 * s.wide)}, slowly at first and faster and faster, from one to five times a second"
    return says, s.lifted(np.append(0, np.cumsum(halves)), heights[:, None] * s.up)


def _drop(s):
    high = 2 * s.wide * s.up
    says = f"raise it by {_cm(2 * s.wide)}, and let the hands fall by as much in 0.2 s"
    return says, s.lifted([0.0, 0.5, 0.7, 0.9], np.stack([0 * high, high, high, 0 * high]))


def _peel(s):
    if s.lift <= LYING:
        return None
    seconds = 2.5 * s.lift / RISE
    return f"peel it off the table, straight up by {_cm(s.lift)} in {seconds:.2g} s", s.path([0.0, seconds], [0 * s.up, s.lift * s.up])


def _drag(s):
    if s.lift <= LYING:
        return None
    a, b = (1.5 * s.wide * w for w in (s.line, s.face))
    says = f"drag it over the table in a square of {_cm(1.5 * s.wide)}, half a second a side"
    return says, s.path([0.0, 0.5, 1.0, 1.5, 2.0], np.stack([0 * a, -b, a - b, a, 0 * a]))


def _apart(seconds, share, words):
    """The hands apart along the line between them, or together, and back."""

    def make(s):
        if s.span < LYING:
            return None
        way = (s.centre[1] - s.centre[0]) / s.span * share * s.span / 2
        moves = np.zeros((4, len(s.centre), 3))
        moves[1:3, 0], moves[1:3, 1] = -way, way
        says = f"{words} by {100 * abs(share) * s.span:.1f} cm within {seconds:.2g} s, wait for half a second, and go back as fast"
        return says, s.lifted([0.0, seconds, seconds + 0.5, 2 * seconds + 0.5], moves)

    return make


LIBRARY: dict[str, Callable[[Setting], tuple[str, np.ndarray] | None]] = {
    "hold": _hold,
    "face-on swing": _swing("face", "face-on", FAST),
    "slow face-on swing": _swing("face", "face-on", SLOW),
    "edge-on swing": _swing("line", "edge-on", FAST),
    "turn": _turn,
    "roll": _roll,
    "reverse": _reverse,
    "hard stop": _hard_stop,
    "shake sweep": _sweep,
    "lift and drop": _drop,
    "peel": _peel,
    "drag": _drag,
    "slow pull": _apart(1.2, 0.05, "pull the hands apart"),
    "fast pull": _apart(0.2, 0.05, "pull the hands apart"),
    "squeeze": _apart(0.6, -0.3, "bring the hands together"),
}
ON_THE_TABLE = (_peel, _drag)
