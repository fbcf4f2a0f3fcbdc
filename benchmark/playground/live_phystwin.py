"""PhysTwin's bodies, stepped live."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...methods.phystwin import transfer
from ...methods.phystwin.body import system, time_step
from ...methods.phystwin.twin import PhysTwinTwin
from ...physics.batch import Batch
from ...physics.parameters import Parameter
from ...physics.terms.stages import AxialTerm
from .engine import EngineLive
from .live import Edges
from .sliders import changed, offered

__all__ = ["PhysTwinLive"]

STIFFNESS = Parameter("stiffness", 1.0, 0.1, 10.0, "-", "of all springs of the body, over what was fitted", "log")


class PhysTwinLive(EngineLive):
    """A ``PhysTwinTwin`` in motion; ``known`` paths of its controllers make no difference to it."""

    def __init__(self, twin: PhysTwinTwin, known=None):
        place = twin.place
        self.twin, self.path, self.fps = twin, place.controllers, place.fps
        self.controllers, self.counts = place.controllers[0], place.counts
        self._values: dict[str, float] = {}
        batch = self._batch()
        self.begin(batch, batch.inputs)
        self.positions = self.nodes.astype(np.float32)

    def _batch(self) -> Batch:
        twin, fixed = self.twin, self.twin.transferred and self.twin.config.quirks.fixed_grip
        body = replace(twin.body, stiffness=twin.body.stiffness * self._values.get("stiffness", 1.0))
        one = system(body, replace(twin.place, controllers=self.controllers[None]), twin.config)
        if fixed and twin.place.self_collision:
            one = one.with_values(collision_dist=transfer.CONTACT)
        one = one.with_values(**changed(one, self._values))
        substeps, dt = (transfer.SUBSTEPS, transfer.STEP) if fixed else time_step([one], self.fps, twin.config)
        return Batch([one], fps=self.fps, substeps=substeps, dt=dt, device=twin.device)

    def _set(self, values):
        self._values |= values
        batch = self._batch()
        self.go_on(batch, batch.inputs)

    @property
    def parameters(self):
        return {"stiffness": replace(STIFFNESS, value=self._values.get("stiffness", 1.0))} | offered(self.system)

    def row(self, controllers):
        one = self.system
        held, found = np.flatnonzero(one.grips >= 0), np.array(controllers, float)
        found[held] += one.positions[one.grips[held]] - one.controllers[0, held]  # as ``Batch`` has it
        return found

    def shown(self, nodes, controllers):
        return nodes.astype(np.float32)

    @property
    def edges(self):
        return Edges(self.twin.body.springs)

    @property
    def stiffness(self):
        springs, stiffness = self.twin.body.springs, self.twin.body.stiffness * self._values.get("stiffness", 1.0)
        count = np.bincount(springs.ravel(), minlength=len(self.positions))
        return np.bincount(springs.ravel(), np.repeat(stiffness, 2), len(self.positions)) / np.maximum(count, 1), "N per strain"

    @property
    def mass(self):
        return self.batch.split(self._numbers().mass[:, None])[0][:, 0].double().cpu().numpy()

    def hand_forces(self):
        """Of the springs between controllers and particles."""
        one, made = self.system, self._numbers()
        tied = np.flatnonzero((one.springs >= len(one.positions)).any(1))
        hands = np.zeros((len(self.controllers), 3))
        if not len(tied):
            return hands
        hand, body = one.springs[tied].max(1) - len(one.positions), one.springs[tied].min(1)
        moving = (self.now.row - self._before.row) * self.fps * self.values_of_named("controller_velocity")
        v = self.batch.split(self.now.v)[0].double().cpu().numpy()
        apart = self.now.row[hand] - self.nodes[body]
        length = np.maximum(np.linalg.norm(apart, axis=1), 1e-6)
        along = apart / length[:, None]
        rate = ((moving[hand] - v[body]) * along).sum(1)
        rest, stiffness = (made.rest[tied].double().cpu().numpy(), made.stiffness[tied].double().cpu().numpy())
        tension = np.zeros(len(tied))
        for term in (t for t in one.terms if isinstance(t, AxialTerm)):
            tension += term.twin(length, rate, rest, stiffness, **self.values_of(term))
        np.add.at(hands, hand, tension[:, None] * along)
        return hands

    def values_of_named(self, name: str) -> float:
        return float(self.inputs.table[0, self.batch.column(name)]) if name in self.system.values else 0.0
