"""Implicit time stepping: second-order backward differences (BDF2), each step solved by Newton's method.

With x* = (4 x_n - x_(n-1)) / 3, v* alike and h = 2/3 of the step: x = x* + h v, v = v* + h a, M a = forces at the step's end. Vertices that
touch something take Euler's backward step instead (x* = x_n, h the step): a rule with a memory would throw them back.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...synthetic.simulate import GRAVITY
from ..bodies import Body
from ..motions import Script
from ..world import SETTLE, ElasticWorld, Motion, Physics, run
from .banded import Banded, one_thread
from .contact import Contacts, gaps
from .continuum import Continuum
from .layers import Layers
from .plates import Plates
from .quadratic import Hexahedra
from .rods import Rod, turned
from .shells import Creases

__all__ = ["World", "simulate"]

COARSER = 4  # times the step of an explicit or half implicit engine
MOST = 12  # iterations in a step
MOST_LAGGED = 40  # iterations in a step of quadratic elements and resolved cloths: their matrix is kept until corrections shrink too slowly
SLOW = 0.4  # share of the correction before that the next may have before the matrix is made anew
EXACT = 3e-6  # the last correction of a step is smaller [m]
LONGEST = 0.02  # correction [m]


class World(ElasticWorld):
    """The running simulation; ``rotations`` (H, 3, 3) of the hands."""

    refusals = (np.linalg.LinAlgError, FloatingPointError, ValueError)

    def __init__(self, body: Body, script: Script, physics: Physics, steps: int):
        super().__init__(body, script, steps)
        self.anchors = self.reach()
        self.rotations = np.tile(np.eye(3), (len(self.gripped), 1, 1))
        self.mass, self.gravity = body.mass.copy(), np.array(physics.gravity)
        self.x, self.v = self.start.copy(), np.zeros_like(self.start)
        self.old = (self.x, self.v)
        self.reaction = np.zeros_like(self.x)
        surfaces = [_table(*physics.ground), *(gaps(o.shape, o.place, o.size) for o in physics.obstacles)]
        belts = [(*physics.belt, 0.0), *[(0.0, 0.0, 0.0)] * len(physics.obstacles)]
        self.contacts = Contacts(surfaces, belts, body.mass, body.friction, body.radius, GRAVITY)
        self.rod = Rod(body, self.start) if body.dim == 1 else None
        self.parts: list[Any] = [] if body.dim == 1 else [_elastic(body)] + ([_bending(body)] if body.dim == 2 else [])
        self.own = self.parts[0].scale.copy() if self.parts else np.ones(len(body.elements))
        self.layers = Layers(body, GRAVITY) if body.layers and body.dim == 2 else None
        self.soft = {}  # by hand, stiffness [N/m] and damping [N s/m] of a vertex in it
        self._number()

    def _number(self):
        count = len(self.x)
        corners = 3 * np.arange(count)[:, None] + np.arange(3)
        dofs = [corners[part.nodes].reshape(len(part.nodes), -1) for part in self.parts]
        self.frames = self.rod.frames.copy() if self.rod else np.zeros((0, 3, 3))
        self.spins, self.clamped = np.zeros((len(self.frames), 3)), []
        free = np.ones(3 * (count + len(self.frames)), bool)
        firm = [g for hand, g in enumerate(self.gripped) if hand not in self.soft]
        held = np.concatenate(firm) if firm else np.zeros(0, int)
        self.goal, self.springs = self.x.copy(), np.zeros((2, count))
        for hand, pair in self.soft.items():
            self.springs[:, self.gripped[hand]] = np.reshape(pair, (2, 1))
        self.held = np.zeros(count, bool)
        self.held[held] = True
        free[: 3 * count] = ~np.repeat(self.held, 3)
        if self.rod:
            dofs += list(self.rod.dofs)
            for hand, vertices in enumerate(self.gripped):
                if hand in self.soft:
                    continue
                # a hand holds the segments between its vertices against turning
                segments = np.flatnonzero(np.isin(self.body.elements, vertices).all(axis=1))
                free[(3 * count + 3 * segments[:, None] + np.arange(3)).ravel()] = False
                self.clamped.append((hand, segments, self.frames[segments].copy()))
            if self.body.resolved:
                self.rod.clamp(np.concatenate([np.zeros(0, int), *(segments for _, segments, _ in self.clamped)]))
        if self.body.resolved and self.body.dim == 2:
            self.parts[1].clamp(self.held)
        self.dofs = [*dofs, corners]
        self.system = Banded(self.dofs, free)
        self.lagged = self.body.cells is not None or (self.body.resolved and self.body.dim == 2)
        self.factored: tuple[Any, Any] = (None, None)  # a matrix and what touched when it was made

    # --- what laws ask and do ---------------------------------------------------------------------------------------------------------

    def positions(self) -> np.ndarray:
        return self.x

    def velocities(self) -> np.ndarray:
        return self.v

    def set_mass(self, mass: np.ndarray) -> None:
        """Masses (V,) [kg] of the vertices from now on."""
        self.mass = np.array(mass, float)

    def rotation(self, hand: int) -> np.ndarray:
        """(3, 3) the hand's axes in the room."""
        return self.rotations[hand]

    def grip_force(self, hand: int) -> np.ndarray:
        """(3,) with which the body pulled at ``hand`` in the last step [N]."""
        return self.reaction[self.gripped[hand]].sum(axis=0)

    def table_force(self) -> np.ndarray:
        """(V,) normal forces of the table and of obstacles in the last step [N]."""
        return self.contacts.normal

    def strain(self, x: np.ndarray) -> np.ndarray:
        """(E,) largest principal strains of the elements, without sign."""
        return np.abs(np.linalg.eigvalsh(self.parts[0].strain(x))).max(axis=1)

    def stiffen(self, factor) -> None:
        """Elements (E,) or all are ``factor`` times as stiff as at rest from now on."""
        self.parts[0].scale = np.broadcast_to(np.multiply(self.own, factor), self.own.shape).copy()

    def branch(self, ratio: float, *, tau: float = np.inf, limit: float = np.inf):
        """A spring of ``ratio`` times the stiffness beside every element, in series with a damper or a slider."""
        for part in self.parts if np.isfinite(limit) else self.parts[:1]:  # sheets rub where they bend, too
            part.branch(ratio, tau=tau, limit=limit)
        return lambda time, x, v: None

    def creep(self, tau: float):
        """All elastic shear and bending flows away with the time constant ``tau`` [s]; the volume stays."""
        for part in self.parts:
            part.tau = tau
        return lambda time, x, v: None

    def dilation(self, x: np.ndarray) -> np.ndarray:
        """(E,) mean strains of the elements."""
        return np.trace(self.parts[0].strain(x), axis1=1, axis2=2) / self.body.dim

    def prestrain(self, strain: float) -> None:
        """Elements would be longer by ``strain`` at rest than they were laid down."""
        self.parts[0].flow = np.broadcast_to((strain + strain**2 / 2) * np.eye(self.body.dim), self.parts[0].flow.shape).copy()

    def soften_grip(self, hand: int, stiffness: float, damping: float):
        """A hand that holds its vertices by a spring [N/m] and a damper [N s/m] together."""
        self.soft[hand] = (stiffness / len(self.gripped[hand]), damping / len(self.gripped[hand]))
        self._number()
        return lambda time, x, v: None

    def cut(self, elements: np.ndarray) -> None:
        """``elements`` carry nothing from now on."""
        self.parts[0].cut(elements)
        for creases in self.parts[1:]:
            creases.scale[np.isin(creases.sides, elements).any(axis=1)] = 0

    def stick(self, extra: float, speed: float):
        """Friction that is higher at rest: the coefficient grows by ``extra`` exp(-(v / speed)^2)."""
        self.contacts.extra, self.contacts.speed = extra, speed
        return lambda time, x, v: None

    # --- a step -----------------------------------------------------------------------------------------------------------------------

    def place(self, step):
        self.rotations = np.array([turns[step] for _, turns in self.paths]).reshape(-1, 3, 3)

    def seen_by_laws(self):
        """Ahead of the step, at whose end forces are taken."""
        return self.x + self.dt * self.v, self.v

    def go(self, step, external):
        self.place(step + 1)
        firsts = np.cumsum([0, *map(len, self.gripped)])
        held = [
            origin + moves[step + 1] + self.anchors[a:b] @ turn.T
            for origin, (moves, _), turn, a, b in zip(self.origins, self.paths, self.rotations, firsts, firsts[1:], strict=False)
        ]
        self.step(np.concatenate(held) if held else np.zeros((0, 3)), external)

    def step(self, targets: np.ndarray, external: np.ndarray) -> None:
        """Advance by ``dt``: held vertices to ``targets`` (G, 3) [m], under ``external`` forces (V, 3) [N]."""
        dt, before = self.dt, self.x
        if self.layers:
            self.layers.find(before)
        goal = self.goal.copy()
        for vertices, there in zip(self.gripped, np.split(targets, np.cumsum([len(g) for g in self.gripped])[:-1]), strict=False):
            goal[vertices] = there
        self.goal, self.pace = goal, (goal - self.goal) / dt
        touching = self._touching()[:, None]
        h = np.where(touching, dt, 2 * dt / 3)
        ahead = np.where(touching, self.x, (4 * self.x - self.old[0]) / 3)
        swing = np.where(touching, self.v, (4 * self.v - self.old[1]) / 3)
        x = self._begin(ahead + h * swing)
        frames = turned(self.frames, dt * self.spins)
        for hand, segments, rest in self.clamped:
            frames[segments] = self.rotations[hand] @ rest
        count = x.size
        inertia = self.mass[:, None] * (1 + h * self.body.drag) / h**2
        diagonal = np.concatenate([np.broadcast_to(inertia, x.shape).ravel(), np.repeat(self._rotary() / dt**2, 3)])
        last, stale = np.inf, self.lagged and not np.array_equal(touching, self.factored[1])
        for _ in range(MOST_LAGGED if self.lagged else MOST):
            fresh = not self.lagged or stale
            force, torque, blocks = self._forces(x, frames, before, tangent=fresh)
            velocity = (x - ahead) / h
            push = external + self.mass[:, None] * (self.gravity - self.body.drag * velocity - (velocity - swing) / h)
            if self.rod:
                torque = torque - self._rotary()[:, None] / dt * (_turn(self.frames, frames) / dt - self.spins)
            right = np.concatenate([(force + push).ravel(), torque.ravel()])
            if fresh:
                try:
                    change = self._solved(blocks, diagonal, right, touching)
                except np.linalg.LinAlgError:  # compressed elements push the matrix out of what Newton's method can use
                    change = self._solved(self._forces(x, frames, before, firm=True)[2], diagonal, right, touching)
            else:
                change = self.system.solved(self.factored[0], right)
            move = change[:count].reshape(-1, 3)
            size = np.abs(move).max()
            move = move * min(1.0, LONGEST / max(size, 1e-12))
            for _ in range(8):
                if not self.parts or self.parts[0].sound(x + move):
                    break
                move = move / 2
            x = x + move
            if self.rod:
                frames = turned(frames, np.clip(change[count:].reshape(-1, 3), -0.5, 0.5))
            if size < EXACT:
                break
            last, stale = size, self.lagged and size > SLOW * last
        # without the inertia of what is held: fingers that let it slip a little do not feel it throw itself about
        self.reaction = np.where(self.held[:, None], force + external + self.mass[:, None] * self.gravity, -self._drawn(x, before))
        self._commit(x, frames, (x - ahead) / h, before)

    def _solved(self, blocks, diagonal, right, touching):
        """The correction; a matrix that is to serve again is kept with what touched when it was made."""
        if not self.lagged:
            return self.system.solve(blocks, diagonal, right)
        self.factored = (self.system.factor(blocks, diagonal), touching)
        return self.system.solved(self.factored[0], right)

    def _begin(self, guess):
        """Where Newton's method starts: as inertia has it, or as it was where that would turn elements inside out."""
        guess[self.held] = self.goal[self.held]
        if self.parts and not self.parts[0].sound(guess):
            still = np.where(self.held[:, None], guess, self.x)
            return still
        return guess

    def _drawn(self, x, before):
        """(V, 3) forces of hands that do not hold firmly."""
        return self.springs[0, :, None] * (self.goal - x) + self.springs[1, :, None] * (self.pace - (x - before) / self.dt)

    def _touching(self):
        """(V,) vertices that are in contact or soon will be."""
        soon = self.contacts.touching(self.x) | self.contacts.touching(self.x + 1.5 * self.dt * self.v)
        return soon | self.layers.touching(len(self.x)) if self.layers else soon

    def _rotary(self):
        return self.rod.inertia if self.rod else np.zeros(0)

    def _forces(self, x, frames, before, *, firm=False, tangent=True):
        """Inner and contact forces (V, 3), torques (S, 3), and all stiffness blocks in the order of ``dofs``, if a ``tangent`` is asked."""
        total, blocks = np.zeros(x.size + 3 * len(frames)), []
        given: list[Any] = [part.evaluate(x, self.dt, firm=firm) if tangent else (part.pull(x, self.dt), None) for part in self.parts]
        if self.rod:
            given += zip(*self.rod.evaluate(x, frames, self.dt), strict=True)
        given.append(self.contacts.evaluate(x, before, self.dt))
        if self.layers:
            self.layers.add(x, before, self.dt, *given[-1])
        if self.soft:
            given[-1][0][:] += self._drawn(x, before)
            given[-1][1][:] += (self.springs[0] + self.springs[1] / self.dt)[:, None, None] * np.eye(3)
        for dofs, (force, block) in zip(self.dofs, given, strict=True):
            total += np.bincount(dofs.ravel(), force.ravel(), len(total))
            blocks.append(block)
        return total[: x.size].reshape(-1, 3), total[x.size :].reshape(-1, 3), blocks

    def _commit(self, x, frames, v, before):
        for part in self.parts:
            part.commit(x, self.dt)
        if self.rod:
            self.rod.commit(x, frames)
            self.spins = _turn(self.frames, frames) / self.dt
            self.frames = frames
        self.contacts.commit(x, before, self.dt)
        self.old, self.x, self.v = (self.x, self.v), x, v


