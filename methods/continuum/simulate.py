"""Many values of a scene's numbers simulated as one batch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from ...physics.batch import Batch
from ...physics.stability import stable_rounds, stable_substeps
from ...physics.system import System
from ...physics.terms import CoulombGround, Gravity, SoftGrip
from ...physics.terms.base import Term
from .scene import Scene
from .unknowns import rounded_up

__all__ = ["GRIP", "Simulator"]

GRIP = ("shift_x", "shift_y", "shift_z", "reach")  # of each hand: m, and radius over the usual one
FIRM = 1500.0  # 1/s: what is held firmly follows within a millimetre; a hand that gives way is an effect
LIMITING = ("axial", "hinge", "facet", "solid", "viscous", "membrane", "plate", "grip", "touch")  # stages that limit substeps


@dataclass(frozen=True, eq=False)
class Simulator:
    """Runs of a scene.

    ``values`` are dicts with the values of the body's kind, any parameter of a term by its name, and for hand k ``grip<k>_shift_x, _y, _z``
    [m] and ``grip<k>_reach``; what is not there has its usual value. ``extra`` are further terms.
    """

    scene: Scene
    extra: tuple[Term, ...] = ()
    device: str = "cpu"

    @cached_property
    def system(self) -> System:
        """The system that all runs are copies of."""
        scene, grasp = self.scene, self.scene.grasp
        driven = scene.driven[scene.driven >= 0]
        holds, held = scene.points.holds.copy(), scene.points.held.copy()
        holds[grasp.points], held[grasp.points] = len(driven) + np.arange(len(grasp.points)), 1.0
        terms = [*scene.body.terms, Gravity(dict(zip(("gravity_x", "gravity_y", "gravity_z"), scene.gravity, strict=True)))]
        terms += [SoftGrip({"grip_rate": FIRM})]
        if scene.ground is not None:
            plane = [*scene.ground.normal, scene.ground.offset]
            names = [f"coulomb_{name}" for name in ("normal_x", "normal_y", "normal_z", "offset")]
            terms += [CoulombGround(dict(zip(names, plane, strict=True)))]
        return System(
            positions=scene.body.positions,
            velocities=scene.velocities,
            controllers=scene.paths()[:1],
            grips=np.concatenate([driven, np.full(len(grasp.points), -1)]),
            points=replace(scene.points, holds=holds, held=held),
            terms=[*terms, *self.extra],
            name=scene.name,
            **scene.body.parts,
        )

    def run(self, values, frames: int, controllers=None) -> np.ndarray:
        """(B, frames, M, 3) m, the structure points of each run, NaN from the frame on in which it diverged.

        ``controllers`` (T, C, 3) [m] move otherwise than in the recording, if given.
        """
        values = [self._complete(v) for v in values]
        substeps, rounds = np.array([self._steps(v) for v in values]).T
        batch = Batch([self.system] * len(values), fps=self.scene.fps, substeps=substeps, rounds=rounds, device=self.device)
        inputs = replace(batch.inputs, **self._inputs(batch, values, frames, controllers))
        with torch.no_grad():
            out = torch.cat([inputs.x[None], batch.march(0, frames - 1, inputs)[0]])
        return np.stack([self._observed(path) for path in batch.split(out)])

    def _complete(self, values):
        """``values`` with everything that terms and grips ask for."""
        return self.system.values | self.scene.body.complete(values)

    def _inputs(self, batch, values, frames, controllers):
        columns = [c for c in batch.columns if c in self.system.values]
        table = batch.inputs.table.clone()
        for row, one in enumerate(values):
            for column in columns:
                table[row, batch.column(column)] = one[column]
        path = self.scene.paths(controllers)[:frames]
        path = np.concatenate([path, np.repeat(path[-1:], max(0, frames - len(path)), 0)])
        held = np.tile(self.system.points.held, (len(values), 1))
        for row, one in zip(held, values, strict=True):
            row[self.scene.grasp.points] = self.scene.firmness(*self.grips(one))
        made = dict(dtype=batch.dtype, device=batch.device)
        return dict(table=table, path=torch.tensor(np.tile(path, (1, len(values), 1)), **made), held=torch.tensor(held.ravel(), **made))

    def grips(self, values):
        """(shift (H, 3) m, reach (H,)) of all hands."""
        numbers = [[values.get(f"grip{k}_{name}", float(name == "reach")) for name in GRIP] for k in range(len(self.scene.hands))]
        numbers = np.array(numbers).reshape(-1, len(GRIP))
        return numbers[:, :3], numbers[:, 3]

    def _steps(self, values):
        """(substeps, rounds) that are stable at ``values`` and at a stiffness and a damping a little above."""
        most = {name: values[name] for name in self.system.values}
        most |= self.scene.body.stiffest(values) | {"grip_rate": rounded_up(most["grip_rate"])}
        shown = [t for t in self.system.terms if t.stage in LIMITING]
        key = tuple(most[p.name] for t in shown for p in t.parameters if not p.name.endswith("friction"))
        if key not in self._known_steps:
            stiffest = self.system.with_values(**most)
            substeps = stable_substeps([stiffest], 1 / self.scene.fps)
            while True:
                try:
                    self._known_steps[key] = substeps, stable_rounds(stiffest, 1 / (self.scene.fps * substeps))
                    break
                except ValueError:
                    substeps = -int(-1.5 * substeps // 1)
        return self._known_steps[key]

    @cached_property
    def _known_steps(self) -> dict:
        return {}

    def _observed(self, path):
        """(T, M, 3) structure points of a path (T, N, 3) of the nodes, NaN once it blew up."""
        path = path.double().cpu().numpy()
        bad = ~(np.abs(path).max((1, 2)) < 1e3)
        if not bad.any():
            return self.scene.body.followed(path)
        whole = int(bad.argmax())
        found = self.scene.body.followed(np.concatenate([path[:whole], np.repeat(path[:1], len(path) - whole, 0)]))
        found[whole:] = np.nan
        return found
