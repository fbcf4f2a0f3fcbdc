"""The fitted twin: a body, where it stands and how it is stepped."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from ...datasets.scenario import Observed, Plane
from ...physics import terms
from ..base import Diverged, Trajectory, Twin
from ..registration import align
from .body import Body, Place, regrip, roll, system
from .config import Config, Quirks

__all__ = ["PhysTwinTwin"]

MARGIN = 0.005  # m: how much farther than its nearest particle a hand point reaches, at least
TRANSFER_RADIUS, TRANSFER_CLOSEST, TRANSFER_NEIGHBOURS, TRANSFER_PULL = 0.01, 10, 30, 3e4  # published transfer protocol, section 8.5
TRANSFER_SUBSTEPS, TRANSFER_STEP, TRANSFER_CONTACT = 6667, 5e-6, 0.005  # per frame, s, m


@dataclass(frozen=True)
class PhysTwinTwin(Twin):
    """A spring-mass body in frame 0 of a recording. ``transferred``: it was fitted elsewhere."""

    body: Body
    place: Place
    config: Config
    device: str = "cpu"
    transferred: bool = False

    def rollout(self, controllers: np.ndarray) -> Trajectory:
        controllers = np.asarray(controllers, float)
        if controllers.shape[1:] != self.place.controllers.shape[1:]:
            raise ValueError(f"controllers must have shape (T, {self.place.controllers.shape[1]}, 3), got {controllers.shape}")
        place = replace(self.place, controllers=controllers)
        one = system(self.body, place, self.config)
        if self.transferred and self.config.quirks.fixed_grip:
            one = one.with_values(**({"collision_dist": TRANSFER_CONTACT} if place.self_collision else {}))
            step = TRANSFER_SUBSTEPS, TRANSFER_STEP
        else:
            step = None
        quiet = replace(self.config, quirks=replace(self.config.quirks, acceleration_loss=False))
        motion = roll([one], place.fps, len(controllers), quiet, self.device, step=step)[0]
        if motion.diverged >= 0:
            raise Diverged(f"the simulation blew up in frame {motion.diverged}", motion.diverged)
        return Trajectory(motion.positions.float().cpu().numpy(), place.counts)

    def retarget(self, target: Observed) -> PhysTwinTwin:
        """The body on ``target``'s frame 0, stress-free there, its hand springs drawn anew.

        Where both recordings follow the same markers, particles go to their own places; else they are registered to the tracked and
        surface points. A body that was fitted on several recordings keeps its topology and learned stiffness.
        """
        place = Place.of(target)
        marked = (place.grips >= 0).any() and place.counts == self.place.counts
        if not marked:
            cloud = place.structure[: sum(place.counts[:2])]
            ground = None if place.ground is None else Plane(np.array(place.ground[:3]), place.ground[3])
            structure = align(self.place.structure, cloud, ground=ground)
            place = replace(place, structure=structure, counts=self.place.counts, grips=_nearest(place, structure))
        return replace(self, body=self._grasp(place), place=place, transferred=True)

    def _grasp(self, place):
        """The body with hand springs drawn at a new place."""
        hands = np.flatnonzero(place.grips < 0)
        if not len(hands):
            return replace(self.body, pulls=np.zeros((0, 2), np.int64), pull=np.zeros(0))
        apart = np.linalg.norm(place.controllers[0, hands][:, None] - place.structure[None], axis=2)
        nearest = apart.min(1)
        if not self.config.quirks.fixed_grip:
            radius = max(self.body.values["controller_radius"], float(nearest.min()) + MARGIN)
            wide = replace(self.body, values=self.body.values | {"controller_radius": radius})
            return replace(regrip(wide, place), values=self.body.values)
        close = np.argsort(nearest, kind="stable")[:TRANSFER_CLOSEST]
        radii = np.full(len(hands), TRANSFER_RADIUS)
        radii[close] = nearest[close] + MARGIN
        pairs = []
        for hand, radius, row in zip(hands, radii, apart, strict=True):
            order = np.argsort(row, kind="stable")[:TRANSFER_NEIGHBOURS]
            pairs += [(len(place.structure) + hand, j) for j in order[row[order] < radius]]
        pulls = np.array(pairs, np.int64).reshape(-1, 2)
        return replace(self.body, pulls=pulls, pull=np.full(len(pulls), TRANSFER_PULL))

    def save(self, folder: Path) -> None:
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        b, p = self.body, self.place
        arrays = dict(springs=b.springs, stiffness=b.stiffness, pulls=b.pulls, pull=b.pull, home=b.home)
        arrays |= dict(structure=p.structure, controllers=p.controllers, grips=p.grips, gravity=p.gravity)
        np.savez_compressed(folder / "twin.npz", **arrays)
        rest = dict(counts=p.counts, ground=p.ground, self_collision=p.self_collision, fps=p.fps)
        added = {type(t).__name__: t.values for t in b.added}
        state = dict(values=b.values, added=added, place=rest, config=asdict(self.config), device=self.device, transferred=self.transferred)
        (folder / "twin.json").write_text(json.dumps(state, indent=1), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> PhysTwinTwin:
        folder = Path(folder)
        state = json.loads((folder / "twin.json").read_text(encoding="utf-8"))
        with np.load(folder / "twin.npz", allow_pickle=False) as file:
            a = dict(file)
        added = tuple(getattr(terms, name)(values) for name, values in state["added"].items())
        body = Body(values=state["values"], added=added, **{f.name: a[f.name] for f in fields(Body) if f.name in a})
        rest = state["place"] | {"counts": tuple(state["place"]["counts"])}
        if rest["ground"] is not None:
            rest["ground"] = tuple(rest["ground"])
        place = Place(**{k: a[k] for k in ("structure", "controllers", "grips", "gravity")}, **rest)
        config = Config(**state["config"] | {"quirks": Quirks(**state["config"]["quirks"])})
        return cls(body, place, config, state["device"], state["transferred"])


def _nearest(place, structure):
    """Grips on another body's particles: a driven marker holds the particle nearest to it."""
    apart = np.linalg.norm(place.controllers[0][:, None] - structure[None], axis=2)
    return np.where(place.grips >= 0, apart.argmin(1), -1)
