"""A body in frame 0 of a recording, its hands and its ground: all of a simulation but the numbers that are fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...datasets.scenario import Observed, Plane
from ...physics.grids import Grid
from ...physics.points import Points, material_points
from .body import SolidBody, body_of
from .config import DENSITY
from .hands import FINGER, SOFT, Hand, frames_of, hands_of
from .held import falloff

__all__ = ["REACH", "Grasp", "Scene", "posed"]

REACH = 2.0  # times the usual radius of a grip, at most, that is fitted
SHIFT = 0.015  # m, at most, that the place of a grip is off
LEAST = 1e-3  # firmness of the usual grip or a larger one that is looked at


def posed(grid: Grid, rotation, shift) -> Grid:
    """``grid`` moved rigidly: x -> rotation @ x + shift."""
    return replace(grid, origin=rotation @ grid.origin + shift, axes=grid.axes @ rotation.T)


@dataclass(frozen=True, eq=False)
class Grasp:
    """What hands may hold: ``points`` (n,) of the material, the ``hand`` (n,) that holds each, and how far it ``agrees`` (n,) in [0, 1].

    A point that two hands could hold belongs to the nearer one.
    """

    points: np.ndarray
    hand: np.ndarray
    agrees: np.ndarray


@dataclass(frozen=True, eq=False)
class Scene:
    """Lengths in m, in the room of the recording.

    grid       of the body in frame 0, where it is at rest; ``surface`` (S, 3) points of its skin and their ``area`` [m^2]
    structure  (M, 3) the recording's points in frame 0, ``counts`` of tracked, surface and interior ones
    hands      as they move in the recording, ``controllers`` (T, C, 3) and ``grips`` (C,) as in it; ``radius`` of a grip
    gravity    (3,) m/s^2; ground or None; fps
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

    @classmethod
    def of(cls, recording: Observed, body: SolidBody) -> Scene:
        """The scene of a recording and its body; raises ValueError where a hand holds nothing though it comes near the body."""
        return cls.in_grid(recording, body.grid, body.surface, body.area, body.notes)

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
        return replace(self, grid=body_of(recording, kind="solid", pitch=times * float(self.grid.size.mean())).grid)

    @cached_property
    def points(self) -> Points:
        """The material points, nobody holding them yet."""
        return material_points(self.grid, DENSITY, self.surface, self.area)

    @cached_property
    def embedding(self) -> tuple[np.ndarray, np.ndarray]:
        """(nodes (M, 8), weights (M, 8)) that carry the structure points."""
        return self.grid.locate(self.structure)

    @cached_property
    def grasp(self) -> Grasp:
        """Which material points hands may hold, wherever within its bounds their grip is."""
        from scipy.spatial import cKDTree

        inside = np.flatnonzero(self.points.masses > 0)
        home = self.points.home[inside]
        distance, agrees = np.full((len(self.hands), len(home)), np.inf), np.zeros((len(self.hands), len(home)))
        for k, hand in enumerate(self.hands):
            if not len(hand.points):
                continue
            apart = cKDTree(self.controllers[0, hand.controllers]).query(home)[0]
            near = apart < 1.5 * REACH * self.radius + SHIFT
            distance[k, near], agrees[k, near] = apart[near], self._agreement(hand, home[near])
        agrees[agrees < LEAST] = 0
        hand = np.where(agrees > 0, distance, np.inf).argmin(0) if len(self.hands) else np.zeros(0, int)
        agree = agrees[hand, np.arange(len(home))] if len(self.hands) else np.zeros(len(home))
        kept = np.flatnonzero(agree)
        return Grasp(inside[kept], hand[kept], agree[kept])

    def _agreement(self, hand, places):
        """(n,) how far what is at ``places`` (n, 3) moves with a hand, as the structure points nearest to them do."""
        from scipy.spatial import cKDTree

        apart = cKDTree(self.controllers[0, hand.controllers]).query(self.structure)[0]
        usual, firm = falloff(apart, self.radius), np.zeros(len(self.structure))
        firm[hand.points] = hand.firmness
        known = np.flatnonzero((usual > 0.05) | (firm > 0))
        if not len(known):
            return np.zeros(len(places))
        agrees = np.minimum(1.0, firm[known] / np.maximum(usual[known], 0.05))
        far, who = cKDTree(self.structure[known]).query(places, k=min(4, len(known)))
        far, who = far.reshape(len(places), -1), who.reshape(len(places), -1)
        weight = 1 / (far + 0.1 * self.radius) ** 2
        return (weight * agrees[who]).sum(1) / weight.sum(1)

    def firmness(self, shift, reach) -> np.ndarray:
        """(n,) how firmly each point of the grasp is held, where grips are ``shift`` (H, 3) [m] off and ``reach`` (H,) times as wide."""
        from scipy.spatial import cKDTree

        found = np.zeros(len(self.grasp.points))
        for k, hand in enumerate(self.hands):
            own = np.flatnonzero(self.grasp.hand == k)
            if len(own):
                at = self.controllers[0, hand.controllers] + shift[k]
                apart = cKDTree(at).query(self.points.home[self.grasp.points[own]])[0]
                found[own] = falloff(apart, reach[k] * self.radius) * self.grasp.agrees[own]
        return found

    def carried(self, hands=None) -> np.ndarray:
        """(T, n, 3) m, where ``hands`` (the recording's own unless given) carry the points of the grasp."""
        hands = self.hands if hands is None else hands
        home = self.points.home[self.grasp.points]
        path = np.repeat(home[None], len(hands[0].centre) if hands else len(self.controllers), 0)
        for k, hand in enumerate(hands):
            own = np.flatnonzero(self.grasp.hand == k)
            if len(own):
                path[:, own] = _from(self.hands[k], hand).carried(home[own])[-len(path) :]
        return path

    def led(self, controllers) -> tuple[Hand, ...]:
        """The hands while controllers follow ``controllers`` (T, C, 3)."""
        found, first = [], self.controllers[:1]
        for hand in self.hands:
            own = np.concatenate([first[:, hand.controllers], controllers[:, hand.controllers]])
            rotation, centre, told = frames_of(own)  # since the recording's frame 0, where the body is held
            found.append(replace(hand, rotation=rotation[1:], centre=centre[1:], turns=told))
        return tuple(found)


def _from(start: Hand, hand: Hand) -> Hand:
    """``hand`` with one frame more in front, in which it is where it held the body."""
    first = np.eye(3)[None], start.centre[:1]
    return replace(hand, rotation=np.concatenate([first[0], hand.rotation]), centre=np.concatenate([first[1], hand.centre]))


def _below(ground: Plane | None, surface) -> Plane | None:
    """The ground, as low as the lowest of the surface: a table that is reported too high would throw the body up."""
    if ground is None:
        return None
    return Plane(ground.normal, min(ground.offset, float((surface @ ground.normal).min())))
