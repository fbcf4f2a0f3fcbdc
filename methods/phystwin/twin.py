"""The fitted twin: a body, where it stands and how it is stepped."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from ...datasets.scenario import Observed
from ...physics import terms
from ...physics.batch import Batch
from ...physics.latest import Latest
from ...physics.system import System
from .. import saving
from ..base import Diverged, Trajectory, Twin
from . import transfer
from .body import Body, Place, system, time_step
from .config import CORRECTED, Config, Quirks

__all__ = ["PhysTwinTwin"]


@dataclass(frozen=True)
class PhysTwinTwin(Twin):
    """A spring-mass body in frame 0 of a recording. ``transferred``: it was fitted elsewhere."""

    body: Body
    place: Place
    config: Config
    device: str = "cpu"
    transferred: bool = False
    latest: Latest[Batch] = field(default_factory=Latest, init=False, repr=False, compare=False)

    def rollout(self, controllers: np.ndarray) -> Trajectory:
        controllers = np.asarray(controllers, float)
        if controllers.shape[1:] != self.place.controllers.shape[1:]:
            raise ValueError(f"controllers must have shape (T, {self.place.controllers.shape[1]}, 3), got {controllers.shape}")
        found = self.rollouts(controllers[None])[0]
        if isinstance(found, Diverged):
            raise found
        return found

    def rollouts(self, controllers: np.ndarray) -> list[Trajectory | Diverged]:
        paths = np.asarray(controllers, float)
        found: dict[int, Trajectory | Diverged] = {}
        starts, group = np.unique(paths[:, 0].reshape(len(paths), -1), axis=0, return_inverse=True)
        for k in range(len(starts)):  # springs to hands have the lengths of frame 0: where hands begin alike there is one system
            own = np.flatnonzero(group.ravel() == k)
            batch = self._batch(paths[own[0], :1], len(own))
            rolled = batch.rollout(paths.shape[1], batch.along(paths[own]))
            for row, positions, bad in zip(own, rolled.positions, rolled.diverged, strict=True):
                blown = Diverged(f"the simulation blew up in frame {bad}", int(bad)) if bad >= 0 else None
                found[int(row)] = blown or Trajectory(positions.float().cpu().numpy(), self.place.counts)
        return [found[row] for row in range(len(paths))]

    def placed(self, start) -> tuple[System, tuple[int, float] | None]:
        """(the body with its hands at ``start`` (1, C, 3) m; (substeps a frame, seconds each) where stability does not choose them)."""
        one = system(self.body, replace(self.place, controllers=start), self.config)
        if not (self.transferred and self.config.quirks.fixed_grip):
            return one, None
        near = {"collision_dist": transfer.CONTACT} if self.place.self_collision else {}
        return one.with_values(**near), (transfer.SUBSTEPS, transfer.STEP)

    def _batch(self, start, count: int) -> Batch:
        def made():
            one, step = self.placed(start)
            substeps, dt = step or time_step([one], self.place.fps, self.config)
            return Batch([one] * count, fps=self.place.fps, substeps=substeps, dt=dt, device=self.device)

        return self.latest.of((start.tobytes(), count), made)

    def retarget(self, target: Observed) -> PhysTwinTwin:
        """The body on ``target``'s frame 0, stress-free there, its hand springs drawn anew.

        Where both recordings follow the same markers, particles go to their own places; else they are registered to the tracked and
        surface points (``transfer.laid``). A body that was fitted on several recordings keeps its topology and learned stiffness.
        """
        place = Place.of(target)
        marked = (place.grips >= 0).any() and place.counts == self.place.counts
        if not marked:
            structure = transfer.laid(self.body, self.place, place, self.config.quirks)
            known = dict(counts=self.place.counts, colors=self.place.colors, name=self.place.name)
            place = replace(place, structure=structure, grips=_nearest(place, structure), **known)
        return replace(self, body=transfer.grasp(self.body, place, self.config.quirks), place=place, transferred=True)

    def save(self, folder: Path) -> None:
        b, p = self.body, self.place
        arrays = dict(springs=b.springs, stiffness=b.stiffness, pulls=b.pulls, pull=b.pull, home=b.home)
        arrays |= dict(structure=p.structure, controllers=p.controllers, grips=p.grips, gravity=p.gravity)
        arrays |= {} if p.colors is None else dict(colors=p.colors)
        rest = dict(name=p.name, counts=p.counts, ground=p.ground, self_collision=p.self_collision, fps=p.fps)
        added = {type(t).__name__: t.values for t in b.added}
        state = dict(values=b.values, added=added, place=rest, config=asdict(self.config), device=self.device, transferred=self.transferred)
        saving.write(folder, arrays, state)

    @classmethod
    def load(cls, folder: Path) -> PhysTwinTwin:
        a, state = saving.read(folder)
        added = tuple(getattr(terms, name)(values) for name, values in state["added"].items())
        body = Body(values=state["values"], added=added, **{f.name: a[f.name] for f in fields(Body) if f.name in a})
        rest = state["place"] | {"counts": tuple(state["place"]["counts"])}
        if rest["ground"] is not None:
            rest["ground"] = tuple(rest["ground"])
        place = Place(**{k: a[k] for k in ("structure", "controllers", "grips", "gravity", "colors") if k in a}, **rest)
        quirks = Quirks(**asdict(CORRECTED) | state["config"]["quirks"])  # a twin that was saved earlier does without later switches
        config = Config(**state["config"] | {"quirks": quirks})
        return cls(body, place, config, state["device"], state["transferred"])


def _nearest(place, structure):
    """Grips on another body's particles: a driven marker holds the particle nearest to it."""
    apart = np.linalg.norm(place.controllers[0][:, None] - structure[None], axis=2)
    return np.where(place.grips >= 0, apart.argmin(1), -1)
