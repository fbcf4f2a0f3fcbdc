"""From searched numbers to a system that can be stepped, and to roll-outs of many of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...datasets.scenario import Observed
from ...physics.batch import Batch, first_bad
from ...physics.stability import stable_substeps
from ...physics.system import System
from ...physics.terms import ControllerSprings, Dashpot, Gravity, Ground, LinearDrag, SelfCollision, Springs
from ...physics.terms.base import Term
from ...physics.topology import controller_springs, object_springs
from .config import Config
from .ranges import ADDED_SHARE, CONTACT

__all__ = ["Body", "Motion", "Place", "build", "hand_springs", "regrip", "roll", "system", "time_step"]

PUBLISHED_STEP = 5e-5  # s
PUBLISHED_SUBSTEPS = 667
SAFETY = 0.9  # of the stable step, which is itself a lower bound


@dataclass(frozen=True)
class Place:
    """Where a body stands: frame 0 of a recording and what surrounds it there."""

    structure: np.ndarray  # (M, 3) m
    counts: tuple[int, int, int]
    controllers: np.ndarray  # (T, C, 3) m
    grips: np.ndarray  # (C,)
    gravity: np.ndarray  # (3,) m/s^2
    ground: tuple[float, float, float, float] | None  # unit normal and offset [m]
    self_collision: bool
    fps: float
    colors: np.ndarray | None = None  # (tracked, 3) RGB in [0, 1], NaN where not seen
    name: str = ""  # the recording's

    @classmethod
    def of(cls, observed: Observed) -> Place:
        """The place of a recording."""
        plane = observed.ground
        normal = None if plane is None else tuple(map(float, plane.normal))
        ground = None if plane is None or normal is None else (normal[0], normal[1], normal[2], float(plane.offset))
        return cls(
            observed.structure,
            observed.counts,
            observed.controllers,
            observed.grips,
            observed.gravity,
            ground,
            observed.self_collision,
            observed.fps,
            None if observed.colors is None else np.where(observed.visible[0][:, None], observed.colors[0], np.nan),
            observed.name,
        )


@dataclass(frozen=True)
class Body:
    """The object itself, apart from where it stands.

    springs (E, 2) between particles and stiffness (E,) [N]; ``pull`` [N] of the springs that join controllers; ``values`` are the searched
    parameters by name. ``pulls`` (Ec, 2) and ``pull`` (Ec,) belong to the place where the body was fitted, as does ``home`` (M, 3) [m],
    frame 0 there. ``added`` is physics beyond PhysTwin's; where it speaks of places on the body, it means those in ``home``.
    """

    springs: np.ndarray
    stiffness: np.ndarray
    pulls: np.ndarray
    pull: np.ndarray
    values: dict[str, float]
    home: np.ndarray
    added: tuple[Term, ...] = ()


@dataclass(frozen=True)
class Motion:
    """A simulated recording: ``positions`` (F, M, 3) [m], ``velocities`` alike or None, the first ``diverged`` frame or -1."""

    positions: torch.Tensor
    velocities: torch.Tensor | None
    diverged: int


def build(values: dict[str, float], place: Place, added: Sequence[Term] = (), *, springs: Callable | None = None) -> Body:
    """A homogeneous body: topology and stiffness from the searched parameters, and what share of its amplitude ``added`` physics has.

    ``springs`` of the place's structure, where its neighbours are known already (``physics.topology.Neighbours``), spare the search.
    """
    asked = {"radius": values["object_radius"], "max_neighbours": int(values["object_max_neighbours"])}
    found = springs(**asked) if springs else object_springs(place.structure, **asked)
    pulls = hand_springs(values, place)
    stiffness, pull = (np.full(len(s), values["global_spring_Y"]) for s in (found, pulls))
    scaled = tuple(_scaled(term, values.get(ADDED_SHARE.name, 1.0)) for term in added)
    return Body(found, stiffness, pulls, pull, dict(values), place.structure, scaled)


def _scaled(term: Term, share: float) -> Term:
    """The term with ``share`` times its effect's amplitudes, within their bounds."""
    bounds = {p.name: (p.low, p.high) for p in term.parameters}
    return term.with_values(**{n: float(np.clip(share * term.values[n], *bounds[n])) for n in term.stands_for().amplitudes})


def hand_springs(values: dict[str, float], place: Place) -> np.ndarray:
    """Springs (Ec, 2) from hand points (M + c) to particles; controllers that grip a particle need none."""
    hands = np.flatnonzero(place.grips < 0)
    radius, most = values["controller_radius"], int(values["controller_max_neighbours"])
    found = controller_springs(place.controllers[0, hands], place.structure, radius=radius, max_neighbours=most)
    if len(found):
        found[:, 0] = len(place.structure) + hands[found[:, 0]]
    return found


