"""A body in frame 0 of a recording, its hands and its ground: all of a simulation but the numbers that are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...datasets.scenario import Observed, Plane
from ...physics.outside import carried_masses
from ...physics.points import Points
from ...physics.terms.base import Term
from .bodies import Body
from .hands import FINGER, SOFT, Hand, bar_of, frames_of, hands_of, steadied
from .held import falloff
from .start import Speeds
from .velocity import Launch, Lead

__all__ = ["REACH", "Grasp", "Scene"]

REACH = 2.0  # times the usual radius of a grip, at most, that is fitted
SAME = 1e-9  # m: controllers that start where the recording's do
SHIFT = 0.015  # m, at most, that the place of a grip is off


@dataclass(frozen=True, eq=False)
class Grasp:
    """What hands may hold: ``points`` (n,) of the material, and the ``hand`` (n,) that holds each, the nearer one of two."""

    points: np.ndarray
    hand: np.ndarray


@dataclass(frozen=True, eq=False)
class Scene:
    """Lengths in m, in the room of the recording.

    body       in frame 0
    hands      as they move in the recording, ``controllers`` (T, C, 3) and ``grips`` (C,) as in it; ``radius`` of a grip
    gravity    (3,) m/s^2; ground or None; fps, and whether that was recorded (``timed``)
    counts     of tracked, surface and interior structure points
    speeds     of the body in frame 0, or None: at rest
    still      whether frame 0 is an equilibrium (``start.Start``): what pulls at the body pulled at it before
    contact    whether layers or strands of the body meet
    """

    name: str
    body: Body
    counts: tuple[int, int, int]
    hands: tuple[Hand, ...]
    controllers: np.ndarray
    grips: np.ndarray
    radius: float
    gravity: np.ndarray
    ground: Plane | None
    fps: float
    speeds: Speeds | None = None
    contact: bool = False
    notes: tuple[str, ...] = ()
    timed: bool = True
    still: bool = False

    @classmethod
    def of(
        cls,
        recording: Observed,
        body: Body,
        *,
        speeds: Speeds | None = None,
        still: bool = False,
        contact: bool = False,
        notes: tuple[str, ...] = (),
    ) -> Scene:
        """The scene of a recording and its body, which moves at ``speeds`` in frame 0, or is at rest, ``still`` if it is so in
        equilibrium, and with ``contact`` meets itself.

        notes  more than its body and hands say. Raises ValueError where a hand holds nothing though it comes near the body.
        """
        radius = max(SOFT * recording.spacing, FINGER)
        hands = hands_of(recording, radius=radius)
        known: dict[str, Any] = dict(
            counts=recording.counts, controllers=recording.controllers, grips=recording.grips, gravity=recording.gravity
        )
        known |= dict(ground=_below(recording.ground, body), fps=recording.fps)
        known |= dict(speeds=speeds, still=still, contact=contact, timed=recording.timed)
        notes = (*body.notes, *notes, *(n for hand in hands for n in hand.notes))
        return cls(recording.name, body, hands=hands, radius=radius, notes=notes, **known)

    @property
    def structure(self) -> np.ndarray:
        """(M, 3) m, the recording's points in frame 0."""
        return self.body.structure

    @cached_property
    def launch(self) -> Launch | None:
        """How the nodes start, or None: at rest."""
        return None if self.speeds is None else self.body.launched(self.speeds, self.lead)

    @property
    def velocities(self) -> np.ndarray | None:
        """(N, 3) m/s of the nodes in frame 0, as they are told, or None: at rest."""
        return None if self.launch is None else self.launch.velocity

    @property
    def lead(self) -> Lead:
        """How hands carry the points of the grasp and the nodes that are fastened, from frame 0 to frame 1."""
        path = self.carried(self.hands)[:2]
        usual = np.zeros((len(self.hands), 3)), np.ones(len(self.hands))
        return Lead(self.points.home[self.grasp.points], self.firmness(*usual), self.fastened[0], (path[-1] - path[0]) * self.fps)

    @property
    def points(self) -> Points:
        """The material points, nobody holding them yet."""
        return self.body.points

    @cached_property
    def driven(self) -> np.ndarray:
        """(C,) the node that a controller is, which it moves as it moves itself, or -1."""
        return np.where(self.grips >= 0, self.body.markers[self.grips], -1)

    @cached_property
    def soft(self) -> tuple[int, ...]:
        """The hands that hold points of the body softly: those with something in them that is more than nodes that they are or carry."""
        free = [k for k, hand in enumerate(self.hands) if len(hand.points) and (self.driven[hand.controllers] < 0).any()]
        return tuple(k for k in free if k not in self.fastened[1])

    @cached_property
    def fastened(self) -> tuple[np.ndarray, np.ndarray]:
        """((f,) nodes that are no controllers but carried rigidly by driven markers, (f,) the hand of each)."""
        owner = np.full(len(self.body.positions), -1)
        for k, hand in enumerate(self.hands):
            if (self.grips[hand.controllers] >= 0).all():
                owner[self.body.fastened(self.controllers[0, hand.controllers])] = k
        nodes = np.flatnonzero(owner >= 0)
        return nodes, owner[nodes]

    @cached_property
    def grips_at(self) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """(places (k, 3) m of each hand, radii (H,) m): a hand holds what is within its radius of any of its places.

        One place for a hand that is near the body, in the material beside its controllers, and the radius of the ball that what it was seen
        to hold fills: of what is spread evenly in a ball of n dimensions the mean square distance from its middle is n / (n + 2) of the
        radius squared. A bar has places along its middle line, and holds a strip beside it, of one dimension less. Driven markers are
        places themselves.
        """
        from scipy.spatial import cKDTree

        places, radii = [], np.full(len(self.hands), self.radius)
        home = self.points.home[self.points.masses > 0]
        for k, hand in enumerate(self.hands):
            at = self.controllers[0, hand.controllers]
            if (self.grips[hand.controllers] >= 0).all():
                places.append(at)
                continue
            near, bar = falloff(cKDTree(at).query(home)[0], self.radius), bar_of(at)
            places.append(self.body.held_middle(hand.centre[0], near)[None] if bar is None else bar)
            if len(hand.points):
                held, share = self.structure[hand.points], hand.firmness / hand.firmness.sum()
                spread = share @ (((held - share @ held) ** 2).sum(1) if bar is None else _apart(held, bar) ** 2)
                radii[k] = max(0.5 * self.radius, np.sqrt((1 + 2 / max(self.body.dimensions - (bar is not None), 1)) * spread))
        return tuple(places), self.body.grip_share * radii

    @cached_property
    def grasp(self) -> Grasp:
        """Which material points hands may hold, wherever within its bounds their grip is."""
        inside = np.flatnonzero(self.points.masses > 0)
        home, (places, radii) = self.points.home[inside], self.grips_at
        if not len(self.hands):
            return Grasp(inside[:0], np.zeros(0, int))
        apart = np.array([_apart(home, at) for at in places])
        holds = np.isin(np.arange(len(self.hands)), self.soft)
        within = (apart < 1.5 * REACH * radii[:, None] + SHIFT) & holds[:, None]
        nearest = np.where(within, apart / radii[:, None], np.inf)
        kept = np.flatnonzero(within.any(0))
        return Grasp(inside[kept], nearest.argmin(0)[kept])

    def firmness(self, shift, reach) -> np.ndarray:
        """(n,) how firmly each point of the grasp is held, where grips are ``shift`` (H, 3) [m] off and ``reach`` (H,) times as wide."""
        (places, radii), found = self.grips_at, np.zeros(len(self.grasp.points))
        for k, at in enumerate(places):
            own = self.grasp.hand == k
            found[own] = falloff(_apart(self.points.home[self.grasp.points[own]], at + shift[k]), reach[k] * radii[k])
        return found

    def held_mass(self, shift, reach, hands: Sequence[int]) -> float:
        """kg that one of ``hands`` holds, which hold softly, each point as firmly as it is held; of several the geometric mean."""
        held = self.firmness(shift, reach) * self.points.masses[self.grasp.points]
        each = np.bincount(self.grasp.hand, held, len(self.hands))[list(hands)]
        return float(np.exp(np.mean(np.log(each))))

    @property
    def burden(self) -> float | None:
        """m/s^2, by which soft hands pull what they hold while they carry all of the body at rest; None where none does."""
        carries = carried_masses(self.points, self.points.node_masses(len(self.body.positions)))  # which springs to hands count by
        held = self.firmness(np.zeros((len(self.hands), 3)), np.ones(len(self.hands))) @ carries[self.grasp.points]
        return float(np.linalg.norm(self.gravity) * self.points.masses.sum() / held) if held > 0 else None

    def tell(self, term: Term) -> Term:
        """``term`` with what the recording says of its surroundings: gravity, the plane of the ground, what hands carry."""
        known = {f"told_gravity_{axis}": float(g) for axis, g in zip("xyz", self.gravity, strict=True)}
        if self.ground is not None:
            plane = dict(zip(("normal_x", "normal_y", "normal_z", "offset"), (*self.ground.normal, self.ground.offset), strict=True))
            known |= {f"adhesion_{name}": float(value) for name, value in plane.items()}
        if "slide_burden" in term.values and (burden := self.burden):
            low, high = next((p.low, p.high) for p in term.parameters if p.name == "slide_burden")
            known |= {"slide_burden": float(np.clip(burden, low, high))}
        return term.with_values(**{name: value for name, value in known.items() if name in term.values})

    def paths(self, controllers=None) -> np.ndarray:
        """(T, D + n + f, 3) m, where ``controllers`` (the recording's own unless given) move D driven nodes, and what ``carried`` says."""
        hands = self.hands if controllers is None else self.led(controllers)
        controllers = self.controllers if controllers is None else controllers
        return np.concatenate([controllers[:, self.driven >= 0], self.carried(hands)[-len(controllers) :]], 1)

    def seen_from(self, turn, shift) -> Scene:
        """The scene in the frame of its points, where these were reported turned by ``turn`` (3,) [rad, a rotation vector] about the body's
        middle in frame 0, and ``shift`` (3,) [m] away: hands, gravity and ground, which were reported rightly, lie so beside them."""
        from scipy.spatial.transform import Rotation

        rotation, middle = Rotation.from_rotvec(turn).as_matrix(), self.structure.mean(0)

        def moved(points):
            return (points - middle) @ rotation.T + middle + shift

        hands = tuple(replace(h, centre=moved(h.centre), rotation=rotation @ h.rotation @ rotation.T) for h in self.hands)
        ground = self.ground
        if ground is not None:
            normal = np.clip(rotation @ ground.normal, -1.0, 1.0)  # rounding makes it longer than it may be
            ground = _below(Plane(normal, float(normal @ moved(ground.offset * ground.normal)) - self.body.standoff), self.body)
        return replace(self, hands=hands, controllers=moved(self.controllers), gravity=rotation @ self.gravity, ground=ground)

    def carried(self, hands) -> np.ndarray:
        """(T, n + f, 3) m, where ``hands`` carry the points of the grasp and the nodes that are fastened."""
        nodes, owner = self.fastened
        home = np.concatenate([self.points.home[self.grasp.points], self.body.positions[nodes]])
        held_by = np.concatenate([self.grasp.hand, owner])
        path = np.repeat(home[None], len(hands[0].centre) if hands else len(self.controllers), 0)
        for k, hand in enumerate(hands):
            own = np.flatnonzero(held_by == k)
            if len(own):
                path[:, own] = _from(self.hands[k], hand).carried(home[own])[-len(path) :]
        return path

    def led(self, controllers) -> tuple[Hand, ...]:
        """The hands while controllers follow ``controllers`` (T, C, 3)."""
        found, first = [], self.controllers[:1]
        for hand in self.hands:
            own = np.concatenate([first[:, hand.controllers], controllers[:, hand.controllers]])
            if np.ptp(own - own[0], axis=1).max() < SAME:  # carried without a turn, as planners do by thousands: nothing is to be fitted
                found.append(replace(hand, rotation=np.tile(np.eye(3), (len(own) - 1, 1, 1)), centre=own[1:].mean(1)))
                continue
            rotation, centre, told = frames_of(own)  # since the recording's frame 0, where the body is held
            at_start = rotation[1] if np.abs(own[1] - own[0]).max() > SAME else np.eye(3)
            turned = steadied(rotation[1:] @ rotation[1].T, self.fps) @ at_start
            found.append(replace(hand, rotation=turned, centre=centre[1:], turns=told))
        return tuple(found)


def _apart(points, places):
    """(n,) m, from each of ``points`` (n, 3) to the nearest of ``places`` (k, 3)."""
    return np.linalg.norm(points[:, None] - places, axis=2).min(1, initial=np.inf)


def _from(start: Hand, hand: Hand) -> Hand:
    """``hand`` with one frame more in front, in which it is where it held the body."""
    first = np.eye(3)[None], start.centre[:1]
    return replace(hand, rotation=np.concatenate([first[0], hand.rotation]), centre=np.concatenate([first[1], hand.centre]))


def _below(ground: Plane | None, body: Body) -> Plane | None:
    """The ground that the body's surface points meet, as low as the lowest of them: one that is reported too high would throw it up."""
    if ground is None:
        return None
    return Plane(ground.normal, min(ground.offset + body.standoff, float((body.surface @ ground.normal).min())))
