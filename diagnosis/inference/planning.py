"""Which motion of the hands would tell two readings of a recording apart, beside what sound twins are off by in that very motion.

A reading is a twin that explains what was recorded. Block means y_A, y_B of two readings in a motion are as far apart as

    D^2 = (y_A - y_B)' S^-1 (y_A - y_B)

says, S being the distribution of a sound twin's error there. Members are draws of it: what a member does in the motion, less what the
reference does as it was fitted to that member's own recording (``absorption``), so that what a fit to the recording at hand would make up
for counts for nothing. What the fit left open is in S by its posterior, and so is the noise of block means as they were recorded.
That is T-optimality (Atkinson and Fedorov 1975) with the twin's own error as a distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...datasets.scenario import Scenario, Split
from ...methods.continuum.hands import groups_of
from ...methods.continuum.scene import Scene
from ..config import DiagnosisConfig
from ..effects import Candidate
from ..motions import TELLING, VISIBLE, Motion, Setting, motions, outcome_words
from .blocks import Blocks
from .covariance import Layout, Prior, Scatter
from .evidence import Evidence
from .forward import Forward
from .likelihood import Likelihood
from .members import Member, scene_of, shared

__all__ = ["Look", "Plan", "Reading", "plan"]


@dataclass(frozen=True, eq=False)
class Reading:
    """Of the recording: its name, the clause after "if", and a twin, by ``shift`` (n,) of the unknowns in prior standard deviations and the
    ``amounts`` (m,) of a candidate, or None: nothing is missing."""

    name: str
    says: str
    candidate: Candidate | None
    shift: np.ndarray
    amounts: np.ndarray

    def values(self, forward: Forward) -> dict[str, float]:
        return forward.values(self.shift) | (self.candidate.values(self.amounts) if self.candidate else {})


@dataclass(frozen=True, eq=False)
class Look:
    """Where the outcome shows best: how far a part of the body that was at ``place`` (3,) m in frame 0 is from the nearest hand along
    ``axis`` (3,), by either reading [m], give or take ``within``, ``seconds`` after the start."""

    place: np.ndarray
    farthest: bool
    seconds: float
    axis: np.ndarray
    offsets: tuple[float, float]
    within: float


@dataclass(frozen=True, eq=False)
class Plan:
    """The motion that tells two readings apart best: D of it, and of the others that were looked into; ``look`` is None where nothing is
    far enough apart to be seen; ``says`` what to do, where to look, and what each outcome means."""

    motion: Motion
    separation: float
    others: dict[str, float]
    look: Look | None
    says: str

    @property
    def telling(self) -> bool:
        return self.separation >= TELLING and self.look is not None


@dataclass(frozen=True, eq=False)
class _Moved:
    """The twins in a motion, which both readings ran through: ``means`` (2, B) m, ``paths`` (2, T, M, 3) m."""

    motion: Motion
    forward: Forward
    noise: np.ndarray
    paths: np.ndarray
    means: np.ndarray

    @property
    def gap(self) -> np.ndarray:
        return self.means[0] - self.means[1]

    @property
    def bound(self) -> float:
        """D if sound twins were never off."""
        return float(np.linalg.norm(self.gap / np.sqrt(self.noise)))


def plan(evidence: Evidence, prior: Prior, readings: Sequence[Reading], config: DiagnosisConfig, *, worse: float = 1.0) -> Plan | None:
    """A motion of the hands in the first recording that tells two ``readings`` apart, else the best, or None where none can be simulated.

    worse  times as much variance as members have: by how much the twin was seen to be farther off in the recording than they are in theirs
    Members run through the ``config.planned`` motions that would tell best were sound twins never off, until one tells. Raises ValueError
    where nobody holds the body, or where members are recordings, which make no other motion.
    """
    forward = evidence.forward
    if not evidence.members:
        raise ValueError("members must be twins for a motion to be planned, got recordings")
    recording, body = forward.recordings[0], forward.simulators[0].scene.body
    label = np.zeros(recording.controllers.shape[1], int)
    for k, group in enumerate(groups_of(recording.controllers)):
        label[group] = k
    setting = Setting.of(recording, body.structure, label)
    moved = forward.each(lambda motion, twins: _moved(evidence, twins, motion, readings, config), motions(setting))
    found = [replace(one, forward=replace(one.forward, cost=forward.cost)) for one in moved if one is not None]
    if not found:
        return None
    found.sort(key=lambda one: -one.bound)
    tried: list[Plan] = []
    for one in found[: config.planned]:
        error = _error(one, evidence, prior, config, worse)
        if error is not None:
            tried.append(_planned(setting, readings, one, error))
            if tried[-1].telling:
                break
    if not tried:
        return None
    best = max(tried, key=lambda p: (p.telling, p.separation))
    return replace(best, others={p.motion.name: p.separation for p in tried if p is not best})


def _planned(setting: Setting, readings, one: _Moved, error: Likelihood) -> Plan:
    """A motion by itself, beside no others."""
    separation, look = float(np.linalg.norm(error.whitened(one.gap))), _look(setting, one, error)
    says = _words(setting, readings, one.motion, look if separation >= TELLING else None)
    return Plan(one.motion, separation, {}, look, says)


def _moved(evidence: Evidence, forward: Forward, motion: Motion, readings, config: DiagnosisConfig) -> _Moved | None:
    """The twins in another motion, from rest; None where one of the readings diverges."""
    recording, runner = forward.recordings[0], forward.simulators[0]
    there = replace(runner, scene=_led(runner.scene, motion))
    blocks = Blocks.of(_filmed(recording, motion, runner.scene.structure), config, forward.blocks[0].regions)
    here = replace(forward, simulators=(there,), blocks=(blocks,), sound=frozenset(), contrast=None)
    twins = here.with_effects([r.candidate for r in readings if r.candidate])
    paths = np.concatenate([twins.paths([r.values(forward)])[0] for r in readings])
    if not np.isfinite(paths).all():
        return None
    return _Moved(motion, here, _noise(evidence, here.layout), paths, blocks.means(paths))


def _led(scene: Scene, motion: Motion) -> Scene:
    """The scene of a motion that begins as its own does, from rest. It may have some of the motion's controllers only."""
    from scipy.spatial import cKDTree

    own = cKDTree(motion.controllers[0]).query(scene.controllers[0])[1]
    path = motion.controllers[:, own]
    return replace(scene, controllers=path, hands=scene.led(path), speeds=None)


