"""The fitted twin: a scene and the numbers that were found for it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...datasets.scenario import Observed, Plane
from ...physics import terms
from ...physics.grids import Grid
from ...physics.terms.base import Term
from ..base import Diverged, Trajectory, Twin
from ..registration import align, rigid_transform
from .body import body_of
from .hands import Hand
from .scene import REACH, Equilibrium, Scene, posed
from .simulate import Simulator
from .unloaded import unloaded
from .velocity import Launch

__all__ = ["ContinuumTwin"]

ALIKE = 0.1  # of a body's size, RMS: frame 0 of another recording that is farther from the rest shape is taken for the rest shape itself


@dataclass(frozen=True, eq=False)
class ContinuumTwin(Twin):
    """``values`` by name, as ``Simulator`` takes them; ``extra`` terms of its physics.

    posterior  names, values and covariance of what was fitted, in the scaled space of the unknowns (``result.Fit``), for intervals
    """

    scene: Scene
    values: dict[str, float]
    extra: tuple[Term, ...] = ()
    posterior: dict = field(default_factory=dict)
    device: str = "cpu"
    looks_ahead = True  # how far a controller is trusted depends on all of its path

    @property
    def note(self) -> str:
        return "; ".join(dict.fromkeys(self.scene.notes))

    @cached_property
    def simulator(self) -> Simulator:
        return Simulator(self.scene, self.extra, self.device)

    def rollout(self, controllers: np.ndarray) -> Trajectory:
        controllers = np.asarray(controllers, float)
        scene = self.scene
        if controllers.ndim != 3 or controllers.shape[1:] != scene.controllers.shape[1:]:
            raise ValueError(f"controllers must have shape (T, {scene.controllers.shape[1]}, 3), got {controllers.shape}")
        path = self.simulator.run([self.values], len(controllers), scene.led(controllers))[0]
        bad = ~np.isfinite(path).all((1, 2))
        if bad.any():
            raise Diverged(f"the simulation blew up in frame {bad.argmax()}", int(bad.argmax()))
        driven = np.flatnonzero(scene.grips >= 0)
        path[:, scene.grips[driven]] = controllers[:, driven]
        return Trajectory(path.astype(np.float32), scene.counts)

    def retarget(self, target: Observed) -> ContinuumTwin:
        """The same body and material in ``target``'s frame 0, held by its hands there.

        The rest shape is moved rigidly to where the target's points lie; where they are shaped otherwise it is taken from them instead.
        Of ``target`` only frame 0 and the controllers are looked at: what hands hold there is told by distance. It starts at rest, unless
        exactly two frames are given, as ``Scenario.start_frames`` may declare: then as fast as they say.
        """
        scene, given, target = self.scene, target, _initial(target)
        outer = sum(scene.counts[:2])
        cloud = target.structure[: sum(target.counts[:2])]
        laid = align(scene.structure, cloud, surface=outer)
        apart = np.sqrt(np.mean(_nearest(laid[:outer], cloud) ** 2))
        if apart < ALIKE * np.linalg.norm(np.ptp(cloud, axis=0)):
            rotation, shift = rigid_transform(scene.structure, laid)
            grid, surface, area = posed(scene.grid, rotation, shift), scene.surface @ rotation.T + shift, scene.area
            notes, same = (), scene.equilibrium
            same = same and replace(same, nodes=same.nodes @ rotation.T + shift)
        else:
            body = body_of(target, kind="solid", pitch=float(scene.grid.size.mean()))
            grid, surface, area, same = body.grid, body.surface, body.area, None
            notes = ("its rest shape is taken from this recording: it is shaped otherwise there than where it was fitted",)
        there = replace(Scene.in_grid(target, grid, surface, area, notes), equilibrium=same)
        values = {name: v for name, v in self.values.items() if not name.startswith("grip") or name in ("grip_rate", "grip_damping")}
        wide = [self.values.get(f"grip{k}_reach", 1.0) * radius for k, radius in enumerate(scene.grips_at[1]) if len(scene.hands[k].points)]
        if wide:  # hands hold as much there as they were found to hold here
            typical = float(np.exp(np.mean(np.log(wide))))
            values |= {f"grip{k}_reach": float(np.clip(typical / r, 1 / REACH, REACH)) for k, r in enumerate(there.grips_at[1])}
        if scene.equilibrium and not same:
            there = unloaded(there, body, values, extra=self.extra, device=self.device)
        if given.observed_frames == 2:
            there = there.starting(given, "frames")
        return replace(self, scene=there, values=values)

    def save(self, folder: Path) -> None:
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        scene, grid = self.scene, self.scene.grid
        arrays = {f"grid_{f.name}": getattr(grid, f.name) for f in fields(Grid)}
        arrays |= {name: getattr(scene, name) for name in ("surface", "structure", "controllers", "grips", "gravity", "weights")}
        for k, hand in enumerate(scene.hands):
            arrays |= {f"hand{k}_{f.name}": getattr(hand, f.name) for f in fields(Hand) if f.name not in ("turns", "notes")}
        state = {name: getattr(scene, name) for name in ("name", "area", "counts", "radius", "fps", "notes")}
        state |= dict(turns=[h.turns for h in scene.hands], hand_notes=[h.notes for h in scene.hands])
        state |= dict(ground=None if scene.ground is None else [*scene.ground.normal.tolist(), scene.ground.offset])
        state |= dict(
            values=self.values, extra={type(t).__name__: t.values for t in self.extra}, posterior=self.posterior, device=self.device
        )
        if scene.launch is not None:
            arrays |= {f"launch_{f.name}": getattr(scene.launch, f.name) for f in fields(Launch)}
        if scene.equilibrium is not None:
            arrays |= {f"equilibrium_{f.name}": getattr(scene.equilibrium, f.name) for f in fields(Equilibrium)}
        np.savez_compressed(folder / "twin.npz", **arrays)
        (folder / "twin.json").write_text(json.dumps(state, indent=1), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> ContinuumTwin:
        folder = Path(folder)
        state = json.loads((folder / "twin.json").read_text(encoding="utf-8"))
        with np.load(folder / "twin.npz", allow_pickle=False) as file:
            arrays = dict(file)
        grid = Grid(**{f.name: arrays[f"grid_{f.name}"] for f in fields(Grid)})
        hands = []
        for k, (turns, notes) in enumerate(zip(state["turns"], state["hand_notes"], strict=True)):
            own = {f.name: arrays[f"hand{k}_{f.name}"] for f in fields(Hand) if f.name not in ("turns", "notes")}
            hands.append(Hand(**own, turns=turns, notes=tuple(notes)))
        ground = None if state["ground"] is None else Plane(np.array(state["ground"][:3]), state["ground"][3])
        known = {name: arrays[name] for name in ("surface", "structure", "controllers", "grips", "gravity", "weights") if name in arrays}
        known |= {name: state[name] for name in ("name", "area", "radius", "fps")}
        for kind in (Launch, Equilibrium):
            name = kind.__name__.lower()
            own = {f.name: arrays.get(f"{name}_{f.name}") for f in fields(kind)}
            known[name] = None if any(value is None for value in own.values()) else kind(**own)
        scene = Scene(grid=grid, hands=tuple(hands), ground=ground, counts=tuple(state["counts"]), notes=tuple(state["notes"]), **known)
        extra = tuple(getattr(terms, name)(values) for name, values in state["extra"].items())
        return cls(scene, state["values"], extra, state["posterior"], state["device"])


def posterior_of(estimate) -> dict:
    """What a twin keeps of an ``Estimate``, as JSON has it."""
    found = estimate.fit
    return dict(
        unknowns=[asdict(u) for u in found.unknowns],
        scaled=found.scaled.tolist(),
        covariance=found.covariance.tolist(),
        scale=found.scale,
        at_bounds=list(found.at_bounds),
        unconstrained=list(found.unconstrained),
    )


def _initial(recording: Observed) -> Observed:
    """``recording`` with nothing observed after frame 0."""
    first = {name: getattr(recording, name)[:1] for name in ("points", "visible", "motion_valid")}
    return replace(recording, **first, colors=None if recording.colors is None else recording.colors[:1])


def _nearest(points, cloud):
    from scipy.spatial import cKDTree

    return cKDTree(cloud).query(points)[0]