def simulate(body: Body, script: Script, physics: Physics | None = None, *, substeps: int = 32, settle: float = SETTLE) -> Motion:
    """``script.frames`` frames of ``body`` with a quarter of ``substeps`` steps each, after ``settle`` seconds in closed grips.

    Raises Unstable where the solution blows up or what is asked for cannot be solved.
    """
    physics, steps = physics or Physics(), max(substeps // COARSER, 1)
    with one_thread():
        return run(World(body, script, physics, steps), script, physics, steps=steps, settle=settle)


def _elastic(body):
    """The elements of a cloth or a stuffed body."""
    return Continuum(body) if body.cells is None else Hexahedra(body)


def _bending(body):
    return Plates(body) if body.resolved else Creases(body)


def _table(height, rise_x, rise_y):
    """Distance to the plane z = height + rise . (x, y)."""
    normal = np.array([-rise_x, -rise_y, 1.0])
    normal /= np.linalg.norm(normal)
    return lambda x: ((x - [0, 0, height]) @ normal, np.broadcast_to(normal, x.shape))


def _turn(before, after):
    """(S, 3) rotation vectors from frames to frames, in the former's axes."""
    relative = np.swapaxes(before, 1, 2) @ after
    vector = np.stack(
        [relative[:, 2, 1] - relative[:, 1, 2], relative[:, 0, 2] - relative[:, 2, 0], relative[:, 1, 0] - relative[:, 0, 1]], 1
    )
    sine = np.linalg.norm(vector, axis=1) / 2
    angle = np.arctan2(sine, (np.trace(relative, axis1=1, axis2=2) - 1) / 2)
    return vector / 2 * (angle / np.maximum(sine, 1e-12))[:, None]
