"""Solids, ropes and sheets of ``continuum``, stepped live."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...methods.continuum.twin import ContinuumTwin
from ...physics.parameters import Parameter
from ...physics.terms.stages import GripTerm
from .engine import EngineLive
from .live import Edges
from .sliders import changed, offered

__all__ = ["ContinuumLive"]

SOON = "hands turn as they do now, and in a roll-out as smoothed over 0.2 s before and after"


class ContinuumLive(EngineLive):
    """A ``ContinuumTwin`` in motion.

    known  (T, C, 3) m, how controllers will move: for as long as they do, steps are the roll-out's to the last bit. Else a hand turns as
           its controllers do at that moment, while a roll-out looks at all of their path.
    """

    def __init__(self, twin: ContinuumTwin, known=None):
        scene = twin.scene
        self.twin, self.path, self.controllers, self.counts = twin, scene.controllers, scene.controllers[0], scene.counts
        self.known, self.note = None if known is None else np.asarray(known, float), SOON if known is None else ""
        self._values: dict[str, float] = {}
        first = self.path if self.known is None else self.known  # the start velocity belongs to how the recording goes on
        self.simulator, complete = twin.simulator.under(twin.values)
        self.fps = self.simulator.scene.fps
        self._ahead: Any = None if known is None else scene.paths(self.known)
        self.begin(*self.simulator.ready([complete], 2, first[:2]))
        self.positions = self.shown(self.nodes, self.controllers)

    def _set(self, values):
        self._values |= values
        own = {name: v for name, v in self._values.items() if name in self._own}
        simulator, complete = self.twin.simulator.under(self.twin.values | own)
        complete |= changed(self.twin.simulator.system, {k: v for k, v in self._values.items() if k not in own})
        self.simulator = simulator
        self.go_on(*simulator.ready([complete], 2, self.path[:2]))

    @property
    def _own(self):
        """What is fitted of the body's material."""
        body = self.twin.scene.body
        return {u.name: u for u in type(body).unknowns([body])}

    @property
    def parameters(self):
        now, found = self.twin.values | self._values, {}
        one = self.system.with_values(**{n: float(self.inputs.table[0, self.batch.column(n)]) for n in self.system.values})
        own = {n: u for n, u in self._own.items() if n in now}
        for name, u in own.items():
            found[name] = Parameter(name, float(np.clip(now[name], u.low, u.high)), u.low, u.high, u.unit, "of the material", u.scale)
        made = self.simulator.scene.body.complete(now).keys() if own else set()
        return found | {n: p for n, p in offered(one).items() if n not in found and n not in made - now.keys()}

    def row(self, controllers):
        scene, soon = self.simulator.scene, self.frame + 1
        if self.known is not None and soon < len(self.known) and np.array_equal(controllers, self.known[soon]):
            return self._ahead[soon]
        return scene.paths(np.stack([self.controllers, controllers]))[-1]

    def shown(self, nodes, controllers):
        scene = self.simulator.scene
        found, driven = scene.body.followed(nodes[None])[0], np.flatnonzero(scene.grips >= 0)
        found[scene.grips[driven]] = controllers[driven]
        return found.astype(np.float32)

    @property
    def edges(self):
        parts = self.simulator.scene.body.parts
        if parts.get("sheet") is not None:
            faces = parts["sheet"].triangles
            return Edges(_sides(faces), faces)
        if parts.get("grid") is not None:
            quads = _outside(parts["grid"].nodes)
            return Edges(np.unique(np.sort(_around(quads), axis=1), axis=0), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
        return Edges(parts["springs"])

    @property
    def mass(self):
        nodes = self.batch.split(self._numbers().mass[:, None])[0][:, 0].double().cpu().numpy()
        return self.of_particles(nodes)

    def of_particles(self, values):
        return _of_nearest(values, self.batch.systems[0].positions, self.simulator.scene.structure)

    @property
    def stiffness(self):
        for name, unit in (("youngs_modulus", "Pa"), ("membrane_stiffness", "N/m"), ("bending", "N m^2")):
            if name in self.parameters:
                return np.full(len(self.positions), self.parameters[name].value), unit
        return None

    def hand_forces(self):
        """Of soft grips on points of the body, shared evenly among the controllers of each hand."""
        scene, one, made = self.simulator.scene, self.system, self._numbers()
        hands, grasp = np.zeros((len(self.controllers), 3)), scene.grasp
        if not len(grasp.points):
            return hands
        x, v = self.points_now()
        driven = int((scene.driven >= 0).sum())
        own = slice(driven, driven + len(grasp.points))
        apart, rate = self.now.row[own] - x[grasp.points], (self.now.row - self._before.row)[own] * self.fps - v[grasp.points]
        mass = self.batch.constants["carries"].double().cpu().numpy()[grasp.points][:, None]
        held = made.held.double().cpu().numpy()[grasp.points][:, None]
        term = next(t for t in one.terms if isinstance(t, GripTerm))
        for k, hand in enumerate(scene.hands):
            of = grasp.hand == k
            force = term.twin(apart[of], rate[of], mass[of], k, **self.values_of(term)) * held[of]
            hands[hand.controllers] = force.sum(0) / max(1, len(hand.controllers))
        return hands


def _sides(faces):
    return np.unique(np.sort(np.concatenate([faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1), axis=0)


def _around(quads):
    return np.concatenate([quads[:, [a, (a + 1) % 4]] for a in range(4)])


QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])  # faces of a cell, seen from outside


def _outside(cells):
    """(Q, 4) the faces that belong to one of ``cells`` (K, 8) only."""
    quads = cells[:, QUADS].reshape(-1, 4)
    _, first, times = np.unique(np.sort(quads, axis=1), axis=0, return_index=True, return_counts=True)
    return quads[first[times == 1]]


def _of_nearest(values, places, points):
    from scipy.spatial import cKDTree

    return values[cKDTree(places).query(points)[1]]
