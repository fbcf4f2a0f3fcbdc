"""A body in frame 0 of a recording, its hands and its ground: all of a simulation but the numbers that are fitted."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...datasets.scenario import Observed, Plane
from ...physics.grids import Grid
from ...physics.points import Points, material_points
from .body import SolidBody, body_of
from .config import DENSITY, STARTS
from .hands import FINGER, SOFT, Hand, frames_of, hands_of, steadied
from .held import falloff
from .start import starts_at_rest
from .velocity import Field, Launch, launched

__all__ = ["REACH", "Equilibrium", "Grasp", "Scene", "posed"]

REACH = 2.0  # times the usual radius of a grip, at most, that is fitted
SAME = 1e-9  # m: controllers that start where the recording's do
SHIFT = 0.015  # m, at most, that the place of a grip is off
FOUND = 60  # rounds in which a place in the rest shape is found: where the body has turned by 40 degrees each gains a third of a digit
HALF = 0.5 + 1e-6  # of a cell, from a driven marker to a node that it carries


def posed(grid: Grid, rotation, shift) -> Grid:
    """``grid`` moved rigidly: x -> rotation @ x + shift."""
    return replace(grid, origin=rotation @ grid.origin + shift, axes=grid.axes @ rotation.T)


@dataclass(frozen=True, eq=False)
class Grasp:
    """What hands may hold: ``points`` (n,) of the material, and the ``hand`` (n,) that holds each, the nearer one of two."""

    points: np.ndarray
    hand: np.ndarray


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Frame 0 of a body that is under load there: ``nodes`` (N, 3) m of the grid of its rest shape, and its ``modulus`` [Pa]."""

    nodes: np.ndarray
    modulus: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Lengths in m, in the room of the recording.

    grid       of the body at rest, which is frame 0 unless there is an ``equilibrium``; ``surface`` (S, 3) points of its skin in frame 0
               and their ``area`` [m^2]
    structure  (M, 3) the recording's points in frame 0, ``counts`` of tracked, surface and interior ones
    hands      as they move in the recording, ``controllers`` (T, C, 3) and ``grips`` (C,) as in it; ``radius`` of a grip
    gravity    (3,) m/s^2; ground or None; fps
    weights    (k, 4) kg, and m where in frame 0, of point masses that are told to be on the body (a body weighs ``DENSITY``)
    launch     how it moves from frame 0 to frame 1, or None: it starts at rest
    """

    name: str
    grid: Grid
    surface: np.ndarray
    area: float
    structure: np.ndarray
    counts: tuple[int, int, int]
    hands: tuple[Hand, ...]
    controllers: np.ndarray
    grips: np.ndarray
    radius: float
    gravity: np.ndarray
    ground: Plane | None
    fps: float
    notes: tuple[str, ...] = ()
    weights: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    launch: Launch | None = None
    equilibrium: Equilibrium | None = None

    @classmethod
    def of(cls, recording: Observed, body: SolidBody, start: str = "rest") -> Scene:
        """The scene of a recording and its body, which starts as ``Config.start`` says.

        Raises ValueError where a hand holds nothing though it comes near the body, or two frames do not tell a velocity that is asked for.
        """
        return cls.in_grid(recording, body.grid, body.surface, body.area, body.notes).starting(recording, start)

    @classmethod
    def in_grid(cls, recording: Observed, grid: Grid, surface, area: float, notes=()) -> Scene:
        """The scene of a recording whose body fills ``grid`` in frame 0."""
        radius = max(SOFT * recording.spacing, FINGER)
        hands = hands_of(recording, radius=radius)
        known = dict(structure=recording.structure, counts=recording.counts, controllers=recording.controllers, grips=recording.grips)
        known |= dict(gravity=recording.gravity, ground=_below(recording.ground, surface), fps=recording.fps)
        notes = (*notes, *(n for hand in hands for n in hand.notes))
        return cls(recording.name, grid, surface, area, hands=hands, radius=radius, notes=notes, **known)

    def regridded(self, recording: Observed, times: float) -> Scene:
        """The same in cells ``times`` as large."""
        grid = body_of(recording, kind="solid", pitch=times * float(self.grid.size.mean())).grid
        scene = replace(self, grid=grid, launch=None)
        return scene if self.launch is None else scene.moving(recording)

    def starting(self, recording: Observed, start: str) -> Scene:
        """The same, starting at "rest", as fast as the first two "frames" say, or ("auto") as fast where frame 0 is no rest."""
        if start not in STARTS:
            raise ValueError(f"start must be one of {', '.join(STARTS)}, got {start!r}")
        found = starts_at_rest(recording) if start == "auto" else None
        if start == "rest" or (found and found.rest):
            return self
        why = f": {found.words}" if found else ""
        return replace(self.moving(recording), notes=(*self.notes, f"its start velocity is that of the first two frames{why}"))

    def moving(self, recording: Observed) -> Scene:
        """The same with the velocity that the first two frames of ``recording`` tell."""
        path = self.carried()[:2]
        led = (path[-1] - path[0]) * self.fps
        return replace(self, launch=launched(recording, self.grid, *self._led, led))

    @cached_property
    def speeds(self) -> Field:
        """The velocity field that the tracks of ``launch`` tell."""
        return Field(self.grid, self.launch.places, self.launch.weight, *self._led)

    @property
    def _led(self):
        """(places (h, 3) m and firmness (h,) of what hands carry softly, nodes (f,) that they carry rigidly)."""
        usual = np.zeros((len(self.hands), 3)), np.ones(len(self.hands))
        return self.points.home[self.grasp.points], self.firmness(*usual), self.fastened[0]

    @property
    def nodes(self) -> np.ndarray:
        """(N, 3) m, the grid's nodes in frame 0."""
        return self.grid.positions if self.equilibrium is None else self.equilibrium.nodes

    def under(self, modulus: float) -> Scene:
        """The same body of another ``modulus`` [Pa]: one that is twice as soft is twice as far from its rest shape."""
        if self.equilibrium is None or modulus == self.equilibrium.modulus:
            return self
        home = self.grid.positions
        nodes = home + (self.equilibrium.nodes - home) * (self.equilibrium.modulus / modulus)
        return replace(self, equilibrium=Equilibrium(nodes, modulus))

    def at_rest(self, places) -> np.ndarray:
        """(n, 3) m, where in the rest shape what is at ``places`` (n, 3) in frame 0 is."""
        found = np.array(places, float)
        for _ in range(FOUND if self.equilibrium else 0):
            carriers, weights = self.grid.locate(found)
            found += places - np.einsum("mk,mki->mi", weights, self.nodes[carriers])
        return found

    @cached_property
    def points(self) -> Points:
        """The material points where they are in frame 0, nobody holding them yet."""
        made = material_points(self.grid, DENSITY, self.at_rest(self.surface), self.area)
        made = made if not len(self.weights) else _with_weights(made, self.grid, self.weights[:, 0], self.at_rest(self.weights[:, 1:]))
        return made if self.equilibrium is None else replace(made, home=made.positions(self.nodes))

    @cached_property
    def embedding(self) -> tuple[np.ndarray, np.ndarray]:
        """(nodes (M, 8), weights (M, 8)) that carry the structure points."""
        return self.grid.locate(self.at_rest(self.structure))

    @cached_property
    def grips_at(self) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """(places (k, 3) m of each hand, radii (H,) m): a hand holds what is within its radius of any of its places.

        One place for a hand that is near the body: the middle of the material beside its controllers, and the radius of the ball that what
        it was seen to hold fills: of what is spread evenly in a ball the RMS distance from its middle is sqrt(3 / 5) of the radius. Driven
        markers hold otherwise (``fastened``), and are places themselves.
        """
        from scipy.spatial import cKDTree

        places, radii = [], np.full(len(self.hands), self.radius)
        home = self.points.home[self.points.masses > 0]
        for k, hand in enumerate(self.hands):
            at = self.controllers[0, hand.controllers]
            if (self.grips[hand.controllers] >= 0).all():
                places.append(at)
                continue
            near = falloff(cKDTree(at).query(home)[0], self.radius)
            places.append((near @ home / near.sum() if near.sum() > 0 else hand.centre[0])[None])
            if len(hand.points):
                held, share = self.structure[hand.points], hand.firmness / hand.firmness.sum()
                radii[k] = max(0.5 * self.radius, np.sqrt(share @ ((held - share @ held) ** 2).sum(1) / 0.6))
        return tuple(places), radii

    @cached_property
    def grasp(self) -> Grasp:
        """Which material points hands may hold, wherever within its bounds their grip is."""
        inside = np.flatnonzero(self.points.masses > 0)
        home, (places, radii) = self.points.home[inside], self.grips_at
        if not len(self.hands):
            return Grasp(inside[:0], np.zeros(0, int))
        apart = np.array([_apart(home, at) for at in places])
        holds = np.array([len(hand.points) > 0 and not self.driven(hand) for hand in self.hands])
        within = (apart < 1.5 * REACH * radii[:, None] + SHIFT) & holds[:, None]
        nearest = np.where(within, apart / radii[:, None], np.inf)
        kept = np.flatnonzero(within.any(0))
        return Grasp(inside[kept], nearest.argmin(0)[kept])

    def driven(self, hand: Hand) -> bool:
        """Whether all controllers of ``hand`` are markers on the body, which are driven."""
        return bool((self.grips[hand.controllers] >= 0).all())

    @cached_property
    def fastened(self) -> tuple[np.ndarray, np.ndarray]:
        """((f,) nodes that driven markers carry rigidly, (f,) the hand of each).

        Those within half a cell of a marker, in each of the grid's directions: one or more for each marker in the grid. What is clamped
        at a face is so held at its nodes there and no deeper. A soft grip of the material behind it shortens a beam: by a fifth
        where it reaches 2 cm into one of 10 cm.
        """
        owner = np.full(len(self.grid.positions), -1)
        at_rest = (self.grid.positions - self.grid.origin) @ self.grid.axes.T / self.grid.size
        for k, hand in enumerate(self.hands):
            if self.driven(hand):
                at = (self.at_rest(self.controllers[0, hand.controllers]) - self.grid.origin) @ self.grid.axes.T / self.grid.size
                owner[np.abs(at_rest[:, None] - at).max(2).min(1) <= HALF] = k
        nodes = np.flatnonzero(owner >= 0)
        return nodes, owner[nodes]

    def firmness(self, shift, reach) -> np.ndarray:
        """(n,) how firmly each point of the grasp is held, where grips are ``shift`` (H, 3) [m] off and ``reach`` (H,) times as wide."""
        (places, radii), found = self.grips_at, np.zeros(len(self.grasp.points))
        for k, at in enumerate(places):
            own = self.grasp.hand == k
            found[own] = falloff(_apart(self.points.home[self.grasp.points[own]], at + shift[k]), reach[k] * radii[k])
        return found

    def carried(self, hands=None) -> np.ndarray:
        """(T, n + f, 3) m, where ``hands`` (the recording's own unless given) carry the grasp's points and the nodes that are fastened."""
        hands = self.hands if hands is None else hands
        nodes, owner = self.fastened
        home = np.concatenate([self.points.home[self.grasp.points], self.nodes[nodes]])
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
            rotation, centre, told = frames_of(own)  # since the recording's frame 0, where the body is held
            at_start = rotation[1] if np.abs(own[1] - own[0]).max() > SAME else np.eye(3)
            turned = steadied(rotation[1:] @ rotation[1].T, self.fps) @ at_start
            found.append(replace(hand, rotation=turned, centre=centre[1:], turns=told))
        return tuple(found)


