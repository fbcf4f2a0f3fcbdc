"""A system of the simulator stepped frame by frame, and the forces that act on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from ...methods.base import Diverged
from ...physics.batch import Batch, Carried, first_bad
from ...physics.march import MEMORIES, World
from ...physics.system import System
from ...physics.terms.stages import TouchTerm
from .live import Forces, Live
from .stress import node_stress

__all__ = ["EngineLive", "Moment"]

RETRIES = 2  # times that a frame that blows up is tried again in substeps half as long


@dataclass(frozen=True)
class Moment:
    """The state in ``frame``: ``x``, ``v`` (nodes, 3), what is ``carried``, and ``row`` (P, 3) m, where driven nodes are."""

    frame: int
    x: torch.Tensor
    v: torch.Tensor
    carried: Carried
    row: np.ndarray


class EngineLive(Live):
    """``batch`` of one system and the ``inputs`` of its march, whose path is what the controllers do.

    Subclasses say how their controllers move the driven nodes (``row``), and where their particles are (``shown``).
    """

    batch: Batch
    now: Moment

    def begin(self, batch: Batch, inputs) -> None:
        """Start at ``inputs``."""
        self.batch, self.inputs = batch, inputs
        self.now = Moment(0, inputs.x, inputs.v, Carried.of(inputs), inputs.path[0].double().cpu().numpy())
        self._before = self.now
        # laws that remember, or are late, are told the time and all of the path; the others only where controllers are and will be
        self._timed = batch.remembering or any(t.name == "controller_delay" for t, _ in batch.laws.stage("setup"))
        self._rows = [self.now.row]

    def go_on(self, batch: Batch, inputs) -> None:
        """Go on from where it is with another batch of as many nodes."""
        self.batch, self.inputs = batch, inputs

    @property
    def system(self) -> System:
        return self.batch.systems[0]

    @property
    def substeps(self) -> int:
        return int(self.batch.substeps[0])

    @property
    def frame(self) -> int:
        return self.now.frame

    def row(self, controllers) -> np.ndarray:
        """(P, 3) m of the engine's path while controllers are at ``controllers`` (C, 3)."""
        raise NotImplementedError

    def shown(self, nodes: np.ndarray, controllers) -> np.ndarray:
        """(M, 3) float32 m of the particles while the nodes are at ``nodes`` (N, 3)."""
        raise NotImplementedError

    def finer(self, times: int) -> Batch:
        """The batch with ``times`` as many substeps."""
        one = self.batch
        return Batch(
            [self.system],
            fps=one.fps,
            substeps=int(one.substeps[0]) * times,
            dt=float(one.dt[0]) / times,
            rounds=one.rounds.tolist(),
            device=str(one.device),
        )

    def step(self, controllers):
        controllers = np.asarray(controllers, float)
        row, past = self.row(controllers), self._rows[: self.frame + 1]
        for attempt in range(RETRIES + 1):
            after = self._march(self.batch if not attempt else self.finer(2**attempt), past, row)
            if after is not None:
                break
        else:
            raise Diverged(
                f"the simulation blew up in frame {self.frame + 1}, also in substeps {2**RETRIES} times as short", self.frame + 1
            )
        self.positions = self.shown(self.batch.split(after.x)[0].double().cpu().numpy(), controllers)
        self._before, self.now = self.now, after
        self._rows = [*past, row] if self._timed else [row]

    def _march(self, batch, past, row) -> Moment | None:
        now = self.now
        rows = [*past, row] if self._timed else [now.row, row]
        path = torch.tensor(np.stack(rows), dtype=batch.dtype, device=batch.device)
        inputs = replace(self.inputs, path=path, x=now.x, v=now.v, **vars(now.carried))
        with torch.no_grad():
            out, x, v, carried = batch.march(now.frame if self._timed else 0, 1, inputs, whole=True)
        if first_bad(batch.split(out)[0]) >= 0:
            return None
        changes = {"memory": batch.remembering} | {m.name: getattr(batch, m.kept) for m in MEMORIES}
        same = {name: getattr(now.carried, name) for name, change in changes.items() if not change}  # many moments are kept
        return Moment(now.frame + 1, x, v, replace(carried, **same), row)

    @property
    def state(self):
        return self.now, self._before, self.positions, tuple(self._rows)

    @state.setter
    def state(self, value):
        self.now, self._before, self.positions, rows = value
        self._rows = list(rows)

    # ---------------------------------------------------------------- what it looks like

    @property
    def nodes(self):
        return self.batch.split(self.now.x)[0].double().cpu().numpy()

    @property
    def stress(self):
        """Of the elasticity at this moment, at the node that is nearest to a particle."""
        made, carried, batch = self._numbers(), self.now.carried, self.batch
        one = self.system.with_values(**{n: float(self.inputs.table[0, self.batch.column(n)]) for n in self.system.values})
        springs = dict(rest=made.rest.double().cpu().numpy(), stiffness=made.stiffness.double().cpu().numpy())
        known = {}
        if batch.cells_remembering:
            known = dict(memory=carried.cell_memory.double().cpu().numpy().reshape(*carried.cell_memory.shape[:2], -1, 3, 3))
        if batch.sheets_remembering:
            known = dict(memory=carried.sheet_memory.double().cpu().numpy().reshape(len(carried.sheet_memory), -1, 2, 3)[:, :, 0])
        found = node_stress(one, self.nodes, **springs, **known)
        return None if found is None else (self.of_particles(found[0]), found[1])

    def of_particles(self, values: np.ndarray) -> np.ndarray:
        """(M,) of ``values`` (N,) at nodes."""
        return values

    # ---------------------------------------------------------------- forces

    def forces(self) -> Forces:
        """Of hands at this moment; of the ground at this moment where it is a force, and over the last frame where it is impulses."""
        places, contact = self._touching() if self.batch.touching else self._bounced()
        return Forces(self.hand_forces(), places, contact)

    def hand_forces(self) -> np.ndarray:
        """(C, 3) N on the body."""
        raise NotImplementedError

    def _numbers(self):
        batch = self.batch
        with torch.no_grad():
            return batch.prepare(replace(self.inputs, x=self.now.x, v=self.now.v, path=self.inputs.path[:1]))

    def values_of(self, term) -> dict[str, float]:
        """A term's values in this batch's table."""
        table = self.inputs.table[0].double().cpu().numpy()
        return {name: float(table[self.batch.column(name)]) for name in term.values}

    def points_now(self) -> tuple[np.ndarray, np.ndarray]:
        """(P, 3) m and m/s of the material points."""
        points, v = self.system.points, self.batch.split(self.now.v)[0].double().cpu().numpy()
        assert points is not None  # of bodies that have them
        return points.positions(self.nodes), points.positions(v)

    def _touching(self):
        """Each term's force law at each point of the skin that it acts on, after the bristles that the ground holds it by."""
        x, v = self.points_now()
        anchor, mass = self.now.carried.anchor.double().cpu().numpy(), self.batch.constants["carries"].double().cpu().numpy()
        total, points = np.zeros_like(x), self.system.points
        assert points is not None  # of bodies that have them
        for term in (t for t in self.system.terms if isinstance(t, TouchTerm)):
            values = self.values_of(term)
            skin = np.flatnonzero(points.areas > 0)
            for q in skin[_near(values, x[skin])]:
                total[q] += term.twin(x[q], v[q], mass[q], anchor[q], *values.values())
        met = np.flatnonzero(np.abs(total).max(1) > 0)
        return x[met], total[met]

    def _bounced(self):
        """The last frame again with every substep kept: what the ground gave each node, on average over the frame."""
        batch, before, count = self.batch, self._before, int(self.batch.substeps[0])
        if before is self.now or not batch.laws.stage("move") or batch.easing:
            return np.zeros((0, 3)), np.zeros((0, 3))
        path = torch.tensor(np.stack([before.row, self.now.row]), dtype=batch.dtype, device=batch.device)
        inputs = batch.prepare(replace(self.inputs, path=path, x=before.x, v=before.v, **vars(before.carried)))
        values = {k: t.detach().contiguous() for k, t in vars(inputs).items()}
        impulse = torch.zeros_like(before.x)
        with torch.no_grad():
            for world, substeps in _kept(batch, values, count):
                free = world.tensors["met" if batch.colliding else "free"][:substeps]
                impulse += (world.states[1 : substeps + 1, :, 4:7] - free).sum(0)
        frame = float(batch.dt[0]) * count
        own = batch.split(impulse * values["mass"][:, None] / frame)[0].double().cpu().numpy()
        held = self.system.grips[self.system.grips >= 0]
        own[held] = 0
        met = np.flatnonzero(np.abs(own).max(1) > 0)
        return self.nodes[met], own[met]


def _near(values, x):
    """Which of points (P, 3) are so near a plane of ``values`` that its law may act, all where they name none."""
    plane = [next((v for name, v in values.items() if name.endswith(end)), None) for end in ("normal_x", "normal_y", "normal_z", "offset")]
    return slice(None) if None in plane else np.flatnonzero(x @ np.array(plane[:3]) - plane[3] < 0)


def _kept(batch, values, count):
    """Worlds of a frame's stretches with all their states, and the substeps of each."""
    from ...physics.contacts import seek
    from ...physics.march import STATE

    state, out = {k: values[k] for k in STATE}, torch.empty((1, *values["x"].shape), dtype=batch.dtype, device=batch.device)
    near = None
    for stretch in batch.stretches(1, history=True):
        if batch.colliding and stretch.horizon is not None:
            near = seek(batch, state["x"], values["table"])()
        world = World(batch, values, state, near, None, stretch.history, out)
        batch.forward(world, 0, stretch)
        yield world, int(stretch.count[0])
        state = world.end(stretch)