def _filmed(recording: Scenario, motion: Motion, structure) -> Scenario:
    """What is seen of a motion: all tracks, always. Where, but for frame 0 (``structure`` (M, 3) m), is what twins say."""
    frames, count = len(motion.controllers), recording.points.shape[1]
    points = np.repeat(structure[None, :count], frames, 0)
    seen = np.ones((frames, count), bool)
    options: dict = dict(colors=None, actuation=None, tracks=None, images=None, split=Split(frames, frames))
    return replace(recording, points=points, visible=seen, motion_valid=seen, controllers=motion.controllers, **options)


def _noise(evidence: Evidence, layout: Layout) -> np.ndarray:
    """(B,) m^2 of block means of another motion: those of the nearest region in the recording, on average."""
    from scipy.spatial import cKDTree

    old = evidence.scatter.layout
    own = old.record == old.record.min()
    places, which = np.unique(old.place[own], axis=0, return_inverse=True)
    variance = np.bincount(which.ravel(), np.diag(evidence.scatter.noise)[own]) / np.bincount(which.ravel())
    return variance[cKDTree(places).query(layout.place)[1]]


def _error(one: _Moved, evidence: Evidence, prior: Prior, config: DiagnosisConfig, worse: float) -> Likelihood | None:
    """The distribution of a sound twin's error in the motion; None where too few members go through it."""
    forward = one.forward
    reference = forward.at(np.zeros(len(forward.unknowns)))[0]
    if not np.isfinite(reference).all():
        return None
    was = evidence.forward

    def run(member: Member, now: Forward) -> np.ndarray:  # its body and hands are told by the recording
        scene = scene_of(member, was.simulators[0].scene, was.recordings[0].observed(), config)
        return now.with_scenes([_led(scene, one.motion)]).at(member.shift, member.values)[0]

    left = shared(evidence.members, forward, run) - forward.at(evidence.settled)
    left = left[np.isfinite(left).all(1)]
    if len(left) < 4:
        return None
    slopes = forward.slopes(reference) / forward.sds
    values, ways = np.linalg.eigh(forward.covariance)
    open_ = slopes @ (ways * np.sqrt(np.maximum(values, 0.0)))
    usual = np.zeros((len(one.noise), 0))  # both readings share it
    return Scatter(np.sqrt(worse) * left, np.diag(one.noise), open_, usual, forward.layout, evidence.scatter.floor).likelihood(prior)


def _look(setting: Setting, one: _Moved, error: Likelihood) -> Look | None:
    """The part of the body, time and direction in which the readings differ most for how sure they are."""
    blocks, gap = one.forward.blocks[0], one.gap.reshape(-1, 3)
    scale = (error.factor @ error.factor.T).reshape(len(gap), 3, len(gap), 3)
    axes = np.stack([setting.up, setting.face, setting.line])
    own = scale[np.arange(len(gap)), :, np.arange(len(gap))]
    unsure = np.sqrt(np.einsum("ai,kij,aj->ka", axes, own, axes))
    apart = np.abs(gap @ axes.T)
    clear = np.where(apart >= VISIBLE, apart / unsure, 0.0)
    if not clear.max() > 0:
        return None
    cell, axis = (int(i) for i in np.unravel_index(int(clear.argmax()), clear.shape))
    region, frame = blocks.label == blocks.cells[cell] % blocks.count, round(float(blocks.time[cell]) * setting.fps)
    hands = np.stack([one.motion.controllers[frame, setting.hand == h].mean(0) for h in range(len(setting.centre))])
    place, far = blocks.place[cell], np.linalg.norm(blocks.regions[:, None] - setting.centre, axis=2).min(1)
    nearest = int(np.linalg.norm(setting.centre - place, axis=1).argmin())
    count = len(blocks.label)
    first, second = (float((p[frame, :count][region].mean(0) - hands[nearest]) @ axes[axis]) for p in one.paths)
    farthest = bool(np.linalg.norm(setting.centre - place, axis=1).min() >= far.max() - 1e-9)
    return Look(place, farthest, frame / setting.fps, axes[axis], (first, second), float(unsure[cell, axis]))


def _words(setting: Setting, readings, motion: Motion, look: Look | None) -> str:
    """What to do, where to look, and what each outcome means; without ``look``, that no motion helps."""
    a, b = readings
    if look is None:
        return (
            f"None of the motions that were simulated tells {a.name} from {b.name}: "
            "they differ by less than sound twins are off, or what the fits leave open would make up for it."
        )
    at = f"the part that was at ({', '.join(f'{c:.3f}' for c in look.place)}) m in frame 0"
    at = "the part farthest from the hands" if look.farthest else at
    return outcome_words(readings, motion, at, look.seconds, look.axis, setting.up, look.offsets, look.within)
