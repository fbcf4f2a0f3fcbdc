"""Runs a plan: fit once, roll out, score, remember. What goes wrong with a method becomes a row, never the end of the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from ..datasets.plugins import unknown
from ..datasets.scenario import ANOTHER_INTERACTION, Scenario
from ..methods.base import Budget, Method, Trajectory, Twin
from ..methods.modules import modules_of
from ..methods.registry import methods as known_methods
from ..metrics.base import Metric, lacking, scores
from .cache import Cache, digest
from .checksum import Checksums, images_of, interaction_of, observed_of
from .opening import Opened, folder_of
from .origin import Forerunners, Origin
from .plan import Evaluation, Fit, frames
from .progress import REMEMBERED, SCORED, say
from .provenance import device_name, peak_memory, provenance, reset_peak_memory
from .rendering import Appearances, Recent, Shown, appearance_class
from .sources import SOURCES
from .status import FAULTS, Stopped, as_status

__all__ = ["Rolled", "Runner", "Settings"]

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Settings:
    """What all rows of a run have in common, and the methods and metrics to use, by name.

    ``appearance()`` is the class of what twins are shown with where a metric looks at images.
    """

    methods: Mapping[str, Callable[[], Method]]
    metrics: Mapping[str, Metric]
    preset: str = "quick"
    device: str = "cpu"
    appearance: Callable[[], type] = appearance_class

    @property
    def images(self) -> bool:
        """Whether any metric looks at images."""
        return any(metric.images for metric in self.metrics.values())


@dataclass(frozen=True)
class Rolled:
    """A roll-out and what is scored of it: ``evaluations`` of one recording, ``target``; all are transfers, or none is.

    about       what its rows say of costs, and the twin's note
    trajectory  None where there is none, for any of ``evaluations``; ``row`` says why
    look        which appearance it is shown with
    """

    evaluations: tuple[Evaluation, ...]
    about: dict
    target: Scenario | None = None
    trajectory: Trajectory | None = None
    look: str = ""
    row: dict = field(default_factory=dict)


class Runner:
    """Computes the rows of one collection.

    A twin is stored under its method and the code that this imports, the content of its sources, seed, preset and device; a row under its
    twin, the content of its target, the task, the metrics' code and its appearance. Rows and twins that are there are not computed again.
    Failed rows are not stored: what made them fail (memory, a missing package) may be gone the next time. Nor are rows that lack images
    for such a cause.
    """

    def __init__(self, opened: Opened, settings: Settings, cache: Cache):
        self.collection, self.split = opened.collection, opened.split
        self.settings, self.cache = settings, cache
        self._folder = str(folder_of(opened.path).resolve()) if opened.path else ""
        self._checksums = Checksums(cache, opened.key)
        self._loaded: WeakValueDictionary[str, Scenario] = WeakValueDictionary()
        self._held: list[Scenario] = []
        options = {"preset": settings.preset, "device": settings.device, "folder": self._folder}
        self._appearances = Appearances(cache, **options, kind=settings.appearance)
        self._unseen: set[Evaluation] = set()
        self._forerunners, self._said = Forerunners(cache, "fits"), set()
        self._lost: dict[str, str] = {}

    def run(self, fits: list[Fit], *, progress: Progress = lambda label, fraction: None) -> list[dict]:
        """The rows of ``fits``. ``progress(label, fraction)`` is told what is going on and how much of everything is done.

        A recording that cannot be read is the status "unreadable" of all rows that need it. Raises OSError where the cache cannot be
        written, ValueError where the device is not there.
        """
        self.cache.sweep()
        self.learn(fits, progress)  # here, so that a recording that cannot be read is known before hours of work
        rows = []
        for i, fit in enumerate(fits):
            label = f"{fit.method} on {_short(fit.sources)}"
            progress(label, i / len(fits))
            told: list[str] = []

            def report(stage: str, fraction: float, *, i=i, label=label, told=told) -> None:
                told[:] = [stage]
                progress(f"{label}: {stage}", (i + min(max(fraction, 0.0), 1.0)) / len(fits))

            rows += self._rows(fit, report)
            progress(f"{label}: {SCORED if told else REMEMBERED}", (i + 1) / len(fits))
        progress("done", 1.0)
        return rows

    def learn(self, fits: Iterable[Fit], progress: Progress = lambda label, fraction: None) -> None:
        """Read the recordings of which it is not known yet what they hold; those that cannot be read are known as lost then."""
        names = [name for fit in fits for name in (*fit.sources, *(evaluation.target for evaluation in fit.evaluations))]
        for name in dict.fromkeys(names):
            progress(f"reading {name}", 0.0)
            with suppress(Stopped):
                self._checksums.learn([name], self._load, images=self.settings.images)

    def _rows(self, fit: Fit, report: Progress) -> list[dict]:
        found = self._lost_rows(fit)
        whole = replace(fit, evaluations=tuple(evaluation for evaluation in fit.evaluations if evaluation not in found))
        if fit.skip:
            found |= dict.fromkeys(whole.evaluations, self._row({"status": "skipped", "reason": fit.skip}, {}))
        elif whole.evaluations:
            try:
                found |= self._scored(whole, report)
            except Stopped as stopped:  # and so may a source be lost
                found |= dict.fromkeys(whole.evaluations, self._row(stopped.row, {}))
        return [{**self._identity(fit, evaluation), **found[evaluation]} for evaluation in fit.evaluations]

    def _lost_rows(self, fit: Fit) -> dict[Evaluation, dict]:
        """Rows of what cannot be scored because a recording cannot be read, one that is fitted or the one that is scored; or because what
        should be a transfer shows what was fitted.
        """
        found = {}
        for evaluation in fit.evaluations:
            reasons = [self._lost[name] for name in dict.fromkeys((*fit.sources, evaluation.target)) if name in self._lost]
            if reasons:
                found[evaluation] = self._row({"status": "unreadable", "reason": "; ".join(reasons)}, {})
            elif evaluation.task == "transfer" and (same := self._repeated(fit, evaluation)):
                reason = f"{ANOTHER_INTERACTION}, got the same as {same} (scenario {evaluation.target})"
                found[evaluation] = self._row({"status": "failed", "reason": reason}, {})
        return found

    def _repeated(self, fit: Fit, evaluation: Evaluation) -> str:
        """The fitted recording that shows the same interaction as the one that is scored, or ""."""
        scored = self._checksums[interaction_of(evaluation.target)]
        return next((name for name in fit.sources if self._checksums[interaction_of(name)] == scored), "")

    def _scored(self, fit: Fit, report: Progress) -> dict[Evaluation, dict]:
        origins = {evaluation: self.row_origin(fit, evaluation) for evaluation in fit.evaluations}
        found: dict[Evaluation, Any] = {evaluation: self.cache.read("rows", origin.key) for evaluation, origin in origins.items()}
        missing = [evaluation for evaluation, row in found.items() if row is None]
        for evaluation, row in self._compute(fit, missing, report) if missing else ():
            found[evaluation] = row
            if row["status"] not in FAULTS and evaluation not in self._unseen:
                origin = self.row_origin(fit, evaluation)  # a metric may have turned out to be unavailable
                self.cache.write("rows", origin.key, row, origin.made)
        return found

    def _compute(self, fit: Fit, evaluations: list[Evaluation], report: Progress) -> Iterator[tuple[Evaluation, dict]]:
        device_name(self.settings.device)  # raises where it is not there
        for rolled in self._rollouts(fit, evaluations, report):
            if rolled.trajectory is None or rolled.target is None:
                yield from ((evaluation, self._row(rolled.row, rolled.about)) for evaluation in rolled.evaluations)
                continue
            shown = self._shown(rolled.trajectory, rolled.evaluations[0].target, rolled.look, report)
            for evaluation in rolled.evaluations:
                self._unseen.discard(evaluation)
                faults: dict[str, str] = {}
                row = self._row(self._score(shown, rolled.target, evaluation.task, faults), rolled.about)
                if shown.faults or faults:
                    self._unseen.add(evaluation)
                yield evaluation, row

    def _rollouts(self, fit: Fit, evaluations: Sequence[Evaluation], report: Progress) -> Iterator[Rolled]:
        """The roll-outs that ``evaluations`` score, or why there are none."""
        try:
            method = self._method(fit.method)
            if method.skip_transfer and all(evaluation.task == "transfer" for evaluation in evaluations):
                raise Stopped(status="skipped", reason=method.skip_transfer)  # nothing asks for the twin
            self._held = [self._load(name) for name in fit.sources]  # for the next method on the same sources
            self._refuse(method, self._held)
            with as_status():
                if reason := method.skip_jointly(self._held):
                    raise Stopped(status="skipped", reason=reason)
            twin, about = self._twin(method, fit, report)
        except Stopped as stopped:
            yield Rolled(tuple(evaluations), {}, row=stopped.row)
            return
        for target in dict.fromkeys(evaluation.target for evaluation in evaluations):
            report(f"scoring {target}", 1.0)
            wanted = [evaluation for evaluation in evaluations if evaluation.target == target]
            try:
                recording = self._load(target)
            except Stopped as stopped:  # it was there at the start and is not any more
                yield Rolled(tuple(wanted), {}, row=stopped.row)
                continue
            yield from self._placed(method, twin, about, wanted, recording)

    def _method(self, name: str) -> Method:
        with as_status():
            return self._found(name)()

    def _found(self, name: str) -> Callable[[], Method]:
        """The method of that name among those of this run; or, as one of them builds on it, among all."""
        found = self.settings.methods.get(name) or (known := known_methods()).get(name)
        if found is None:
            raise unknown("method", name, known)
        return found

    def _refuse(self, method: Method, scenarios: list[Scenario]) -> None:
        for scenario in scenarios:
            with as_status():
                if reason := method.skip(scenario):
                    raise Stopped(status="skipped", reason=reason)

    def _twin(self, method: Method, fit: Fit, report: Progress) -> tuple[Twin, dict]:
        """The fitted twin as the cache holds it, so that a resumed run and an uninterrupted one score the same."""
        with as_status():
            twin_class = _twin_class(method)
        origin = self.origin(fit)
        stored = self.cache.read_folder("fits", origin.key)
        if stored is None:
            self._fit(method, fit, origin, report)
            stored = self.cache.read_folder("fits", origin.key)
        if stored is None:
            raise OSError(f"the twin just written to {self.cache.root} cannot be read back")
        folder, about = stored
        with as_status():
            return twin_class.load(folder), about

    def _fit(self, method: Method, fit: Fit, origin: Origin, report: Progress) -> None:
        self._explain(fit, origin)
        # a yardstick is no method: it is scored on what it has seen, and says so
        observed = self._held if getattr(method, "whole", False) else [scenario.observed() for scenario in self._held]
        settings = self.settings
        options, spent = self._start(method, fit, report)
        reset_peak_memory()
        start = time.perf_counter()
        with as_status():
            twin = method.fit(observed, budget=Budget(settings.preset), seed=fit.seed, device=settings.device, progress=report, **options)
            if not isinstance(twin, promised := _twin_class(method)):
                raise TypeError(f"fit returned a {type(twin).__name__}, and twin_class of the method is {promised.__name__}")
            if not isinstance(twin.note, str):
                raise TypeError(f"a twin's note must be a string, got {twin.note!r}")
        about = {"fit_seconds": spent + time.perf_counter() - start, **peak_memory(), "note": twin.note}
        try:
            self.cache.write_folder("fits", origin.key, twin.save, about, origin.made)
        except OSError:
            raise
        except Exception:
            with as_status():
                raise

    def _start(self, method: Method, fit: Fit, report: Progress) -> tuple[dict, float]:
        """The option of ``fit`` that holds the twin that a method builds on, if it does, and the seconds that it took to fit that."""
        if not method.builds_on:
            return {}, 0.0
        fit = replace(fit, method=method.builds_on)
        twin, about = self._twin(self._method(fit.method), fit, report)
        return {"start": twin}, about["fit_seconds"]

    def _placed(self, method: Method, twin: Twin, about: dict, evaluations: list[Evaluation], target: Scenario) -> Iterator[Rolled]:
        """One roll-out from frame 0 for each way of placing the twin."""
        for transfer in (False, True):
            wanted = tuple(evaluation for evaluation in evaluations if (evaluation.task == "transfer") == transfer)
            if not wanted:
                continue
            costs = {name: about[name] for name in ("fit_seconds", "peak_memory_mib", "peak_device_memory_mib", "note")}
            try:
                if transfer and method.skip_transfer:
                    raise Stopped(status="skipped", reason=method.skip_transfer)
                if transfer:
                    self._refuse(method, [target])
                trajectory, costs = self._roll_out(twin, costs, target, transfer)
            except Stopped as stopped:
                yield Rolled(wanted, costs, row=stopped.row)
                continue
            yield Rolled(wanted, costs, target, trajectory, method.appearance)

    def _roll_out(self, twin: Twin, about: dict, target: Scenario, transfer: bool) -> tuple[Trajectory, dict]:
        reset_peak_memory()
        start = time.perf_counter()
        with as_status():
            placed = twin.retarget(target.initial()) if transfer else twin
            trajectory = placed.rollout(target.controllers)
            if not isinstance(trajectory, Trajectory) or np.asarray(trajectory.positions).dtype.kind != "f":
                raise TypeError(f"rollout must return a Trajectory of floats, got {type(trajectory).__name__}")
            if len(trajectory.positions) != target.frame_count:
                raise ValueError(f"the roll-out has {len(trajectory.positions)} frames, the controllers have {target.frame_count}")
        peaks = {name: max(value, about[name]) for name, value in peak_memory().items()}
        return trajectory, {**about, **peaks, "rollout_seconds": time.perf_counter() - start}

    def _shown(self, trajectory: Trajectory, target: str, look: str, report: Progress) -> Shown:
        """The roll-out with the appearance ``look`` of the recording ``target``, which is fitted when a metric first asks for an image."""

        def appearance():
            self._checksums.learn([target], self._load, images=True)
            checksums = {name: self._checksums[name] for name in (target, images_of(target))}
            told = f"appearance of {target}"
            return self._appearances.of(self._load(target), checksums, look, lambda stage, _: report(f"{told}: {stage}", 1.0))

        return Shown.of(trajectory, appearance)

    def _score(self, trajectory: Shown, target: Scenario, task: str, faults: dict[str, str]) -> dict:
        wanted = frames(task, target.split)
        if not wanted:
            return {"status": "skipped", "reason": f"the recording has no frames for {task}"}
        lost = np.flatnonzero(~np.isfinite(trajectory.positions[: wanted[-1] + 1]).all(axis=(1, 2)))
        if len(lost):
            return {"status": "diverged", "reason": "positions are not finite", "diverged_frame": int(lost[0])}
        row: dict = {"status": "ok", "frames": len(wanted)}
        if target.images is not None and self.settings.images:
            target = replace(target, images=Recent(target.images))
        try:
            with as_status():
                for name, result in scores(self.settings.metrics, trajectory, target, wanted, faults=faults).items():
                    row |= {name: result.mean, f"{name}_unscorable": result.unscorable, f"{name}_reason": result.reason}
        except Stopped as stopped:
            return stopped.row
        return row

    def _row(self, result: dict, about: dict) -> dict:
        """Everything of a row that the cache keeps, in the order of the columns."""
        nothing = {"status": "", "reason": "", "diverged_frame": None, "note": ""}
        for name in self.settings.metrics:
            nothing |= {name: float("nan"), f"{name}_unscorable": 0, f"{name}_reason": ""}
        costs = dict.fromkeys(("fit_seconds", "rollout_seconds", "peak_memory_mib", "peak_device_memory_mib"), float("nan"))
        return {**nothing, "frames": 0, **costs, **result, **about, **provenance(self.settings.device)}

    def _identity(self, fit: Fit, evaluation: Evaluation) -> dict:
        return {
            "collection": self.collection.name,
            "scenario": evaluation.target,
            "sources": "+".join(fit.sources),
            "method": fit.method,
            "task": evaluation.task,
            "seed": fit.seed,
            "preset": self.settings.preset,
            "split": self.split,
            "appearance": self._look(fit, evaluation),
            "data_checksum": "" if evaluation.target in self._lost else self._checksums[evaluation.target],
            "images_checksum": self._images(evaluation.target),
            "code_checksum": digest(SOURCES.files(*self._modules(fit.method))),
        }

    def _modules(self, name: str) -> tuple[str, ...]:
        """The modules whose code makes a method's twins, with those of the method that it builds on."""
        found = self._found(name)
        modules = [*modules_of(found)]
        if base := getattr(found, "builds_on", None):
            with suppress(ValueError):  # there is none: that is said where it is fitted
                modules += self._modules(base)
        return tuple(dict.fromkeys(modules))

    def origin(self, fit: Fit) -> Origin:
        """What a twin is made from."""
        found, modules = self._found(fit.method), self._modules(fit.method)
        kinds = tuple(getattr(found, "reads_images", ()))  # plain callables make methods as well
        self._checksums.learn(fit.sources, self._load, fitted=kinds)
        data = [*fit.sources, *(observed_of(name, kinds) for name in fit.sources if kinds)]
        inputs = {
            "method": getattr(found, "key", fit.method),
            "code": SOURCES.files(*modules),
            "data": [self._checksums[name] for name in data],
            "seed": fit.seed,
            "preset": self.settings.preset,
            "device": self.settings.device,
        }
        return Origin(inputs, self._subject(fit, data, modules))

    def _images(self, target: str) -> str:
        """The checksum of a recording's images; "" where no metric looks at images or there are none."""
        return self._checksums[images_of(target)] if self.settings.images and target not in self._lost else ""

    def _look(self, fit: Fit, evaluation: Evaluation) -> str:
        """Which appearance the twin is shown with; "" where no metric looks at images or there are none."""
        return getattr(self._found(fit.method), "appearance", Method.appearance) if self._images(evaluation.target) else ""

    def row_origin(self, fit: Fit, evaluation: Evaluation) -> Origin:
        """What a row is made from."""
        origin, metrics = self.origin(fit), self.settings.metrics
        images = self._checksums[images_of(evaluation.target)] if self.settings.images else ""
        wanted = {name: metric for name, metric in metrics.items() if images or not metric.images}
        available = [name for name, metric in wanted.items() if lacking(metric) is None]  # not asked where there are no images
        shown = modules_of(self.settings.appearance()) if images else ()
        modules = tuple(dict.fromkeys(module for found in (*map(modules_of, metrics.values()), shown) for module in found))
        data = [*origin.subject["data"], evaluation.target, *([images_of(evaluation.target)] if images else [])]
        inputs = {
            **origin.inputs,
            "code": origin.inputs["code"] | SOURCES.files(*modules),
            "data": [self._checksums[name] for name in data],
            "task": evaluation.task,
            "look": self._look(fit, evaluation),
            "kind": getattr(self.settings.appearance(), "key", None) if images else None,
            "metrics": [[name, metric.version, name in available] for name, metric in metrics.items()],
        }
        subject = self._subject(fit, data, (*origin.subject["modules"], *modules))
        return Origin(inputs, subject | {"target": evaluation.target, "task": evaluation.task})

    def _subject(self, fit: Fit, data: Iterable[str], modules: Iterable[str]) -> dict:
        return {
            "method": fit.method,
            "recordings": list(fit.sources),
            "collection": self.collection.name,
            "folder": self._folder,
            "data": list(data),
            "modules": list(modules),
        }

    def _explain(self, fit: Fit, origin: Origin) -> None:
        """Say why a twin is fitted again, once for each reason."""
        why = self._forerunners.why(origin)
        if why and (fit.method, why) not in self._said:
            self._said.add((fit.method, why))
            say(f"{fit.method} on {_short(fit.sources)}: refitted because {why}")

    def _load(self, name: str) -> Scenario:
        """The recording of that name, read once. Raises Stopped where it cannot be read, and does not try again."""
        scenario = self._loaded.get(name)
        if scenario is None and name not in self._lost:
            try:
                scenario = self._loaded[name] = self.collection.load(name)
            except ImportError:  # a package that is asked for: no fault of the recording
                raise
            except Exception as error:  # a damaged file may make any reader fail in any way
                said = str(error) if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {error}"
                self._lost[name] = f"{name} cannot be read: {said}"
        if scenario is None:
            raise Stopped(status="unreadable", reason=self._lost[name])
        return scenario


def _twin_class(method: Method) -> type[Twin]:
    """What a method says of its twins. Raises TypeError where it says nothing of the kind."""
    found = getattr(method, "twin_class", None)
    if not (isinstance(found, type) and issubclass(found, Twin)):
        raise TypeError(f"twin_class of a method must be the class of the twins that its fit returns, got {found!r}")
    return found


def _short(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
