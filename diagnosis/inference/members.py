"""Sound twins of recordings that differ from the reference in what nobody knows: cells, shape, hands, contact, material."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...datasets.scenario import Observed
from ...methods.continuum.bodies import Body
from ...methods.continuum.body import body_of
from ...methods.continuum.gridding import SLIVER
from ...methods.continuum.hands import groups_of
from ...methods.continuum.rods import Rod
from ...methods.continuum.scene import Scene
from ...methods.continuum.solids import Solid
from ...methods.continuum.unknowns import Unknown, members
from ...physics.grids import embed
from ..config import DiagnosisConfig
from .forward import Forward

__all__ = ["FEWEST", "Member", "affordable", "drawn", "ran", "scene_of", "shared"]

FEWEST = 4  # members, of which a deviation can be told
LESS = 0.8  # of a shift that is too dear, again and again


@dataclass(frozen=True)
class Member:
    """cells: edge over the reference's; turn (3,) of the grid as a rotation vector [rad], ``offset`` (3,) in cells; ``seed`` of the points
    that its shape is told by; ``shift`` (n,) of the unknowns, in prior standard deviations, and further ``values``."""

    cells: float
    turn: np.ndarray
    offset: np.ndarray
    seed: int
    shift: np.ndarray
    values: Mapping[str, float]


def drawn(forward: Forward, config: DiagnosisConfig, seed: int = 0) -> list[Member]:
    """``config.members`` members, space-filling."""
    low, high = forward.bounds
    within = [(max(a, -2.0), min(b, 2.0)) for a, b in zip(low, high, strict=True)]
    span = np.log(config.stiffest)
    rates = [name for name in ("grip_rate", "coulomb_rate") if name in forward.simulators[0].system.values]
    ranges = [Unknown("cells", 1.0, config.finest, config.coarsest, "-", "log")]
    ranges += [Unknown(f"turn_{a}", 0.0, -2.0, 2.0, "-", prior=(0.0, 1.0)) for a in "xyz"]
    ranges += [Unknown(f"offset_{a}", 0.0, -0.5, 0.5, "-") for a in "xyz"]
    ranges += [Unknown(f"shift_{k}", 0.0, -2.0, 2.0, "-", prior=(0.0, 1.0)) for k in range(len(low))]
    ranges += [Unknown(name, 0.0, -span, span, "-") for name in rates]
    usual = forward.simulators[0].system.values | dict(forward.told)
    found = []
    for k, row in enumerate(members(ranges, config.members, seed=seed)):
        turn, offset = (np.array([row[f"{name}_{a}"] for a in "xyz"]) for name in ("turn", "offset"))
        shift = np.array([np.clip(config.broad * row[f"shift_{j}"], *(within[j])) for j in range(len(low))])
        shift = affordable(shift, forward, config)
        values = {name: float(np.exp(row[name]) * usual[name]) for name in rates}
        found.append(Member(row["cells"], np.radians(config.turned) * turn, offset, seed + k, shift, values))
    return found


def affordable(shift: np.ndarray, forward: Forward, config: DiagnosisConfig) -> np.ndarray:
    """``shift`` (n,), or so much of it that no run takes more than ``config.dearest`` times the reference's steps."""
    usual = forward.steps({})
    while forward.steps(forward.values(shift)) > config.dearest * usual:
        shift = LESS * shift
    return shift


def ran(members: Sequence[Member], forward: Forward, config: DiagnosisConfig) -> np.ndarray:
    """(K, B) m, block means of each of K members; NaN where one diverged, or where no such body can be made."""

    def run(member: Member, forward: Forward) -> np.ndarray:
        scenes: list[Scene] = []
        for simulator, one in zip(forward.simulators, forward.recordings, strict=True):
            scenes.append(scene_of(member, simulator.scene, one.observed(), config, like=scenes[0].body if scenes else None))
        return forward.with_scenes(scenes).at(member.shift, member.values)[0]

    return shared(members, forward, run)


def shared(members: Sequence[Member], forward: Forward, run: Callable[[Member, Forward], np.ndarray]) -> np.ndarray:
    """(K, B) m, what ``run`` says of each of K members; NaN where it raises ValueError."""

    def one(member: Member, forward: Forward) -> np.ndarray:
        try:
            return run(member, forward)
        except ValueError:
            return np.full(len(forward.data), np.nan)

    return np.array(forward.each(one, members))


def scene_of(member: Member, scene: Scene, recording: Observed, config: DiagnosisConfig, *, like: Body | None = None) -> Scene:
    """Another body in hands that are told by part of their controllers, where these are no markers on it.

    ``like``: the member's body in another recording, of the cells of which a solid is here too. Raises ValueError where no such body can be
    made.
    """
    body = like.laid(recording) if isinstance(like, Solid) else _body(scene.body, recording, member, config)
    if not config.dropped or (recording.grips >= 0).any():
        return replace(scene, body=body)
    random, kept = np.random.default_rng(member.seed), []
    for group in groups_of(recording.controllers):  # the first stays, by which hands are ordered
        kept += [group[0], *(c for c in group[1:] if random.random() >= config.dropped)]
    kept = np.sort(kept)
    fewer = replace(recording, controllers=recording.controllers[:, kept], grips=recording.grips[kept])
    other = Scene.of(fewer, body, speeds=scene.speeds, still=scene.still, contact=scene.contact)
    return other if len(other.hands) == len(scene.hands) else replace(scene, body=body)


def _body(body: Body, recording: Observed, member: Member, config: DiagnosisConfig) -> Body:
    """Another body of the same kind. One whose frame 0 is under load keeps its rest shape, and only its parameters differ."""
    if body.is_loaded:
        return body
    if isinstance(body, Rod) and not body.is_marked:
        return body.anew(recording, _thinned(recording, member.seed, config.dropped), member.cells)
    if not isinstance(body, Solid):
        return body.coarser(recording, member.cells)
    from scipy.spatial.transform import Rotation

    told = body_of(_thinned(recording, member.seed, config.dropped), kind="solid", pitch=float(body.grid.size.mean()))
    axes = body.grid.axes @ Rotation.from_rotvec(member.turn).as_matrix().T
    grid = embed(told.samples, told.volume, member.cells * body.grid.size, axes=axes, offset=member.offset, sliver=SLIVER)
    return replace(body, grid=grid, surface=told.surface, area=told.area)


def _thinned(recording: Observed, seed: int, dropped: float) -> Observed:
    """The recording without a share of the points that tell its shape."""
    random = np.random.default_rng(seed)
    visible = recording.visible.copy()
    visible[0] &= random.random(visible.shape[1]) >= dropped
    visible[0, recording.grips[recording.grips >= 0]] = True
    kept = {name: getattr(recording, name) for name in ("surface", "interior")}
    kept = {name: points[random.random(len(points)) >= dropped] for name, points in kept.items()}
    return replace(recording, visible=visible, **kept)
