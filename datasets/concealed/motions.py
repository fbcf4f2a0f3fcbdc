"""What the hands do: for every kind of interaction the grips and the paths of one or two hands, drawn from a seed. z is up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..synthetic.interactions import Interaction
from .bodies import Body

__all__ = ["GENTLE", "KINDS", "Script", "draw", "parts"]

HOLD = 0.5  # the hands rest that long at the end [s]


@dataclass(frozen=True)
class Script:
    """An interaction: ``hands`` (one ``Interaction`` each, with grip and path), over ``frames`` frames at 30 a second."""

    name: str
    hands: tuple[Interaction, ...]
    frames: int


def draw(kind: str, body: Body, rng: np.random.Generator) -> Script:
    """An interaction of ``KINDS`` or ``GENTLE`` with ``body``. Raises ValueError for an unknown kind."""
    known = KINDS | GENTLE
    if kind not in known:
        raise ValueError(f"unknown interaction {kind!r}; known: {', '.join(known)}")
    frames = int(rng.integers(64, 91))
    hands = known[kind](body, rng, (frames - 1) / 30 - HOLD)
    return Script(kind, hands, frames)


def parts(script: Script) -> list[tuple[str, int, int]]:
    """What happens when: names of parts of the motion with their first frame and the frame after their last; at the end hands rest."""
    times = np.array(script.hands[0].times)
    keys, frames = [*SPANS[script.name], len(times) - 1], [0]
    for key in keys:
        frames.append(min(int(np.ceil(30 * times[key])), script.frames) if key else 0)
    named = zip(PARTS[script.name], frames[1:-1], frames[2:], strict=True)
    return [*((name, a, b) for name, a, b in named if b > a), ("rest", frames[-1], script.frames)]


def _ends(body, rng):
    """Two grips far apart (rest positions), the way from the second to the first, and how far a grip reaches."""
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    if body.resolved:  # in the middle of the blocks at both ends
        first, second = body.vertices[body.blocks[[0, -1], 0]]
    elif body.kind == "rope":
        first, second = body.vertices[[1, -2]]
    elif body.kind == "cloth":
        side = rng.uniform(-0.46, 0.46, 2) * (high - low)[1]
        first, second = np.array([0.47 * (low - high)[0], side[0], 0]), np.array([0.47 * (high - low)[0], side[1], 0])
    else:
        first, second = np.array([low[0] * 0.85, 0, high[2] / 2]), np.array([high[0] * 0.85, 0, high[2] / 2])
    if rng.random() < 0.5:
        first, second = second, first
    way = first - second
    return first, second, way / np.linalg.norm(way), {"cloth": 0.03, "rope": 0.025, "plush": 0.033}[body.kind]


def _hand(body, grip, reach, times, moves, turns=None):
    """A hand that closes on the vertices within ``reach`` of ``grip``, or on the nearest few where the mesh is coarse."""
    distance = np.sort(np.linalg.norm(body.vertices - grip, axis=1))
    reach = max(reach, distance[2] * 1.001)
    turns = np.zeros((len(times), 3)) if turns is None else turns
    away = np.arctan2(grip[1], grip[0])
    rows = [tuple(map(tuple, np.asarray(rows, float))) for rows in (moves, turns)]
    return Interaction("hand", grip=tuple(grip), grip_radius=reach, times=tuple(times), moves=rows[0], turns=rows[1], arm=float(away))


def _stretched(times, end):
    """Key times scaled to end at ``end`` [s]."""
    times = np.cumsum(times)
    return times * end / times[-1]


def lift_shake(body, rng, end):
    """Up by one end until the rest hangs, a pause, then to and fro, fast and slow."""
    grip, _, way, reach = _ends(body, rng)
    shakes = int(rng.integers(4, 6))
    up, across = _height(body, rng), np.array([-way[1], way[0], 0.0])
    moves = [np.zeros(3), [0, 0, 0.6 * up] - 0.05 * way, [0, 0, up] - 0.1 * way, [0, 0, up] - 0.11 * way]
    for k in range(shakes):
        swing = rng.uniform(0.04, 0.09) * (-1) ** k
        moves.append(moves[2] + swing * (across if rng.random() < 0.5 else way) + [0, 0, rng.uniform(-0.03, 0.03)])
    times = _stretched([0, 0.4, 0.35, 0.25, *rng.uniform(0.2, 0.42, shakes)], end)
    turns = np.concatenate([np.zeros((2, 3)), rng.normal(0, 0.25, (len(moves) - 2, 3))])
    return (_hand(body, grip, reach, times, moves, turns),)


def lift(body, rng, end):
    """Up by one end until the rest hangs, then a long pause."""
    grip, _, way, reach = _ends(body, rng)
    up = _height(body, rng)
    moves = [np.zeros(3), [0, 0, 0.5 * up] - 0.05 * way, [0, 0, up] - 0.1 * way, [0, 0, up] - 0.11 * way]
    turns = np.concatenate([np.zeros((2, 3)), np.tile(rng.normal(0, 0.25, 3), (2, 1))])
    return (_hand(body, grip, reach, _stretched([0, *rng.uniform(0.4, 0.6, 2), 0.8], end), moves, turns),)


def slow(body, rng, end):
    """Up by one end, then slowly here and there with a turning wrist: a few centimetres in half a second."""
    grip, _, way, reach = _ends(body, rng)
    up, across = _height(body, rng), np.array([-way[1], way[0], 0.0])
    moves, turns = [np.zeros(3), [0, 0, up] - 0.1 * way], [np.zeros(3), np.zeros(3)]
    for _ in range(3):
        a, b, c = rng.uniform(-0.05, 0.05, 3)
        moves.append(moves[1] + a * way + b * across + [0, 0, c])
        turns.append(rng.normal(0, 0.3, 3))
    times = _stretched([0, 0.9, *rng.uniform(0.4, 0.6, 3)], end)
    return (_hand(body, grip, reach, times, moves, np.array(turns)),)


def sway(body, rng, end):
    """Up by one end until the rest hangs, a pause, then once to and fro at about the pace of a pendulum, with a turning wrist."""
    grip, _, way, reach = _ends(body, rng)
    up, across = _height(body, rng), np.array([-way[1], way[0], 0.0])
    moves = [np.zeros(3), [0, 0, 0.6 * up] - 0.05 * way, [0, 0, up] - 0.1 * way, [0, 0, up] - 0.11 * way]
    for k in range(2):
        moves.append(moves[2] + rng.uniform(0.03, 0.06) * (-1) ** k * (across if rng.random() < 0.5 else way))
    times = _stretched([0, 0.5, 0.4, 0.25, *rng.uniform(0.45, 0.6, 2)], end)
    turns = np.concatenate([np.zeros((2, 3)), rng.normal(0, 0.15, (len(moves) - 2, 3))])
    return (_hand(body, grip, reach, times, moves, turns),)


def drag(body, rng, end):
    """Over the table from side to side, now and then half lifted."""
    grip, _, way, reach = _ends(body, rng)
    at, moves, heading = np.zeros(3), [np.zeros(3)], np.arctan2(way[1], way[0])
    for _ in range(int(rng.integers(5, 7))):
        heading += rng.uniform(0.5, 1.6) * rng.choice([-1, 1])
        step = rng.uniform(0.08, 0.16) * np.array([np.cos(heading), np.sin(heading), 0])
        if np.linalg.norm((at + step)[:2]) > 0.2:
            step[:2] = -step[:2]
            heading += np.pi
        at = at + step
        moves.append(np.array([*at[:2], rng.uniform(0.01, 0.06)]))
    times = _stretched([0, *rng.uniform(0.25, 0.5, len(moves) - 1)], end)
    return (_hand(body, grip, reach, times, moves),)


def two_hands(body, rng, end):
    """Both ends up, apart, swung together, slack, and apart again."""
    first, second, way, reach = _ends(body, rng)
    span, up, across = np.linalg.norm(first - second), _height(body, rng) * 0.8, np.array([-way[1], way[0], 0.0])
    most = {"cloth": 0.1, "rope": -0.02, "plush": 0.08}[body.kind]
    apart = span * np.array([0, -0.06, most, rng.uniform(-0.3, -0.1), 0.6 * most, rng.uniform(-0.2, -0.1), most, 0.3 * most]) / 2
    swing = np.array([0, 0.0, 0.02, rng.uniform(0.06, 0.1), -rng.uniform(0.06, 0.1), rng.uniform(0.03, 0.09), -0.04, 0])
    rise = up * np.array([0, 0.5, 1, rng.uniform(0.8, 1), 1, rng.uniform(0.8, 1.1), 1, rng.uniform(0.7, 0.9)])
    times = _stretched([0, 0.4, 0.45, *rng.uniform(0.22, 0.45, 5)], end)
    path = [(a * way + s * across + [0, 0, r], -a * way + s * across + [0, 0, r]) for a, s, r in zip(apart, swing, rise, strict=True)]
    return tuple(_hand(body, g, reach, times, [p[i] for p in path]) for i, g in enumerate((first, second)))


def fold(body, rng, end):
    """One end over to the other side, down on it, a rest, then up again."""
    grip, other, way, reach = _ends(body, rng)
    over, up = -(np.linalg.norm(grip - other) * rng.uniform(0.55, 0.85)) * way, _height(body, rng)
    aside = rng.uniform(-0.06, 0.06) * np.array([-way[1], way[0], 0])
    high = 0.5 * np.linalg.norm(over)
    moves = [np.zeros(3), 0.3 * over + [0, 0, high], 0.75 * over + [0, 0, 0.7 * high] + aside, over + [0, 0, 0.025] + aside]
    moves += [over + [0, 0, 0.022] + aside, 0.7 * over + [0, 0, 0.6 * up], 0.5 * over + [0, 0, up], 0.6 * over + [0, 0, 0.9 * up] + aside]
    times = _stretched([0, *rng.uniform(0.3, 0.4, 3), 0.2, *rng.uniform(0.25, 0.45, 3)], end)
    return (_hand(body, grip, reach, times, moves),)


def circle(body, rng, end):
    """Up by one end, then round in circles with a turning wrist."""
    grip, _, way, reach = _ends(body, rng)
    up, radius, sense = _height(body, rng), rng.uniform(0.04, 0.08), rng.choice([-1, 1])
    across = np.array([-way[1], way[0], 0.0])
    centre = np.array([0, 0, up]) - 0.1 * way
    angle = np.linspace(0, 2 * np.pi * rng.uniform(1.4, 2), 8)
    ring = [centre + radius * (np.cos(a) * way + sense * np.sin(a) * across) + [0, 0, 0.02 * np.sin(2 * a)] for a in angle]
    moves = [np.zeros(3), 0.55 * ring[0], *ring]
    turns = np.zeros((len(moves), 3))
    turns[2:, 2] = sense * np.linspace(0, rng.uniform(0.8, 2), 8)
    times = _stretched([0, 0.4, 0.35, *np.geomspace(0.3, rng.uniform(0.14, 0.25), 7)], end)
    return (_hand(body, grip, reach, times, moves, turns),)


def twist(body, rng, end):
    """Both ends up and a little nearer; one hand turns about the line between them, back, and on."""
    first, second, way, reach = _ends(body, rng)
    span, up = np.linalg.norm(first - second), _height(body, rng) * 0.7
    most = {"cloth": 1.6, "rope": 7.0, "plush": 1.3}[body.kind] * rng.uniform(0.8, 1.1) * rng.choice([-1, 1])
    near = {"cloth": 0.03, "rope": 0.22, "plush": 0.02}[body.kind] * span
    angle = np.array([0, 0, 0.5, 1, 0.4, -0.3, 0.6]) * most
    times = _stretched([0, 0.4, *rng.uniform(0.25, 0.5, 5)], end)
    rise = [0, 0.6 * up, up, up * rng.uniform(0.85, 1.1), up, up * rng.uniform(0.85, 1.1), up]
    closer = np.array([0, 0.6, 1, rng.uniform(0.7, 1.2), 1, rng.uniform(0.6, 1.2), 1]) * near
    sway = np.array([0, 0, 0.02, -0.03, 0.04, -0.02, 0.0])[:, None] * np.array([-way[1], way[0], 0])
    lifted = np.array([[0, 0, r] for r in rise]) + sway
    one = _hand(body, first, reach, times, lifted - closer[:, None] * way, angle[:, None] * way)
    return one, _hand(body, second, reach, times, lifted)


def _height(body, rng):
    extent = np.linalg.norm(np.ptp(body.vertices, axis=0)[:2])
    return min(extent * rng.uniform(0.75, 1.05), 0.42)


KINDS = {"lift_shake": lift_shake, "drag": drag, "two_hands": two_hands, "fold": fold, "circle": circle, "twist": twist}
GENTLE = {"lift": lift, "slow": slow, "sway": sway}
# names of the parts of an interaction, and the key poses at which they begin
PARTS = {
    "lift_shake": ("lift", "swing"),
    "drag": ("drag",),
    "two_hands": ("lift", "swing"),
    "fold": ("fold", "lift"),
    "circle": ("lift", "whirl"),
    "twist": ("lift", "twist"),
    "lift": ("lift", "pause"),
    "slow": ("lift", "slow"),
    "sway": ("lift", "sway"),
}
SPANS = {
    "lift_shake": (0, 3),
    "drag": (0,),
    "two_hands": (0, 2),
    "fold": (0, 4),
    "circle": (0, 2),
    "twist": (0, 2),
    "lift": (0, 2),
    "slow": (0, 1),
    "sway": (0, 3),
}
