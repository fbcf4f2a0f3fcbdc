"""Twins of recordings as functions from numbers to block means."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import reduce
from typing import TypeVar

import numpy as np
from scipy.linalg import block_diag

from ...datasets.scenario import Scenario
from ...methods.continuum.config import Config
from ...methods.continuum.estimate import own_values, run_once, steps_of
from ...methods.continuum.joint import placed
from ...methods.continuum.scene import Scene
from ...methods.continuum.simulate import Simulator
from ...methods.continuum.twin import ContinuumTwin
from ...methods.continuum.unknowns import Unknown
from ...physics.side_by_side import side_by_side
from ..config import DiagnosisConfig
from ..effects import Candidate
from .blocks import Blocks
from .contrast import Contrast
from .covariance import Layout

__all__ = ["Cost", "Forward", "as_run"]

Item = TypeVar("Item")
Found = TypeVar("Found")


@dataclass
class Cost:
    """Roll-outs and the seconds of processors that they took, of one ``Forward`` and of all that is derived from it."""

    runs: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, eq=False)
class Forward:
    """What twins predict of R recordings, in block means.

    unknowns    n, as a fit of the twin had them (``rec<r>_...`` are one recording's own)
    scaled      (n,) where the fit ended, in their scaled space, and their ``covariance`` (n, n) there
    simulators  R, ``blocks`` R, each of all frames of its recording
    sound       which of the R recordings are known to lack nothing: effects act in the others alone
    acting      names of the values of effects, which sound recordings are not given
    seen        faults of the measurement, each (scene, values) -> the scene as it was
    contrast    how far recordings differ is asked, not what they are; or None
    spread      (n,) of the unknowns' own prior standard deviations, those of a single recording around where the fit ended
    after       (B,) m that stand for what is not fitted, so that runs end with the fitted frames; or None: all frames are run
    missed      (B,) m that a sound twin is expected to miss, which are taken from the data (``discrepancy``)
    """

    unknowns: tuple[Unknown, ...]
    scaled: np.ndarray
    covariance: np.ndarray
    told: Mapping[str, float]
    recordings: tuple[Scenario, ...]
    simulators: tuple[Simulator, ...]
    blocks: tuple[Blocks, ...]
    sound: frozenset[int] = frozenset()
    acting: frozenset[str] = frozenset()
    seen: tuple[Callable[[Scene, Mapping[str, float]], Scene], ...] = ()
    contrast: Contrast | None = None
    spread: np.ndarray | float = 1.0
    after: np.ndarray | None = None
    missed: np.ndarray | float = 0.0
    cost: Cost = field(default_factory=Cost)

    @classmethod
    def of(
        cls,
        twin: ContinuumTwin,
        recordings: Sequence[Scenario],
        config: DiagnosisConfig,
        sound: Iterable[int] = (),
        *,
        against: bool = False,
    ) -> Forward:
        """Of a twin that was fitted to the train frames of ``recordings``; of these frames alone are bodies and hands told.

        against: the first is asked beside the others, which are sound and of the same command. Raises ValueError for a twin that keeps no
        posterior.
        """
        if not twin.posterior:
            raise ValueError(f"a twin must keep the posterior of its fit, got none (scenario {twin.scene.name})")
        cells = config.cells_of(twin.scene.body)
        scenes = [_coarser(twin.scene, recordings[0].observed(), cells)]
        made = Config(contact="on" if twin.scene.contact else "off")
        for one in recordings[1:]:
            seen = one.observed()
            scenes.append(placed(seen, scenes[0].body.laid(seen), made))  # of the same cells
        shared = Blocks.of(recordings[0], config).regions if against else None
        blocks = tuple(Blocks.of(one, config, shared) for one in recordings)
        return cls(
            twin.unknowns,
            np.array(twin.posterior["scaled"]),
            np.array(twin.posterior["covariance"]),
            twin.own_values,
            tuple(recordings),
            tuple(Simulator(scene, twin.extra, twin.device) for scene in scenes),
            blocks,
            frozenset(sound),
            contrast=Contrast.of(blocks, 1e-3 * config.repeat) if against else None,
        )

    def mixed(self, values) -> np.ndarray:
        """(..., B) of values (..., A) of the block means of all recordings: these, or how far they differ."""
        return values if self.contrast is None else values @ self.contrast.matrix.T

    @property
    def data(self) -> np.ndarray:
        """(B,) m, without what a sound twin is expected to miss."""
        return self.mixed(np.concatenate([b.data for b in self.blocks])) - self.missed

    @property
    def motion(self) -> np.ndarray:
        """(B,) m, of the data from where their parts of the body were in frame 0."""
        layout = self.layout
        return self.data - (layout.place[np.arange(len(layout.axis)), layout.axis] if self.contrast is None else 0.0)

    @property
    def layout(self) -> Layout:
        """What each of the B values is."""
        parts = [b.layout(r) for r, b in enumerate(self.blocks)]
        whole = Layout(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Layout)))
        return whole if self.contrast is None else whole[self.contrast.rows]

    def noise(self, paths: Sequence[np.ndarray]) -> tuple[np.ndarray, Callable[[np.random.Generator], np.ndarray]]:
        """((B, B) m^2, a draw (B,) m of it), told by what tracks stray from regions' fields around ``paths``, R of (T, M, 3) m."""
        strays = [b.strays(p) for b, p in zip(self.blocks, paths, strict=True)]
        whole = block_diag(*(b.noise(s) for b, s in zip(self.blocks, strays, strict=True)))

        def draw(random: np.random.Generator) -> np.ndarray:
            return self.mixed(np.concatenate([random.choice([-1.0, 1.0], len(s)) @ s for s in strays]))

        if self.contrast is None:
            return whole, draw
        matrix, apart = self.contrast.matrix, self.contrast.set_up
        off = np.concatenate([b.data - b.means(p[None])[0] for b, p in zip(self.blocks, paths, strict=True)])
        repeats = self.contrast.repeats(off, np.diag(whole))

        def repeated(random: np.random.Generator) -> np.ndarray:
            return draw(random) + np.sqrt(repeats) * random.normal(size=len(repeats)) + apart @ random.normal(size=apart.shape[1])

        return matrix @ whole @ matrix.T + np.diag(repeats) + apart @ apart.T, repeated

    @property
    def sds(self) -> np.ndarray:
        """(n,) prior standard deviations of the unknowns, in their scaled space."""
        return np.array([u.sd for u in self.unknowns]) * self.spread

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """((n,), (n,)) least and largest shifts from where the fit ended, in prior standard deviations."""
        ends = np.array([u.ends for u in self.unknowns])
        return (ends[:, 0] - self.scaled) / self.sds, (ends[:, 1] - self.scaled) / self.sds

    def values(self, shift) -> dict[str, float]:
        """The unknowns ``shift`` (n,) prior standard deviations from where the fit ended."""
        return {u.name: u.decode(s) for u, s in zip(self.unknowns, self.scaled + shift * self.sds, strict=True)}

    def narrowed(self) -> float | None:
        """Logarithm of how much narrower than was told the narrowest grip is where the fit ended, a mean over recordings that are asked;
        None where no hand's grip was fitted in them."""
        ended = self.values(np.zeros(len(self.unknowns)))
        reaches = {name: -np.log(value) for name, value in ended.items() if name.endswith("_reach")}
        each = [[v for name, v in reaches.items() if name.startswith(f"rec{r}_grip")] for r in self.asked]
        return float(np.mean([max(own) for own in each if own])) if any(each) else None

    def paths(self, rows: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        """For each recording (K, T, M, 3) m, of dicts of values beside the twin's own; NaN from where one diverged. T: all frames, or those
        that were fitted where what comes ``after`` is told."""
        begun, found = time.process_time(), []
        for r, (runner, blocks) in enumerate(zip(self.simulators, self.blocks, strict=True)):
            hushed = self.acting if r in self.sound else ()
            values = [{name: v for name, v in row.items() if name not in hushed} for row in rows]
            frames = len(blocks.points) if self.after is None else self.recordings[r].split.train_end
            own = [own_values({**self.told, **row}, r) for row in values]
            found.append(run_once(own, lambda alone, runner=runner, frames=frames: self._ran(runner, alone, frames)))
        self.cost.seconds += time.process_time() - begun
        return found

    def _ran(self, runner: Simulator, values, frames: int) -> np.ndarray:
        """(K, frames, M, 3) m, those of one scene together; they are counted."""
        self.cost.runs += len(values)
        scenes = [reduce(lambda scene, seen, row=row: seen(scene, row), self.seen, runner.scene) for row in values]
        moved = [k for k, scene in enumerate(scenes) if scene is not runner.scene]
        usual = [k for k in range(len(values)) if k not in moved]
        alone = side_by_side(lambda k: replace(runner, scene=scenes[k]).run([values[k]], frames)[0], moved, runner.device)
        parts = dict(zip(moved, alone, strict=True))
        parts |= dict(zip(usual, runner.run([values[k] for k in usual], frames), strict=True)) if usual else {}
        return np.stack([parts[k] for k in range(len(values))])

    def steps(self, row: Mapping[str, float]) -> int:
        """The most steps a frame that any recording takes with a dict of values beside the twin's own."""
        return steps_of(self.simulators, {**self.told, **row})

    def reference(self) -> tuple[list[np.ndarray], np.ndarray]:
        """(R paths (T, M, 3) m, the block means (B,) m of them) where the fit ended. Raises ValueError where the twin diverges there."""
        paths = [p[0] for p in self.paths([self.values(np.zeros(len(self.unknowns)))])]
        found = self.mixed(np.concatenate([b.means(p[None])[0] for b, p in zip(self.blocks, paths, strict=True)]))
        if not np.isfinite(found).all():
            raise ValueError(f"the twin must not diverge in its own recordings (scenario {self.recordings[0].name})")
        return paths, found

    def posterior(self, slopes) -> np.ndarray:
        """(B, B) m^2 of predictions, by the fit's covariance and ``slopes`` (B, n) m for a prior standard deviation of each unknown."""
        each = slopes / self.sds
        return each @ self.covariance @ each.T

    def rows(self, rows: Sequence[Mapping[str, float]]) -> np.ndarray:
        """(K, B) m, block means; all NaN of a run that diverged."""
        found = self.mixed(np.concatenate([b.means(p) for b, p in zip(self.blocks, self.paths(rows), strict=True)], 1))
        if self.after is None:
            return found
        return np.where(self.layout.fitted | ~np.isfinite(found), found, self.after)

    def at(self, shifts, more: Mapping[str, float] | None = None) -> np.ndarray:
        """(K, B) m, at ``shifts`` (K, n), with ``more`` values."""
        return self.rows([{**self.values(s), **(more or {})} for s in np.atleast_2d(shifts)])

    def slopes(self, reference) -> np.ndarray:
        """(B, n) m for a prior standard deviation of each unknown, by differences; 0 where a run diverged."""
        steps = np.array([u.difference for u in self.unknowns]) / self.sds
        low, high = self.bounds
        signs = np.where(steps <= high, 1.0, -1.0)
        shifts = np.diag(np.clip(signs * steps, low, high))
        return np.nan_to_num((self.at(shifts) - reference).T / np.diag(shifts))

    def fitted_alone(self, reference) -> Forward:
        """The same twins, run through the fitted frames alone: what comes after is said to be as in ``reference`` (B,) m.

        Themselves where there is nothing else, and where recordings are compared, whose frames are mixed.
        """
        return self if self.contrast is not None or self.layout.fitted.all() else replace(self, after=np.asarray(reference))

    @property
    def asked(self) -> list[int]:
        """The recordings in which effects may act."""
        return [r for r in range(len(self.simulators)) if r not in self.sound]

    def each(self, work: Callable[[Item, Forward], Found], items: Iterable[Item]) -> list[Found]:
        """What ``work`` returns for each of ``items`` and the same twins, side by side; its roll-outs count here."""
        begun = time.process_time()
        twins = [(item, replace(self, simulators=tuple(replace(s) for s in self.simulators), cost=Cost())) for item in items]
        found = side_by_side(lambda pair: work(*pair), twins, self.simulators[0].device)
        self.cost.runs += sum(own.cost.runs for _, own in twins)
        self.cost.seconds += time.process_time() - begun
        return found

    def with_effects(self, candidates: Iterable[Candidate]) -> Forward:
        """The same twins with the laws of ``candidates``, in the recordings that are not known to be sound."""
        candidates = list(candidates)
        laws = {c.effect.term: c.effect.term() for c in candidates if c.effect.term}
        acting = {name for c in candidates for name in c.values([a.first for a in c.effect.amounts])}
        made = list(self.simulators)
        for r in self.asked:
            one = made[r]
            made[r] = replace(one, extra=(*one.extra, *laws.values()))
        seen = {c.effect.seen: None for c in candidates if c.effect.seen}
        return replace(self, simulators=tuple(made), acting=self.acting | acting, seen=(*self.seen, *seen))

    def with_scenes(self, scenes) -> Forward:
        """Other scenes of the same recordings."""
        made = [replace(s, scene=scene) for s, scene in zip(self.simulators, scenes, strict=True)]
        return replace(self, simulators=tuple(made))


def as_run(twin: ContinuumTwin, recording: Scenario, config: DiagnosisConfig) -> ContinuumTwin:
    """``twin`` of ``recording`` in the cells in which ``Forward`` runs it and its numbers were fitted: in others they suit it less."""
    return replace(twin, scene=_coarser(twin.scene, recording.observed(), config.cells_of(twin.scene.body)))


def _coarser(scene, recording, cells):
    """The scene in cells ``cells`` times as large; a body that is under load in frame 0 keeps its own."""
    return scene if cells == 1.0 or scene.body.is_loaded else replace(scene, body=scene.body.coarser(recording, cells))