def _with_weights(points: Points, grid: Grid, masses, places) -> Points:
    """``points`` and point ``masses`` (k,) [kg] at ``places`` (k, 3) [m] of the rest shape."""
    nodes, weights = grid.locate(places)
    none = np.zeros(len(masses))
    more = dict(nodes=nodes, weights=weights, home=places, masses=masses, areas=none, holds=none.astype(int) - 1, held=none)
    return Points(**{name: np.concatenate([getattr(points, name), new]) for name, new in more.items()})


def _apart(points, places):
    """(n,) m, from each of ``points`` (n, 3) to the nearest of ``places`` (k, 3)."""
    return np.linalg.norm(points[:, None] - places, axis=2).min(1, initial=np.inf)


def _from(start: Hand, hand: Hand) -> Hand:
    """``hand`` with one frame more in front, in which it is where it held the body."""
    first = np.eye(3)[None], start.centre[:1]
    return replace(hand, rotation=np.concatenate([first[0], hand.rotation]), centre=np.concatenate([first[1], hand.centre]))


def _below(ground: Plane | None, surface) -> Plane | None:
    """The ground, as low as the lowest of the surface: a table that is reported too high would throw the body up."""
    if ground is None:
        return None
    return Plane(ground.normal, min(ground.offset, float((surface @ ground.normal).min())))
