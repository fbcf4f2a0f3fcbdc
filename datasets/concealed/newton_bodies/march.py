"""The world of a simulation by Newton, as laws see it, and the march through a script."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..bodies import Body
from ..engine import pulled, stuck
from ..finite.shells import Creases
from ..motions import Script
from ..world import SETTLE, ElasticWorld, Motion, Physics, Step, run
from .material import Bends, Elements
from .scene import Scene

__all__ = ["World", "simulate"]

ITERATIONS = 6  # of vertex block descent in a step: with twice as many, what can be predicted at all moves by a tenth of a millimetre
VISCOUS = (300.0, 1500.0)  # Pa s, viscosity of a body beyond which its vertices need steps half and a quarter as long to settle


class World(ElasticWorld):
    """The running simulation; ``rotations`` (H, 3, 3) and ``places`` (H, 3) of the hands."""

    def __init__(self, body: Body, script: Script, physics: Physics, steps: int):
        if body.dim == 1:
            raise ValueError(f"the engine 'newton' simulates cloth and plush, got a {body.kind}")
        super().__init__(body, script, steps)
        self.physics, self.anchors = physics, self.reach()
        self.rotations, self.places = np.tile(np.eye(3), (len(self.gripped), 1, 1)), np.array(self.origins).reshape(-1, 3)
        self.held = np.isin(np.arange(len(self.start)), np.concatenate([*self.gripped, []]))
        self.mass, self.x, self.v = body.mass.copy(), self.start.copy(), np.zeros_like(self.start)
        self.last = -self.dt * np.tile(physics.gravity, (len(self.x), 1))  # as if it had fallen freely before
        self.before, self.external, self.soft = self.x, np.zeros_like(self.x), {}
        self.elements = Elements(body, _poses(body))
        self.bends = Bends(body, Creases(body)) if body.dim == 2 else None
        self.own = np.ones(len(body.elements)) if body.stiffness is None else body.stiffness
        self.scale, self.whole = self.own.copy(), np.ones(len(body.elements))
        self.scene: Any = None  # before ``begin``
        self.intact = np.ones(len(self.bends.length) if self.bends else 1)

    # --- what laws ask and do ---------------------------------------------------------------------------------------------------------

    def positions(self) -> np.ndarray:
        return self.x

    def velocities(self) -> np.ndarray:
        return self.v

    def set_mass(self, mass: np.ndarray) -> None:
        """Masses (V,) [kg] of the vertices from now on."""
        self.mass = np.array(mass, float)
        self._weigh()

    def rotation(self, hand: int) -> np.ndarray:
        """(3, 3) the hand's axes in the room."""
        return self.rotations[hand]

    def grip_force(self, hand: int) -> np.ndarray:
        """(3,) with which the body pulled at ``hand`` in the last step [N], without the inertia of what it holds."""
        if hand in self.soft:
            return -self.soft[hand]
        held = self.gripped[hand]
        force = self.elements.pull(self.x, self.before, self.dt, self.scale * self.whole)
        if self.bends:
            force += self.bends.pull(self.x, self.before, self.dt, self.intact)
        return (force + self.external + self.mass[:, None] * self.physics.gravity)[held].sum(axis=0)

    def table_force(self) -> np.ndarray:
        """(V,) normal forces of the table and of obstacles in the last step [N]."""
        return np.where(self.held, 0, self.scene.pressed())

    def strain(self, x: np.ndarray) -> np.ndarray:
        """(E,) largest principal strains of the elements, without sign."""
        return np.abs(np.linalg.eigvalsh(self.elements.strain(x))).max(axis=1)

    def dilation(self, x: np.ndarray) -> np.ndarray:
        """(E,) mean strains of the elements."""
        return np.trace(self.elements.strain(x), axis1=1, axis2=2) / self.body.dim

    def stiffen(self, factor) -> None:
        """Elements (E,) or all are ``factor`` times as stiff as at rest from now on."""
        self.scale = np.broadcast_to(np.multiply(self.own, factor), self.own.shape).copy()
        self._tell()

    def branch(self, ratio: float, *, tau: float = np.inf, limit: float = np.inf) -> Step:
        """A spring of ``ratio`` times the stiffness beside every element, in series with a damper or a slider: more elements over them."""
        self.elements.add(ratio, tau=tau, limit=limit)
        if self.bends and np.isfinite(limit):  # sheets rub where they bend, too
            self.bends.add(ratio, tau=tau, limit=limit)
        return lambda time, x, v: None

    def creep(self, tau: float) -> Step:
        """All elastic shear and bending flows away with the time constant ``tau`` [s]; the volume stays."""
        for part in (self.elements, self.bends) if self.bends else (self.elements,):
            part.layers[0].tau = tau
        return lambda time, x, v: None

    def prestrain(self, strain: float) -> None:
        """Elements would be longer by ``strain`` at rest than they were laid down."""
        self.elements.layers[0].resting /= 1 + strain

    def soften_grip(self, hand: int, stiffness: float, damping: float) -> Step:
        """A hand that holds its vertices by a spring [N/m] and a damper [N s/m] together: a step of a law."""
        held, first = self.gripped[hand], sum(map(len, self.gripped[:hand]))
        self.held[held] = False
        pull = pulled(held, stiffness, damping, self.dt)

        def step(time, x, v):
            force = pull(self.places[hand] + self.anchors[first : first + len(held)] @ self.rotations[hand].T, x, v)
            self.soft[hand] = force.sum(axis=0)
            return force

        return step

    def cut(self, elements: np.ndarray) -> None:
        """``elements`` carry nothing from now on."""
        self.whole[elements] = 0
        if self.bends:
            self.intact[np.isin(self.bends.creases.sides, elements).any(axis=1)] = 0
        self._tell()

    def stick(self, extra: float, speed: float) -> Step:
        """Friction that is higher at rest: on top of Coulomb's, ``extra`` exp(-(v / speed)^2) of the normal force, against v."""
        return stuck(self, self.mass, extra, speed)

    # --- a step -----------------------------------------------------------------------------------------------------------------------

    def begin(self, paths=()):
        """Laws have said what they want: give it to Newton."""
        super().begin(paths)
        if self.bends and self.body.resolved:
            creases = self.bends.creases
            creases.clamp(self.held)
            creases.stiffness = creases.stiffness * creases.scale
        self.scene = Scene(self.body, self.start, self.elements, self.bends, self.physics, self.dt, ITERATIONS)
        self._tell()
        self._weigh()

    def place(self, step):
        self.places = np.array([o + moves[step] for o, (moves, _) in zip(self.origins, self.paths, strict=True)]).reshape(-1, 3)
        self.rotations = np.array([turns[step] for _, turns in self.paths]).reshape(-1, 3, 3)

    def go(self, step, external):
        self.place(step + 1)
        firsts = np.cumsum([0, *map(len, self.gripped)])
        held = [
            place + self.anchors[a:b] @ turn.T for place, turn, a, b in zip(self.places, self.rotations, firsts, firsts[1:], strict=False)
        ]
        self.step(np.concatenate(held) if held else np.zeros((0, 3)), external)

    def step(self, targets: np.ndarray, external: np.ndarray) -> None:
        """Advance by ``dt``: held vertices to ``targets`` (G, 3) [m], under ``external`` forces (V, 3) [N]."""
        scene, dt = self.scene, self.dt
        self.external, self.before = external, self.x
        force = external - self.body.drag * self.mass[:, None] * self.v
        if np.any(self.body.fibre):
            force += self.elements.drawn(self.x)
        goal = self.x.copy()
        goal[np.concatenate([*self.gripped, []]).astype(int)] = targets
        held = self.held[:, None]
        scene.q[:] = self.x
        scene.force[:] = np.where(held, 0, force)
        scene.qd[:] = np.where(held, (goal - self.x) / dt - dt * np.array(self.physics.gravity), self.v)
        scene.step(np.where(held, goal - self.x, dt * (2 * self.v - self.last)))
        self.last, self.v = self.v, scene.moved.astype(float) / dt
        self.x = self.x + dt * self.v
        flowing = [part for part in (self.elements, self.bends) if part and any(layer.flows for layer in part.layers)]
        for part in flowing:
            part.flow(self.x, dt)
        if flowing:
            self._tell()

    def _tell(self):
        if self.scene:
            self.scene.tell(self.scale * self.whole, self.intact)

    def _weigh(self):
        if self.scene:
            self.scene.weigh(self.mass, self.held)


def simulate(body: Body, script: Script, physics: Physics | None = None, *, substeps: int = 32, settle: float = SETTLE) -> Motion:
    """``script.frames`` frames of ``body`` with ``substeps`` steps each, more of a viscous one, after ``settle`` seconds in closed grips.

    Raises Unstable where the solution blows up, ValueError for a rope and where Newton is not installed.
    """
    if body.dim == 3:
        substeps *= 2 ** sum(body.young * body.damping > limit for limit in VISCOUS)
    physics = physics or Physics()
    return run(World(body, script, physics, substeps), script, physics, steps=substeps, settle=settle)


def _poses(body):
    """(K, d, d) inverses of the rest edges: of a triangle in axes of which the first goes along its first edge."""
    edges = np.swapaxes(body.vertices[body.elements[:, 1:]] - body.vertices[body.elements[:, :1]], 1, 2)  # (K, 3, d)
    return np.linalg.inv(edges if body.dim == 3 else np.linalg.qr(edges)[1])