def regrip(body: Body, place: Place) -> Body:
    """The body with hand springs drawn at another place, each as stiff as its own are on (geometric) average."""
    pulls = hand_springs(body.values, place)
    level = np.exp(np.log(np.maximum(body.pull, 1.0)).mean()) if len(body.pull) else body.values["global_spring_Y"]
    return replace(body, pulls=pulls, pull=np.full(len(pulls), level))


def system(body: Body, place: Place, config: Config) -> System:
    """The body at a place, at rest and free of stress."""
    v = body.values
    x, y, z = place.gravity
    share = 0.0 if config.quirks.still_controllers else 1.0
    terms = [
        Springs(),
        Dashpot({"dashpot_damping": v["dashpot_damping"]}),
        ControllerSprings({"controller_velocity": share}),
        Gravity({"gravity_x": x, "gravity_y": y, "gravity_z": z}),
        LinearDrag({"drag_damping": v["drag_damping"]}),
    ]
    if place.ground is not None:
        names = ("ground_normal_x", "ground_normal_y", "ground_normal_z", "ground_offset")
        plane = dict(zip(names, place.ground, strict=True))
        terms.append(Ground({"collide_elas": v["collide_elas"], "collide_fric": v["collide_fric"], **plane}))
    if place.self_collision:
        names = ("collision_dist", "collide_object_elas", "collide_object_fric")
        near = 1.0 if config.quirks.colliding_neighbours else 0.0
        terms.append(SelfCollision({**{n: v[n] for n in names}, "collide_neighbours": near}))
    for term in body.added:
        terms = _joined(terms, term, v, place)
    return System(
        positions=place.structure,
        springs=np.concatenate([body.springs, body.pulls]),
        stiffness=np.concatenate([body.stiffness, body.pull]),
        controllers=place.controllers,
        grips=place.grips,
        home=body.home if body.added else None,
        terms=tuple(terms),
    )


def _joined(terms: Sequence[Term], term: Term, values: dict[str, float], place: Place) -> list[Term]:
    """``terms`` and another one, which stands in for one whose parameters it shares, and has their values.

    Contact parameters are the body's ``values``; what is about the ground gets the place's, or stays out where there is none.
    """
    plane = {} if place.ground is None else dict(zip(("x", "y", "z", "offset"), place.ground, strict=True))
    about_ground = term.name == "ground_pose" or any(n.endswith("_offset") for n in term.values)
    if about_ground and not plane:
        return list(terms)
    known = {n: values[n] for n in CONTACT} | {n: v for t in terms for n, v in t.values.items()}
    known |= {f"adhesion_{'offset' if n == 'offset' else f'normal_{n}'}": v for n, v in plane.items()}
    term = term.with_values(**{n: known[n] for n in term.values if n in known})
    return [*(t for t in terms if not t.values.keys() & term.values.keys()), term]


def time_step(systems: Sequence[System], fps: float, config: Config) -> tuple[int, float]:
    """(substeps per frame, seconds per substep)."""
    if config.quirks.long_frame:
        return PUBLISHED_SUBSTEPS, PUBLISHED_STEP
    if isinstance(config.substeps, int):
        substeps = config.substeps
    else:  # "auto"
        substeps = min(stable_substeps([_made(s, fps) for s in systems], 1 / fps, safety=SAFETY), config.most_substeps)
    return substeps, 1 / fps / substeps


def _made(one: System, fps: float) -> System:
    """The system as its setup terms make it: what is stiffer or lighter for them needs shorter steps."""
    if not any(t.stage == "setup" for t in one.terms):
        return one
    batch = Batch([one], fps=fps, substeps=1)
    made, own = batch.prepare(batch.inputs), slice(one.particle_count)
    return replace(one, stiffness=made.stiffness.double().numpy(), rest=made.rest.double().numpy(), masses=made.mass[own].double().numpy())


def roll(systems: Sequence[System], fps: float, frames: int, config: Config, device: str) -> list[Motion]:
    """The first ``frames`` frames of each system, all as one batch, each with as many substeps as it needs."""
    substeps, dt = zip(*(time_step([one], fps, config) for one in systems), strict=True)
    batch = Batch(systems, fps=fps, substeps=substeps, dt=dt, device=device)
    if config.quirks.acceleration_loss:
        return [Motion(x, v, first_bad(x)) for x, v in zip(*_frame_by_frame(batch, frames), strict=True)]
    rolled = batch.rollout(frames)
    return [Motion(x, None, int(bad)) for x, bad in zip(rolled.positions, rolled.diverged, strict=True)]


def _frame_by_frame(batch, frames):
    """Positions and velocities (F, M, 3) of each system at the frames."""
    xs, vs = [batch.inputs.x], [batch.inputs.v]
    for frame in range(frames - 1):
        _, x, v = batch.march(frame, 1, replace(batch.inputs, x=xs[-1], v=vs[-1]))
        xs.append(x)
        vs.append(v)
    return batch.split(torch.stack(xs)), batch.split(torch.stack(vs))
