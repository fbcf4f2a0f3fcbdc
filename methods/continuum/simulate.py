"""Many values of a scene's numbers simulated as one batch."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch

from ...datasets.scenario import Observed
from ...physics.batch import Batch
from ...physics.latest import Latest
from ...physics.penetrations import Penetrations, penetrations
from ...physics.side_by_side import side_by_side
from ...physics.stability import stable_stepping
from ...physics.system import FILLED, System
from ...physics.terms import CoulombGround, Gravity, LayerContact, SoftGrip
from ...physics.terms.base import Term
from ...physics.terms.stages import EASED
from .bodies import Body
from .scene import SAME, Scene
from .unknowns import rounded_up
from .unloaded import SAID

__all__ = ["GRIP", "Simulator"]

GRIP = ("shift_x", "shift_y", "shift_z", "reach")  # of each hand: m, and radius over the usual one
FIRM = 1500.0  # 1/s: what is held firmly follows within a millimetre; a hand that gives way is an effect
HARD = 0.5  # of the highest angular frequency of the body, that of contact with itself: such a node is 1.25 times as stiff
LONGEST = 600  # frames
FAR = 1e3  # m
STILL = 5e-5  # m/s, RMS at a peak: what swings twice a second is within 4 um of its rest, and float32 still tells that from its errors
SHORTER = (2, 8)  # times as many steps for runs that blow up: a cell that is crushed to half its width is some ten times as stiff
LAUNCHES = 2  # corrections of a start velocity, where they help: in each a motion of a tenth of a period a frame is met to a tenth
LIMITING = (
    "setup",
    "axial",
    "hinge",
    "facet",
    "solid",
    "membrane",
    "plate",
    "sheet_branch",
    "hinge_branch",
    "grip",
    "touch",
)  # stages that limit substeps


@dataclass(frozen=True, eq=False)
class Simulator:
    """Runs of a scene.

    ``values`` are dicts with the values of the body's kind, any parameter of a term by its name, and for hand k ``grip<k>_shift_x, _y, _z``
    [m] and ``grip<k>_reach``; ``frame_rate`` [1/s] where the scene's is not known; what is not there has its usual value.
    ``extra`` are further terms.
    """

    scene: Scene
    extra: tuple[Term, ...] = ()
    device: str = "cpu"
    latest: Latest[Batch] = field(default_factory=Latest, init=False, repr=False)
    unpulled: Latest[np.ndarray] = field(default_factory=Latest, init=False, repr=False)  # where nodes rest without further pulls

    @cached_property
    def system(self) -> System:
        """The system that all runs are copies of."""
        scene, grasp = self.scene, self.scene.grasp
        driven = scene.driven[scene.driven >= 0]
        holds, held = scene.points.holds.copy(), scene.points.held.copy()
        soft, fastened = np.full(len(grasp.points), -1), scene.fastened[0]
        holds[grasp.points], held[grasp.points] = len(driven) + np.arange(len(grasp.points)), 1.0
        terms = [*scene.body.terms, Gravity(dict(zip(("gravity_x", "gravity_y", "gravity_z"), scene.gravity, strict=True)))]
        terms += [SoftGrip({"grip_rate": FIRM, "firm_rate": FIRM})]
        if scene.ground is not None:
            plane = [*scene.ground.normal, scene.ground.offset]
            names = [f"coulomb_{name}" for name in ("normal_x", "normal_y", "normal_z", "offset")]
            terms += [CoulombGround(dict(zip(names, plane, strict=True)))]
        if scene.contact:
            terms += [LayerContact({"layer_thickness": scene.body.thickness})]
        return System(
            positions=scene.body.positions,
            velocities=FILLED if scene.velocities is None else scene.velocities,
            controllers=scene.paths()[:1],
            grips=np.concatenate([driven, soft, fastened]),
            hands=np.concatenate([len(scene.hands) + np.arange(len(driven)), grasp.hand, scene.fastened[1]]),
            points=replace(scene.points, holds=holds, held=held),
            terms=[*terms, *map(scene.tell, self.extra)],
            name=scene.name,
            **scene.body.parts,
        )

    def run(self, values, frames: int, controllers=None) -> np.ndarray:
        """(B, frames, M, 3) m, the structure points of each run, NaN from the frame on in which it diverged.

        ``controllers`` (T, C, 3) [m] move otherwise than in the recording, if given; (B, T, C, 3) in each run in its own way.
        """
        rates = np.array([v.get("frame_rate", self.scene.fps) for v in values])
        if (rates != self.scene.fps).any():
            return self._timed(values, rates, frames, controllers)
        values = [self._complete(v) for v in values]
        bodies = side_by_side(self._body, values, self.device)
        alike = [k for k, body in enumerate(bodies) if body is self.scene.body]
        if len(alike) == len(values):
            return self._alike(values, frames, controllers)
        found = np.full((len(values), frames, *self.scene.structure.shape), np.nan)
        if alike:
            found[alike] = self._alike([values[k] for k in alike], frames, _of_runs(controllers, alike))

        def alone(k):  # frame 0 is under another strain in each
            return self._of(bodies[k], self._known_steps)._alike([values[k]], frames, _of_runs(controllers, [k]))[0]

        others = [k for k, body in enumerate(bodies) if body is not None and body is not self.scene.body]
        for k, path in zip(others, side_by_side(alone, others, self.device), strict=True):
            found[k] = path
        return found

    def _alike(self, values, frames, controllers) -> np.ndarray:
        """(B, frames, M, 3) m, runs of the scene's body as it is, of complete ``values``."""
        paths = self._nodes(values, frames, controllers)
        return np.stack([self._observed(path, self._is_recorded(controllers, k)) for k, path in enumerate(paths)])

    def _body(self, values) -> Body | None:
        """The body in frame 0 under complete ``values``; None where it would not lie there.

        Where frame 0 is an equilibrium, it is one under what further terms say pulls at the body: how far that moves it, once with the
        pull and once without, is how far its rest shape is from frame 0 beside what gravity makes of it.
        """
        body = self.scene.body.under(values)
        try:
            body = self._laden(body, values)
            if body is not self.scene.body:
                _ = body.points  # where they are at rest is looked for here, once for a body
        except ValueError:  # it does not come to rest, or cells are turned over there
            return None
        return body

    def _laden(self, body: Body, values) -> Body:
        pulls = {name: 0.0 for term in self.extra for name in term.loads if values[name]}
        if not (pulls and self.scene.still and body.bears):
            return body
        there = self._of(body, self._known_steps)
        pulling = {p.name for term in self.extra if term.loads for p in term.parameters}
        own = tuple((name, value) for name, value in sorted(values.items()) if name not in pulling)
        rest = self.unpulled.of(own, lambda: there.settle(values | pulls))
        return body.laden(there.settle(values) - rest, values)

    def penetrations(self, values, frames: int) -> Penetrations:
        """How far layers or strands went into each other in a run."""
        rate = values.get("frame_rate", self.scene.fps)
        if rate != self.scene.fps:
            return replace(self, scene=replace(self.scene, fps=rate)).penetrations(values, frames)
        one = self._complete(values)
        other = self._of(self._body(one) or self.scene.body, self._known_steps)
        return penetrations(self.system, other._nodes([one], frames)[0].double().cpu().numpy(), self.scene.body.thickness)

    def _nodes(self, values, frames, controllers=None):
        """Paths (frames, N, 3) m of the nodes, for each of complete ``values``; one that blows up is run again in shorter steps.

        Steps are chosen where a body is at rest. Cells that are crushed or folded are stiffer, slivers among them most.
        """
        found, lost = list(self._marched(values, frames, controllers)), range(len(values))
        for times in SHORTER:
            lost = [k for k in lost if not _sane(found[k]).all()]
            if not lost:
                break
            again = self._marched([values[k] for k in lost], frames, _of_runs(controllers, lost), times=times)
            for k, path in zip(lost, again, strict=True):
                found[k] = path
        return found

    def _marched(self, values, frames, controllers, times=1):
        batch, inputs = self.ready(values, frames, controllers, times)
        with torch.no_grad():
            return batch.split(torch.cat([inputs.x[None], batch.march(0, frames - 1, inputs)[0]]))

    def ready(self, values, frames, controllers=None, times=1):
        """(the batch of complete ``values``, with ``times`` as many substeps as usual; its inputs at the start)."""
        batch, inputs = self._batch(values, frames, controllers, times)
        with torch.no_grad():
            if self.scene.launch is not None and self.scene.launch.field is not None:
                inputs = replace(inputs, v=self._corrected(batch, inputs))
        return batch, inputs

    def steps(self, values) -> tuple[int, int]:
        """(substeps a frame, rounds of damping a substep) with which ``values`` are run."""
        return self._steps(self._complete(values))

    def under(self, values) -> tuple[Simulator, dict[str, float]]:
        """(the simulator of the body under ``values`` at their frame rate, complete values): what ``run`` runs them by."""
        rate, one = values.get("frame_rate", self.scene.fps), self._complete(values)
        other = self._of(self._body(one) or self.scene.body, self._known_steps)
        if rate != self.scene.fps:
            other = replace(other, scene=replace(other.scene, fps=float(rate)))
            vars(other).update(system=self.system, _known_steps={}, _rate_of_steps=_no_faster(rate))
        return other, one

    def _timed(self, values, rates, frames, controllers):
        """What ``run`` returns where frames come at ``rates`` (B,) a second, those of one rate together."""
        found: list[Any] = [None] * len(values)
        for rate in np.unique(rates):
            own, known_steps = np.flatnonzero(rates == rate), self._known_rates.setdefault(_no_faster(rate), {})
            other = replace(self, scene=replace(self.scene, fps=float(rate)))
            vars(other).update(system=self.system, _known_steps=known_steps, _rate_of_steps=_no_faster(rate))
            for k, path in zip(own, other.run([values[k] for k in own], frames, _of_runs(controllers, own)), strict=True):
                found[k] = path
        return np.stack(found)

    def settle(self, values) -> np.ndarray:
        """(N, 3) m, where the nodes come to rest while hands stay as they are in frame 0.

        By dynamic relaxation: whenever the kinetic energy has passed a peak, all is stopped (Day 1965; Cundall 1976). Raises ValueError
        where the body falls apart, or still moves after ``LONGEST`` frames.
        """
        batch, inputs = self._batch([self._complete(values)], 1)
        share, before = (inputs.mass / inputs.mass.sum())[:, None], 0.0
        with torch.no_grad():
            for _ in range(LONGEST):
                _, x, v, carried = batch.march(0, 1, inputs, whole=True)
                inputs = replace(inputs, x=x, v=v, **vars(carried))
                energy = float((share * v * v).sum())
                if energy < before:
                    if before < STILL**2:
                        return batch.split(x)[0].double().cpu().numpy()
                    inputs, energy = replace(inputs, v=torch.zeros_like(v)), 0.0
                before = energy
        raise ValueError(f"a body must come to rest where it is held, but moved after {LONGEST} frames (scenario {self.scene.name})")

    def unloaded(self, recording: Observed, values) -> Scene:
        """The scene, which is ``recording``'s, with a rest shape such that frame 0 is an equilibrium at ``values``.

        What has a start velocity is in no equilibrium, and keeps its shape. Raises ValueError as ``Body.unloaded`` does.
        """
        scene = self.scene
        if scene.speeds is not None:
            note = f"{SAID} that of frame 0 as it lies, since it moves there"
            return replace(scene, notes=(*(n for n in scene.notes if n != note), note))
        body = scene.body.unloaded(recording, self._complete(values), lambda body: self._of(body).settle(values))
        return replace(scene, body=body, notes=(*body.notes, *(n for n in scene.notes if n not in scene.body.notes)))

    def _of(self, body, known_steps=None) -> Simulator:
        """The same of another body, whose substeps are ``known_steps``' if they are given."""
        other = replace(self, scene=replace(self.scene, body=body))
        if known_steps is not None:
            vars(other)["_known_steps"] = known_steps
        return other

    def _batch(self, values, frames, controllers=None, times=1):
        """(the batch of complete ``values``, with ``times`` as many substeps as usual, its inputs)."""
        substeps, rounds = np.array([self._steps(v) for v in values]).T
        substeps = times * substeps

        def made():
            return Batch([self.system] * len(values), fps=self.scene.fps, substeps=substeps, rounds=rounds, device=self.device)

        batch = self.latest.of((substeps.tobytes(), rounds.tobytes()), made)
        return batch, replace(batch.inputs, **self._inputs(batch, values, frames, controllers))

    def _corrected(self, batch, inputs):
        """(nodes, 3) m/s at the start, with which tracks go as far as they were seen to go until frame 1.

        Two frames tell the mean velocity between them. A body that has just been let go and starts with that is half a frame's fall too
        fast, so that what a run of one frame misses is added.
        """
        launch, speed = self.scene.launch, torch.zeros_like(inputs.v)
        assert launch is not None and launch.field is not None  # who comes here has asked
        goal = launch.field.seen(launch.velocity)
        best: list[tuple[Any, Any, Any]] = [(np.inf, np.zeros_like(launch.velocity), None)] * len(
            batch.systems
        )  # (missed, m/s of the nodes, of the tracks)
        tried = [launch.velocity] * len(best)
        for _ in range(LAUNCHES + 1):
            for own, one in zip(batch.split(speed), tried, strict=True):
                own[:] = torch.as_tensor(one)
            gone = (batch.march(0, 1, replace(inputs, v=speed))[0][0] - inputs.x) * self.scene.fps
            for k, far in enumerate(batch.split(gone)):
                missed = goal - launch.field.seen(far.double().cpu().numpy())
                if (size := np.abs(missed).mean()) < best[k][0]:  # a run that diverged has NaN, which is never less
                    best[k] = size, tried[k], missed
                _size, own, missed = best[k]
                tried[k] = own if missed is None else own + launch.field.solve(missed, launch.steady)
        for own, (_size, one, _missed) in zip(batch.split(speed), best, strict=True):
            own[:] = torch.as_tensor(one)
        return speed

    def _complete(self, values):
        """``values`` with everything that terms and grips ask for."""
        return self.system.values | self.scene.body.complete(values)

    def _inputs(self, batch, values, frames, controllers):
        columns = [c for c in batch.columns if c in self.system.values]
        table = batch.inputs.table.clone()
        for row, one in enumerate(values):
            for column in columns:
                table[row, batch.column(column)] = one[column]
        if self.scene.contact:  # at half of the highest frequency that the substeps are chosen for, which then need not be shorter
            table[:, batch.column("layer_rate")] = torch.as_tensor(HARD * self.scene.fps * batch.substeps)
        each = controllers if np.ndim(controllers) == 4 else [controllers]
        path = np.concatenate([_lasting(self.scene.paths(one), frames) for one in each], 1)
        points = self.system.points
        assert points is not None  # bodies of this method have them
        held = np.tile(points.held, (len(values), 1))
        for row, one in zip(held, values, strict=True):
            row[self.scene.grasp.points] = self.scene.firmness(*self.grips(one))
        made = dict(dtype=batch.dtype, device=batch.device)
        return dict(
            table=table, path=torch.tensor(np.tile(path, (1, len(values) // len(each), 1)), **made), held=torch.tensor(held.ravel(), **made)
        )

    def grips(self, values):
        """(shift (H, 3) m, reach (H,)) of all hands."""
        numbers = [[values.get(f"grip{k}_{name}", float(name == "reach")) for name in GRIP] for k in range(len(self.scene.hands))]
        numbers = np.array(numbers).reshape(-1, len(GRIP))
        return numbers[:, :3], numbers[:, 3]

    def _steps(self, values):
        """(substeps, rounds) that are stable at ``values`` and at a stiffness and a damping a little above."""
        most = {name: values[name] for name in self.system.values}
        most |= self.scene.body.stiffest(values) | {"grip_rate": rounded_up(most["grip_rate"])}
        most["grip_hand"] = min(most["grip_hand"], 0.0)  # which hand it is does not matter
        shown = [t for t in self.system.terms if t.stage in (*LIMITING, *EASED)]
        key = tuple(most[p.name] for t in shown for p in t.parameters if not p.name.endswith("friction"))
        if key not in self._known_steps:
            stiffest = self.scene.body.stiffened(self.system.with_values(**most), most)
            stiffest = replace(stiffest, terms=[t for t in stiffest.terms if t.stage != "layer"])
            self._known_steps[key] = stable_stepping(stiffest, 1 / self._rate_of_steps, safety=self.scene.body.stride)
        return self._known_steps[key]

    @cached_property
    def _known_steps(self) -> dict:
        return {}

    @cached_property
    def _known_rates(self) -> dict:
        """Of each rate the steps that are known."""
        return {}

    @cached_property
    def _rate_of_steps(self) -> float:
        """Frames a second by which substeps are chosen."""
        return self.scene.fps

    def _is_recorded(self, controllers, run: int) -> bool:
        """Whether ``controllers``, in a ``run``, move as in the recording, as far as that goes."""
        if controllers is None:
            return True
        own, there = controllers[run] if np.ndim(controllers) == 4 else controllers, self.scene.controllers
        frames = min(len(own), len(there))
        return own.shape[1:] == there.shape[1:] and bool(np.abs(own[:frames] - there[:frames]).max(initial=0.0) < SAME)

    def _observed(self, path, recorded: bool):
        """(T, M, 3) structure points of a path (T, N, 3) of the nodes, in hands as they were ``recorded`` or not, NaN once it blew up."""
        body = self.scene.body if recorded else self.scene.body.unwatched
        bad = ~_sane(path).cpu().numpy()
        path = path.double().cpu().numpy()
        if not bad.any():
            return body.followed(path)
        whole = int(bad.argmax())
        found = body.followed(np.concatenate([path[:whole], np.repeat(path[:1], len(path) - whole, 0)]))
        found[whole:] = np.nan
        return found


def _sane(path):
    """(T,) bool, the frames of a path (T, N, 3) m in which everything is somewhere: nothing is NaN or kilometres away."""
    return path.abs().amax((1, 2)) < FAR


def _of_runs(controllers, runs):
    """Those of some runs, where runs have controllers (B, T, C, 3) of their own."""
    return controllers[np.asarray(runs, int)] if np.ndim(controllers) == 4 else controllers


def _lasting(path, frames):
    """(frames, ...) of ``path``, whose last frame lasts."""
    return np.concatenate([path[:frames], np.repeat(path[-1:], max(0, frames - len(path)), 0)])


def _no_faster(rate):
    """A rate of frames at most a tenth lower, the same for all that are near: a search keeps its substeps."""
    return 1 / rounded_up(1 / rate)
