"""A few global numbers of a body and its grips, fitted to what was seen of its recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...datasets.scenario import Observed
from ...physics.terms.base import Term
from .config import Config
from .fitting import Steps, fit, narrowed
from .predictability import predictability
from .problem import posed
from .result import Fit
from .robust import StudentT
from .scene import REACH, SHIFT, Scene
from .sights import CloudSight, Sight, regions_of, sight_of
from .simulate import Simulator
from .unknowns import Unknown, members

__all__ = ["Estimate", "estimate", "horizon", "own_values", "run_once", "run_within", "steps_of", "unknowns_of"]

WIDTH = 0.1  # s, over which what can be predicted is smoothed
REGIONS = 12  # in which tracks move together, and so count once
UNLOADINGS = 2  # times that a rest shape is solved before a refinement: from the search's stiffness, then from a better one
RATES = 3.0  # times the rate that was meant, at most, that frames came at where it was not recorded, or as many times fewer
TRIED_RATES = (1.0, 0.6, 1.6)  # times that rate, from which searches start
LEADING = 0.3  # of what a fit tells of its progress, while its starts are led
MOVED = 0.01  # m: hands that go less far do not tell how a motion goes on
SHORTEST = 10  # frames, of a motion by which starts are led
LED = 3  # iterations in each: after two a folded cloth had not left a wrong valley (4.4 mm for 2.9)
ARRIVED = 0.1  # nats, where starts were led: they begin near the end, and the last tenths of a nat took half of the search
MOMENT = 0.1  # s: frames so near say the same


@dataclass(frozen=True, eq=False)
class Estimate:
    """values by name, the ``fit`` that they come from, notes."""

    values: dict[str, float]
    fit: Fit
    notes: tuple[str, ...]


def unknowns_of(scenes: Sequence[Scene], config: Config) -> list[Unknown]:
    """What is fitted of the material, and of each hand of each recording (``rec<r>_grip<k>_...``).

    Priors: those of the kind of body, friction, that a hand is where it is said to be to 5 mm, and that frames whose rate was not recorded
    came at half to twice the rate that was meant.
    """
    log, body = np.log, scenes[0].body
    bodies = [scene.body for scene in scenes]
    found = body.unknowns(bodies) + (body.taut_unknowns(bodies) if any(len(scene.hands) > 1 for scene in scenes) else [])
    if any(scene.ground is not None for scene in scenes):
        found.append(Unknown("coulomb_friction", 0.5, 0.05, 2.0, "-", "log", prior=(log(0.5), 0.5)))
    for r, scene in enumerate(scenes):
        if not scene.timed:
            low, high = scene.fps / RATES, scene.fps * RATES
            found.append(Unknown(f"rec{r}_frame_rate", scene.fps, low, high, "1/s", "log", prior=(log(scene.fps), log(2.0))))
        for k in range(len(scene.hands)):
            if config.grips and k in scene.soft:
                at = f"rec{r}_grip{k}"
                found += [Unknown(f"{at}_shift_{axis}", 0.0, -SHIFT, SHIFT, "m", prior=(0.0, 0.005)) for axis in "xyz"]
                found.append(Unknown(f"{at}_reach", 1.0, 1 / REACH, REACH, "-", "log", prior=(0.0, 0.3)))
    return found


def own_values(values: dict, record: int) -> dict:
    """``values`` as the scene of a recording names them."""
    prefix = f"rec{record}_"
    return {name.removeprefix(prefix): v for name, v in values.items() if name.startswith(prefix) or not name.startswith("rec")}


def run_once(rows: Sequence[dict], run: Callable[[list[dict]], np.ndarray]) -> np.ndarray:
    """(K, ...) what ``run`` says of ``rows`` (K,) of values, of which those that are alike are run once.

    Of several recordings many are: numbers of one recording's own are turned there alone.
    """
    first: dict[tuple, int] = {}
    which = [first.setdefault(tuple((name, np.asarray(row[name]).tobytes()) for name in sorted(row)), len(first)) for row in rows]
    return run([rows[which.index(k)] for k in range(len(first))])[which]


def steps_of(simulators: Sequence[Simulator], values: dict[str, float]) -> int:
    """The most steps a frame that any recording takes with the ``values`` of all."""
    return max(int(np.prod(s.steps(own_values(values, r)))) for r, s in enumerate(simulators))


def run_within(rows: Sequence, run: Callable[[list], np.ndarray], steps: Callable[[Any], int], most: float, size: int) -> np.ndarray:
    """(K, size) m, what ``run`` says of ``rows`` (K,); NaN, as of what diverged, of those that take more than ``most`` steps a frame."""
    kept = [k for k, row in enumerate(rows) if steps(row) <= most]
    found = np.full((len(rows), size), np.nan)
    if kept:
        found[kept] = run([rows[k] for k in kept])
    return found


def estimate(
    recordings: Sequence[Observed],
    scenes: Sequence[Scene],
    config: Config,
    *,
    extra: Sequence[Term] = (),
    extra_unknowns: Sequence[Unknown] = (),
    fixed: dict[str, float] | None = None,
    begin: dict[str, float] | None = None,
    seed: int = 0,
    device: str = "cpu",
    progress: Callable[[str, float], None] | None = None,
) -> Estimate:
    """The likeliest numbers of ``scenes``, one for each of ``recordings``.

    extra    further terms, with ``extra_unknowns`` among their parameters
    fixed    values that are told and not fitted
    begin    where the search begins, as another twin of these scenes has it; unless given, from the starts of the kind of body

    A first search hears all tracks alike. Then members of an ensemble of sound twins, which differ in grip, material and mesh, say where
    in the motion sound twins part, and a second search from there hears the rest. Raises AllDiverged where every start blows up.
    """
    task = Task.of(recordings, scenes, config, tuple(extra), extra_unknowns, fixed or {}, device)
    kind, bodies = type(scenes[0].body), [scene.body for scene in scenes]
    coarse = task.coarser(recordings, kind.coarse if config.coarse is None else config.coarse)

    def told(stage, begin, share, iterations):
        def tell(iteration, cost, _values):
            if progress:
                progress(f"{stage}, iteration {iteration + 1}: cost {cost:.4g}", begin + share * (iteration + 1) / max(1, iterations))

        return tell

    options: dict[str, Any] = dict(independent=task.independent, seed=seed)
    led = LEADING if kind.horizons and not begin else 0.0
    if begin:
        starts = np.array([[begin.get(u.name, u.value) for u in task.unknowns]])
    else:
        starts = _timed(kind.starts(bodies, recordings, task.unknowns, config), task.unknowns)
        starts = _approached(coarse, recordings, starts, config, kind.horizons, progress)
    coarse = coarse.within(starts, config.dearest)
    most = kind.iterations if config.iterations is None else config.iterations
    search = Steps(iterations=most, tolerance=ARRIVED) if kind.horizons else Steps(iterations=most)
    found = fit(
        *coarse.asked,
        starts=starts,
        steps=search,
        progress=told("search", led, 0.5 - led, search.iterations),
        **options,
    )
    heard = task.rough  # of clouds too: which point of the body a point is, nobody knows
    if config.refinement and config.members and all(isinstance(s, Sight) for s in task.sights):
        heard = np.hypot(task.noise, _spread(found, task, coarse, config.members, seed))
    solved = UNLOADINGS if config.rest == "equilibrium" else 0
    for _ in range(max(1, solved) if config.refinement else 0):
        task = task.unloaded(recordings, found.values) if solved else task
        at = np.array([[found.values[u.name] for u in task.unknowns]])
        task = task.within(at, config.dearest)
        tell = told("refinement", 0.6, 0.4, config.refinement)
        found = fit(
            task.unknowns, task.simulate, task.data, heard, starts=at, steps=Steps(iterations=config.refinement), progress=tell, **options
        )
    return Estimate(task.fixed | found.values, found, found.notes)


@dataclass(frozen=True, eq=False)
class Task:
    """Unknowns, what they predict and what was measured, of one or several recordings, side by side (R,).

    most  steps a frame that are run: what would take more counts as diverged
    """

    unknowns: tuple[Unknown, ...]
    simulators: tuple[Simulator, ...]
    sights: tuple[Sight | CloudSight, ...]
    fixed: dict[str, float]
    most: float = np.inf

    @classmethod
    def of(cls, recordings, scenes, config, extra, extra_unknowns, fixed, device) -> Task:
        unknowns = tuple(u for u in [*unknowns_of(scenes, config), *extra_unknowns] if u.name not in fixed)
        simulators = tuple(Simulator(scene, extra, device) for scene in scenes)
        return cls(unknowns, simulators, tuple(sight_of(one, config.frames) for one in recordings), fixed)

    def within(self, starts, dearest: float) -> Task:
        """The same where no run takes more than ``dearest`` times the steps of the dearest of ``starts`` (K, n)."""
        return replace(self, most=dearest * max(self._steps(self._named(row)) for row in starts))

    def until(self, recordings, share: float) -> Task:
        """The same of which the first ``share`` of each motion alone is fitted."""
        sights = tuple(sight_of(one, min(s.frames, horizon(one, share))) for one, s in zip(recordings, self.sights, strict=True))
        return replace(self, sights=sights)

    @property
    def rough(self) -> np.ndarray:
        """(R,) m, by which data are off before it is known what can be predicted."""
        return np.hypot(self.noise, min(s.rough for s in self.sights))

    @property
    def asked(self) -> tuple[tuple[Unknown, ...], Callable[[np.ndarray], np.ndarray], np.ndarray, np.ndarray]:
        """What a search is asked before it is known what can be predicted: unknowns, what simulates them, data and their noise."""
        return self.unknowns, self.simulate, self.data, self.rough

    def coarser(self, recordings, times: float) -> Task:
        """The same in cells ``times`` as large."""
        pairs = zip(self.simulators, recordings, strict=True)
        found = [replace(s, scene=replace(s.scene, body=s.scene.body.coarser(one, times))) for s, one in pairs]
        return replace(self, simulators=tuple(found))

    def unloaded(self, recordings, values) -> Task:
        """The same with rest shapes such that each frame 0 is an equilibrium at ``values``."""
        found = []
        for r, (one, runner) in enumerate(zip(recordings, self.simulators, strict=True)):
            found.append(replace(runner, scene=runner.unloaded(one, own_values(self.fixed | values, r))))
        return replace(self, simulators=tuple(found))

    @property
    def data(self) -> np.ndarray:
        """(R,) m."""
        return np.concatenate([s.data for s in self.sights])

    @property
    def noise(self) -> np.ndarray:
        """(R,) m, infinite where nothing was seen."""
        return np.concatenate([s.deviations for s in self.sights])

    @property
    def independent(self) -> float:
        """How many data are independent: tracks of a region within a moment say the same."""
        moments = {1: 0.0, 3: 0.0}  # by the data that a place has at a time
        for sight, one in zip(self.sights, self.simulators, strict=True):
            moments[sight.dimensions] += sight.frames / (MOMENT * one.scene.fps)
        return float(min(sum(n * REGIONS * m for n, m in moments.items()), np.isfinite(self.noise).sum()))

    def predict(self, rows) -> np.ndarray:
        """(B, R) m, of dicts of values."""
        found = []
        for r, (runner, sight) in enumerate(zip(self.simulators, self.sights, strict=True)):
            own = [own_values(self.fixed | row, r) for row in rows]
            found.append(run_once(own, lambda alone, runner=runner, sight=sight: sight.predicted(runner.run(alone, sight.frames))))
        return np.concatenate(found, 1)

    def simulate(self, values) -> np.ndarray:
        """(B, R) m, of values (B, n) of the unknowns; NaN of what takes more steps than ``most``."""
        return run_within([self._named(row) for row in values], self.predict, self._steps, self.most, len(self.data))

    def _named(self, row) -> dict[str, float]:
        return dict(zip([u.name for u in self.unknowns], row, strict=True))

    def _steps(self, row) -> int:
        return steps_of(self.simulators, self.fixed | row)


def _spread(found, task, coarse, count, seed):
    """(R,) m, what sound twins of the same recordings are off that no choice of the unknowns absorbs.

    Members differ in grips, damping, drag and friction as far as priors allow; one is the same twin in other cells,
    where the search has larger ones.
    """
    jacobian, reference = _jacobian(found, coarse.simulate)
    unknowns, kind = task.unknowns, type(task.simulators[0].scene.body)
    ranges = [replace(u, prior=(found.scaled[k], u.prior[1])) for k, u in enumerate(unknowns) if u.prior and _is_nuisance(u.name, kind)]
    rows = [found.values | row for row in members(ranges, count, seed=seed)]
    runs = np.concatenate([coarse.predict(rows), task.predict([found.values])])
    block = np.concatenate([_blocks(s, r) for r, s in enumerate(task.sights)])
    frames = [np.arange(len(s.points)) / one.scene.fps for s, one in zip(task.sights, task.simulators, strict=True)]
    time = np.concatenate([np.repeat(t, s.points[0].size) for t, s in zip(frames, task.sights, strict=True)])
    precision = np.array([0.0 if u.prior is None else u.prior[1] ** -2 for u in unknowns])
    known = predictability(runs, reference, jacobian, task.noise, block=block, time=time, width=WIDTH, precision=precision)
    return known.spread


def _is_nuisance(name: str, kind) -> bool:
    return "grip" in name or name in (*kind.nuisances, "coulomb_friction")


def _jacobian(found: Fit, simulate):
    """((R, n) derivative of the prediction in the scaled space, (R,) prediction) where a fit ended."""
    at, unknowns = found.scaled, found.unknowns
    rows = [at.copy() for _ in range(len(at) + 1)]
    for k, u in enumerate(unknowns):
        rows[k][k] += u.difference if u.holds(at[k] + u.difference) else -u.difference
    runs = simulate(np.array([[u.decode(s) for u, s in zip(unknowns, row, strict=True)] for row in rows]))
    turned = np.array([rows[k][k] - at[k] for k in range(len(at))])
    slopes = (runs[:-1] - runs[-1]) / turned[:, None]
    return np.nan_to_num(slopes.T), runs[-1]


def _blocks(sight: Sight, record: int):
    """(R,) which of ``REGIONS`` parts of a body each coordinate belongs to: those that lie together in frame 0."""
    label = regions_of(np.nan_to_num(sight.points[0]), REGIONS)
    return np.tile(np.repeat(record * REGIONS + label, 3), len(sight.points))


def _timed(starts, unknowns):
    """``starts`` (K, n), each also with lower and higher rates of frames where these are unknown."""
    own = [k for k, u in enumerate(unknowns) if u.name.endswith("_frame_rate")]
    if not own:
        return starts
    found = np.repeat(starts[None], len(TRIED_RATES), 0)
    found[:, :, own] *= np.array(TRIED_RATES)[:, None, None]
    return found.reshape(-1, len(unknowns))


def horizon(recording: Observed, share: float) -> int:
    """Frames until hands have gone ``share`` of their way, the longest way of any; of the time where they do not move."""
    steps = np.linalg.norm(np.diff(recording.controllers[: recording.observed_frames], axis=0), axis=2).max(1, initial=0.0)
    way = np.cumsum(steps if steps.sum() > MOVED else np.ones(recording.observed_frames - 1))
    return max(SHORTEST, int(np.searchsorted(way, share * way[-1])) + 2)


def _approached(task: Task, recordings, starts, config: Config, horizons: Sequence[float], progress=None) -> np.ndarray:
    """(k, n) from where all of the motion is searched: the likeliest of ``starts`` (K, n), ``config.starts`` of them, or half as many
    that were led over the ``horizons``, growing shares of it.

    Early motion tells numbers before a body can go another way than they would have it; past that no descent leads back.
    """
    for k, share in enumerate(horizons):
        shorter, kept = task.until(recordings, share), config.starts * 2 ** (len(horizons) - 1 - k)
        if progress:
            progress(f"starts over {share:.0%} of the motion", LEADING * k / len(horizons))
        starts = _scouted(shorter, starts, kept)
        shorter = shorter.within(starts, config.dearest)
        starts = narrowed(*shorter.asked, starts=starts, steps=Steps(iterations=LED, kept=kept), independent=shorter.independent)
    return _scouted(task, starts, (config.starts + 1) // 2 if horizons else config.starts)


def _scouted(task: Task, starts, count: int):
    """The ``count`` likeliest of ``starts`` (K, n), which are run once."""
    if len(starts) <= count:
        return starts
    problem, seen = posed(task.unknowns, task.data, task.rough, StudentT(), task.independent)
    runs = task.simulate(starts)[:, seen]
    scaled = [[u.encode(v) for u, v in zip(task.unknowns, row, strict=True)] for row in starts]
    costs = [problem.place(np.array(s), run).cost for s, run in zip(scaled, runs, strict=True)]
    return starts[np.argsort(costs)[:count]]
