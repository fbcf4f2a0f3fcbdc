"""What all engines have in common: what surrounds a body and how it moved, the world that laws see, and the one way through a script."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..synthetic.simulate import GRAVITY
from .bodies import Body
from .motions import Script

__all__ = ["FPS", "SETTLE", "ElasticWorld", "Law", "Motion", "Obstacle", "Physics", "Step", "Unstable", "World", "run"]

FPS = 30.0
SETTLE = 0.3  # the body lies in closed grips that long before frame 0 [s]
FASTEST = 20.0  # no vertex of a sane simulation is faster [m/s]

Step = Callable[[float, np.ndarray, np.ndarray], np.ndarray | None]
Law = Callable[[Any], Step]  # of a ``World``, an ``ElasticWorld`` where it asks for strains


class Unstable(RuntimeError):
    """An engine's solution cannot be trusted."""


@dataclass(frozen=True)
class Obstacle:
    """A sphere, an upright cylinder or a box around ``place`` (3,) [m], of radius and half sides ``size`` [m]."""

    shape: str
    place: tuple[float, float, float]
    size: float


@dataclass(frozen=True)
class Physics:
    """What surrounds the body. laws: each is given the world once and then, in every step, time [s] from frame 0, positions and velocities
    (V, 3), and returns forces (V, 3) [N] or None; it may also change the world. belt: velocity of the table's surface [m/s].
    ground: height of the table at the origin [m], and how steeply it rises along x and y."""

    gravity: tuple[float, float, float] = (0.0, 0.0, -GRAVITY)
    laws: tuple[Law, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    belt: tuple[float, float] = (0.0, 0.0)
    ground: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def joined(self, other: Physics) -> Physics:
        """The surroundings with both."""
        gravity = other.gravity if self.gravity == Physics.gravity else self.gravity
        ground = self.ground if any(self.ground) else other.ground
        return Physics(
            gravity, self.laws + other.laws, self.obstacles + other.obstacles, self.belt if any(self.belt) else other.belt, ground
        )


@dataclass(frozen=True)
class Motion:
    """What moved, z up: vertices (T, V, 3), and of H hands position (H, T, 3) and rotation (H, T, 3, 3). Metres.

    gripped  (H,) arrays of vertex indices
    events   frames at which laws said that something began
    """

    vertices: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    gripped: tuple[np.ndarray, ...]
    events: dict = field(default_factory=dict)


class World(ABC):
    """The running simulation, as laws see it: ``body``, its ``gripped`` vertices, ``start`` (V, 3), ``dt`` [s] and ``events``.

    anchors  (G, 3) where the gripped vertices are held, in their hands' axes [m]; writable
    origins  (H,) where the hands are before they move [m]
    paths    (H,) moves (S, 3) [m] and rotations (S, 3, 3) of the hands, from the beginning of the settling on: ``poses`` of them a step
    """

    body: Body
    dt: float
    events: dict
    gripped: tuple[np.ndarray, ...]
    origins: list[np.ndarray]
    start: np.ndarray
    anchors: np.ndarray
    paths: list[tuple[np.ndarray, np.ndarray]]
    poses: int = 1
    refusals: tuple[type[Exception], ...] = ()  # what ``step`` raises where it finds no solution

    def __init__(self, body: Body, script: Script, steps: int):
        """``steps`` of a frame."""
        self.body, self.dt, self.events = body, 1 / (FPS * steps), {}
        self.start = body.vertices + [0, 0, body.radius]
        self.gripped = tuple(body.held(hand.grip, hand.grip_radius) for hand in script.hands)
        self.origins = [np.array(hand.grip) + [0, 0, body.radius] for hand in script.hands]

    def reach(self) -> np.ndarray:
        """(G, 3) from the hands to the vertices that they grip, at the start [m]."""
        return np.concatenate([self.start[g] - o for g, o in zip(self.gripped, self.origins, strict=True)] or [np.zeros((0, 3))])

    # --- what laws ask and do, of every engine ----------------------------------------------------------------------------------------

    @abstractmethod
    def positions(self) -> np.ndarray:
        """(V, 3) [m] of the vertices."""

    @abstractmethod
    def velocities(self) -> np.ndarray:
        """(V, 3) [m/s] of the vertices."""

    @abstractmethod
    def rotation(self, hand: int) -> np.ndarray:
        """(3, 3) the hand's axes in the room."""

    @abstractmethod
    def set_mass(self, mass: np.ndarray) -> None:
        """Masses (V,) [kg] of the vertices from now on."""

    @abstractmethod
    def grip_force(self, hand: int) -> np.ndarray:
        """(3,) with which the body pulls at ``hand`` [N]."""

    @abstractmethod
    def table_force(self) -> np.ndarray:
        """(V,) normal forces of the table and of obstacles in the last step [N]."""

    @abstractmethod
    def soften_grip(self, hand: int, stiffness: float, damping: float) -> Step:
        """A hand that holds its vertices by a spring [N/m] and a damper [N s/m] together: a step of a law."""

    @abstractmethod
    def stick(self, extra: float, speed: float) -> Step:
        """Friction that is higher at rest: on top of Coulomb's, ``extra`` exp(-(v / speed)^2) of the normal force, against v."""

    # --- the way through a script -----------------------------------------------------------------------------------------------------

    def times(self, settle: int, steps: int) -> np.ndarray:
        """(S,) s, when poses of the hands are asked for, in ``settle`` steps before frame 0 and ``steps`` after it."""
        return np.arange(-settle, steps + 2) * self.dt

    def begin(self, paths: Sequence[tuple[np.ndarray, np.ndarray]] = ()) -> None:
        """The hands will go along ``paths``, and laws have said what they want."""
        self.paths = list(paths)

    @abstractmethod
    def place(self, step: int) -> None:
        """Put the hands where they are at the beginning of a step."""

    def said(self) -> str:
        """What the engine says of a solution that cannot be trusted, or ""."""
        return ""

    def seen_by_laws(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities at which laws act in a step."""
        return self.positions(), self.velocities()

    @abstractmethod
    def go(self, step: int, external: np.ndarray) -> None:
        """Take a step, under ``external`` forces (V, 3) [N]."""


class ElasticWorld(World):
    """A world of an engine with elements that stretch."""

    @abstractmethod
    def strain(self, x: np.ndarray) -> np.ndarray:
        """(E,) largest strains of the elements at positions ``x`` (V, 3), without sign."""

    @abstractmethod
    def dilation(self, x: np.ndarray) -> np.ndarray:
        """(E,) mean strains of the elements at positions ``x`` (V, 3)."""

    @abstractmethod
    def stiffen(self, factor) -> None:
        """Elements (E,) or all are ``factor`` times as stiff as at rest from now on."""

    @abstractmethod
    def branch(self, ratio: float, *, tau: float = np.inf, limit: float = np.inf) -> Step:
        """A spring of ``ratio`` times the stiffness beside every element, in series with a damper (``tau`` [s]) or a slider that gives way
        at the strain ``limit``: a step of a law.
        """

    @abstractmethod
    def creep(self, tau: float) -> Step:
        """All elastic stress flows away with the time constant ``tau`` [s]: a step of a law."""

    @abstractmethod
    def prestrain(self, strain: float) -> None:
        """Elements would be longer by ``strain`` at rest than they were laid down."""

    @abstractmethod
    def cut(self, elements: np.ndarray) -> None:
        """``elements`` carry nothing from now on."""


def run(world: World, script: Script, physics: Physics, *, steps: int, settle: float) -> Motion:
    """``script.frames`` frames with ``steps`` steps each, after ``settle`` seconds in closed grips.

    Raises Unstable where the solution blows up, cannot be found or trusted, or turns a tetrahedron inside out.
    """
    body, last, before = world.body, (script.frames - 1) * steps, round(settle / world.dt)
    times = world.times(before, last)
    laws = [law(world) for law in physics.laws]
    world.begin([hand.path(times) for hand in script.hands])
    frames = []
    for step in range(before + last + 1):
        where = f"{script.name} of {body.kind} after {step} steps of {world.dt:.2g} s"
        world.place(step)
        if step >= before and (step - before) % steps == 0:
            frames.append(world.positions())
        if (said := world.said()) or not np.abs(world.velocities()).max() < FASTEST:
            raise Unstable(f"{where}: {said or 'it blew up'}")
        x, v = world.seen_by_laws()
        external = sum((f for law in laws if (f := law((step - before) * world.dt, x, v)) is not None), np.zeros_like(x))
        try:
            world.go(step, external)
        except world.refusals as reason:
            raise Unstable(f"{where}: {reason}") from None
    return _filmed(world, script, frames, (before + np.arange(script.frames) * steps) * world.poses)


def _filmed(world: World, script: Script, frames: list[np.ndarray], sampled: np.ndarray) -> Motion:
    """The motion of a ``world``, of whose poses ``sampled`` are frames.

    Raises Unstable where a tetrahedron was turned inside out: St. Venant-Kirchhoff's energy has a second rest there, and no body does that.
    """
    vertices, body = np.array(frames), world.body
    if body.dim == 3 and not body.volumes(vertices).min() > 0:
        raise Unstable(f"{script.name} of {body.kind} turns elements inside out")
    return Motion(
        vertices,
        np.array([origin + moves[sampled] for origin, (moves, _) in zip(world.origins, world.paths, strict=True)]),
        np.array([turns[sampled] for _, turns in world.paths]),
        world.gripped,
        {name: round(time * FPS) for name, time in world.events.items()},
    )
