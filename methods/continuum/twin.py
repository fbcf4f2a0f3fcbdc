"""The fitted twin: a scene and the numbers that were found for it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.scenario import Observed, Plane
from ...physics import terms
from ...physics.terms.base import Term
from .. import saving
from ..base import Diverged, Trajectory, Twin
from .bodies import class_of
from .config import Config
from .hands import Hand
from .joint import placed
from .result import Fit
from .scene import REACH, Scene
from .simulate import Simulator
from .start import Speeds
from .unknowns import Unknown

__all__ = ["ContinuumTwin"]


@dataclass(frozen=True, eq=False)
class ContinuumTwin(Twin):
    """``values`` by name, as ``Simulator`` takes them; ``extra`` terms of its physics.

    posterior  names, values and covariance of what was fitted, in the scaled space of the unknowns (``result.Fit``), for intervals
    unlisted   how many controllers, the last of its scene, its recording does not list: they go where they went, and stay where that ends
    """

    scene: Scene
    values: dict[str, float]
    extra: tuple[Term, ...] = ()
    posterior: dict = field(default_factory=dict)
    device: str = "cpu"
    unlisted: int = 0
    looks_ahead = True  # how far a controller is trusted depends on all of its path

    @property
    def note(self) -> str:
        return "; ".join(dict.fromkeys(self.scene.notes))

    @property
    def own_values(self) -> dict[str, float]:
        """The values that it has in any recording: all but where, and how far, its hands hold here."""
        own = [p.name for p in terms.SoftGrip.parameters]
        return {name: v for name, v in self.values.items() if not name.startswith("grip") or name in own}

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """What was fitted, those of one recording alone as ``rec<r>_...``; none where it keeps no posterior."""
        listed: list[dict[str, Any]] = self.posterior.get("unknowns", [])
        read: list[dict[str, Any]] = [{k: tuple(v) if isinstance(v, list) else v for k, v in one.items()} for one in listed]
        return tuple(Unknown(**one) for one in read)

    @property
    def ended(self) -> dict[str, float]:
        """Where the fit ended, by the names of the unknowns, within their bounds."""
        found = zip(self.unknowns, self.posterior.get("scaled", []), strict=True)
        return {u.name: float(np.clip(u.decode(s), u.low, u.high)) for u, s in found}

    @property
    def controllers(self) -> np.ndarray:
        """(T, C, 3) m, of its recording, those that this lists."""
        return self.scene.controllers[:, : self.scene.controllers.shape[1] - self.unlisted]

    @cached_property
    def simulator(self) -> Simulator:
        return Simulator(self.scene, self.extra, self.device)

    def rollout(self, controllers: np.ndarray) -> Trajectory:
        controllers = np.asarray(controllers, float)
        if controllers.ndim != 3 or controllers.shape[1:] != self.controllers.shape[1:]:
            raise ValueError(f"controllers must have shape (T, {self.controllers.shape[1]}, 3), got {controllers.shape}")
        found = self.rollouts(controllers[None])[0]
        if isinstance(found, Diverged):
            raise found
        return found

    def rollouts(self, controllers: np.ndarray) -> list[Trajectory | Diverged]:
        controllers, scene = np.asarray(controllers, float), self.scene
        if controllers.ndim != 4 or controllers.shape[2:] != self.controllers.shape[1:]:
            raise ValueError(f"controllers must have shape (B, T, {self.controllers.shape[1]}, 3), got {controllers.shape}")
        if self.unlisted:
            count, frames = self.controllers.shape[1], np.minimum(np.arange(controllers.shape[1]), len(scene.controllers) - 1)
            rest = np.broadcast_to(scene.controllers[frames, count:], (*controllers.shape[:2], self.unlisted, 3))
            controllers = np.concatenate([controllers, rest], 2)
        driven, found = np.flatnonzero(scene.grips >= 0), []
        for path, own in zip(
            self.simulator.run([self.values] * len(controllers), controllers.shape[1], controllers), controllers, strict=True
        ):
            bad = ~np.isfinite(path).all((1, 2))
            path[:, scene.grips[driven]] = own[:, driven]
            blown = Diverged(f"the simulation blew up in frame {bad.argmax()}", int(bad.argmax())) if bad.any() else None
            found.append(blown or Trajectory(path.astype(np.float32), scene.counts))
        return found

    def retarget(self, target: Observed) -> ContinuumTwin:
        """The same body and material in ``target``'s frame 0, held by its hands there.

        Of ``target`` only frame 0 and the controllers are looked at: what hands hold there is told by distance. It starts at rest, unless
        exactly two frames are given, as ``Scenario.start_frames`` may declare: then as fast as they say.
        """
        first, body = target.until(1), self.scene.body
        start, contact = "frames" if target.observed_frames == 2 else "rest", "on" if self.scene.contact else "off"
        there = placed(first, body.laid(first), Config(start=start, contact=contact), target)
        values = self.own_values | self._grips(there) | self._places(there)
        if "grip_rate" in values and self._giving(self.scene) and self._giving(there):
            values["grip_rate"] = self._as_stiff(there, values)
        if target.timed:
            values.pop("frame_rate", None)
        if body.is_loaded and not there.body.is_loaded:
            there = Simulator(there, self.extra, self.device).unloaded(first, values)
        return replace(self, scene=there, values=values, unlisted=0)

    def _grips(self, there: Scene) -> dict[str, float]:
        """How the hands of another recording hold: as much as they were found to hold here, and as far out."""
        scene = self.scene
        shift, reach = self.simulator.grips(self.values)
        (places, radii), (elsewhere, others) = scene.grips_at, there.grips_at
        if not scene.soft:
            return {}
        typical = float(np.exp(np.mean([np.log(reach[k] * radii[k]) for k in scene.soft])))
        out = float(np.mean([shift[k] @ scene.body.outward(places[k].mean(0)) for k in scene.soft]))
        found = {}
        for k, (place, radius) in enumerate(zip(elsewhere, others, strict=True)):
            found[f"grip{k}_reach"] = float(np.clip(typical / radius, 1 / REACH, REACH))
            moved = out * there.body.outward(place.mean(0))
            found |= {f"grip{k}_shift_{axis}": float(v) for axis, v in zip("xyz", moved, strict=True)}
        return found

    def _places(self, there: Scene) -> dict[str, float]:
        """Where on the body its further terms act, in another recording's frame 0."""
        found = {}
        for term in self.extra:
            told = term.effect
            names = [f"{told.place}_{axis}" for axis in "xyz"] if told and told.place and not told.roaming else []
            if names and set(names) <= set(self.values):
                place = np.array([[self.values[name] for name in names]])
                found |= dict(zip(names, map(float, self.scene.body.elsewhere(there.body, place)[0]), strict=True))
        return found

    def _giving(self, scene: Scene) -> tuple[int, ...]:
        """The hands that hold as ``grip_rate`` says: all soft ones, or the one that has a name."""
        hand = self.values.get("grip_hand", -1)
        return tuple(k for k in scene.soft if hand in (-1, k))

    def _as_stiff(self, there: Scene, values) -> float:
        """The rate [1/s] with which hands are springs of as many N/m ``there`` as they are here: M w^2, whatever mass M they hold."""
        rate = next(p for p in terms.SoftGrip.parameters if p.name == "grip_rate")
        each = ((self.scene, self.values), (there, values))
        here, held = (scene.held_mass(*Simulator(scene).grips(own), self._giving(scene)) for scene, own in each)
        return float(np.clip(values["grip_rate"] * np.sqrt(here / held), rate.low, rate.high))

    def save(self, folder: Path) -> None:
        scene = self.scene
        arrays = {f"body_{name}": value for name, value in scene.body.arrays().items()}
        arrays |= {name: getattr(scene, name) for name in ("controllers", "grips", "gravity")}
        if scene.speeds is not None:
            arrays |= {f"speeds_{f.name}": np.array(getattr(scene.speeds, f.name)) for f in fields(Speeds)}
        for k, hand in enumerate(scene.hands):
            arrays |= {f"hand{k}_{f.name}": getattr(hand, f.name) for f in fields(Hand) if f.name not in ("turns", "notes")}
        state = {name: getattr(scene, name) for name in ("name", "counts", "radius", "fps", "timed", "still", "notes")}
        state |= dict(contact=scene.contact, kind=scene.body.kind, elements=scene.body.elements, body_notes=scene.body.notes)
        state |= dict(turns=[h.turns for h in scene.hands], hand_notes=[h.notes for h in scene.hands])
        state |= dict(ground=None if scene.ground is None else [*scene.ground.normal.tolist(), scene.ground.offset])
        state |= dict(values=self.values, extra={type(t).__name__: t.values for t in self.extra}, posterior=self.posterior)
        state |= dict(device=self.device, unlisted=self.unlisted)
        saving.write(folder, arrays, state)

    @classmethod
    def load(cls, folder: Path) -> ContinuumTwin:
        arrays, state = saving.read(folder)
        parts = {name.removeprefix("body_"): value for name, value in arrays.items() if name.startswith("body_")}
        body = class_of(state["kind"], state["elements"]).restored(parts, tuple(state["body_notes"]))
        hands = []
        for k, (turns, notes) in enumerate(zip(state["turns"], state["hand_notes"], strict=True)):
            own = {f.name: arrays[f"hand{k}_{f.name}"] for f in fields(Hand) if f.name not in ("turns", "notes")}
            hands.append(Hand(**own, turns=turns, notes=tuple(notes)))
        ground = None if state["ground"] is None else Plane(np.array(state["ground"][:3]), state["ground"][3])
        known: dict[str, Any] = {name: arrays[name] for name in ("controllers", "grips", "gravity")}
        speeds: dict[str, Any] = {f.name: arrays[f"speeds_{f.name}"] for f in fields(Speeds) if f"speeds_{f.name}" in arrays}
        known |= dict(speeds=Speeds(**speeds) if speeds else None)
        known |= {name: state[name] for name in ("name", "radius", "fps", "timed", "contact")}
        known |= dict(still=state.get("still", False))  # of twins that were kept before nothing says so
        scene = Scene(body=body, hands=tuple(hands), ground=ground, counts=tuple(state["counts"]), notes=tuple(state["notes"]), **known)
        extra = tuple(getattr(terms, name)(values) for name, values in state["extra"].items())
        return cls(scene, state["values"], extra, state["posterior"], state["device"], state.get("unlisted", 0))


def posterior_of(found: Fit) -> dict:
    """What a twin keeps of a fit, as JSON has it."""
    return dict(
        unknowns=[asdict(u) for u in found.unknowns],
        scaled=found.scaled.tolist(),
        covariance=found.covariance.tolist(),
        scale=found.scale,
        at_bounds=list(found.at_bounds),
        unconstrained=list(found.unconstrained),
    )
