"""What ``twinbench run`` does, for Python: which tables are asked for, and the results of each."""

from __future__ import annotations

import copy
import inspect
import os
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ..datasets.collection import Collection
from ..methods.base import Method
from ..metrics.base import Metric
from .ablations import ABLATIONS
from .cache import Cache, default_cache
from .config import config_text
from .executors.base import Executor
from .experiment import Experiment, Work
from .opening import Opened, open_all
from .options import DEVICES, SPLITS, chosen, chosen_methods, chosen_metrics, known, writable
from .plan import TASKS
from .presets import PRESETS
from .provenance import origin
from .results import Results

__all__ = ["Study", "run", "studies"]

Names = str | Sequence[str] | None
Recordings = str | os.PathLike | Collection
Methods = str | type[Method] | Sequence[str | type[Method]] | Mapping[str, Callable[[], Method]] | None
Metrics = str | Metric | Sequence[str | Metric] | None


@dataclass(frozen=True)
class Study:
    """One table: what is compared, where, and how it is computed. ``options`` are what was asked for, as ``about.json`` has them."""

    experiment: Experiment
    work: Work
    cache: Cache
    budget: str
    options: Mapping
    jobs: int | None = None
    quiet: bool = False
    executor: Executor | None = None

    @property
    def collections(self) -> list[str]:
        """Names of the recordings' collections."""
        return [found.collection.name for found, _ in self.work]

    @property
    def config(self) -> str:
        """The file from which ``twinbench run --config`` does this again; "" where it cannot know the recordings or methods by name."""
        from ..methods.registry import methods
        from ..metrics.base import metrics

        options, of = self.options, self.experiment
        named = set(options["metrics"]) <= set(metrics()) and (options["ablation"] or set(options["methods"]) <= set(methods()))
        written = all(found.path for found, _ in self.work) and not any(isinstance(one, _Unwritten) for one in of.methods.values())
        if not (named and written):
            return ""
        data = [path if path == "sample" else os.path.abspath(path) for path in options["data"]]
        return config_text("run", {**options, "data": data})

    def run(self) -> Results:
        """Its results. Raises as ``Experiment.run`` does."""
        began = datetime.now(UTC)
        device = self.options["device"]
        how = {"jobs": self.jobs, "quiet": self.quiet, "executor": self.executor}
        results = self.experiment.run(self.work, cache=self.cache, budget=self.budget, device=device, **how)
        used = [*self.experiment.methods.values(), *self.experiment.metrics.values()]
        return replace(results, origin=origin(began, used, self.options))

    def write(self, results: Results, place: Path, *, board: Path | None = None) -> Results:
        """``results`` with the new ``folder`` in ``place`` that they were written to; their leaderboard goes there, or to ``board``."""
        from .run_files import write_run

        asked = self.experiment
        return write_run(results, place, says=asked.says, published=asked.published, board=board, config=self.config)


def run(
    data: Recordings | Sequence[Recordings] | None = None,
    *,
    methods: Methods = None,
    metrics: Metrics = None,
    tasks: Names = None,
    seeds: int | Sequence[int] = (0,),
    scenarios: Names = None,
    ablation: str = "",
    preset: str = "quick",
    device: str = "cpu",
    split: str = "published",
    jobs: int | None = None,
    executor: Executor | None = None,
    cache: str | os.PathLike | None = None,
    out: str | os.PathLike | None = None,
    quiet: bool = False,
) -> Results:
    """Fit twins, roll them out and score them, as ``twinbench run`` does: rows and means as DataFrames, lengths in metres.

    data       recordings: "sample" (the default), folders in a known layout, or a Collection
    methods    names, or subclasses of Method of your own; default static, rigid and phystwin
    metrics    names, or Metrics of your own; default all
    tasks      any of resimulation, prediction, transfer; default all
    scenarios  names of recordings to score; default all
    ablation   the name of an ablation to compare instead of methods
    preset     how much work a fit may do: "quick" or "full"
    jobs       how many processes share the work; the results are the same. Default: one for each graphics card, or this one
    executor   who does the work instead, on a cluster (see ``benchmark.executors``): ``DaskWorkers(address)``, ``Slurm(options)``
    cache      folder of fitted twins and scored rows; default $TWINBENCH_CACHE or .cache/twinbench
    out        folder in which the run gets a folder of its own; nothing is written where it is None

    Raises ValueError for an unknown name or option, and where no recording can be read. A recording that cannot be read beside others,
    and a method that fails, are rows that say so.
    """
    found = studies(
        data,
        methods=methods,
        metrics=metrics,
        tasks=tasks,
        seeds=seeds,
        scenarios=scenarios,
        ablation=ablation,
        preset=preset,
        device=device,
        split=split,
        jobs=jobs,
        executor=executor,
        cache=cache,
        quiet=quiet,
    )
    if len(found) > 1:
        raise ValueError(f"preset {preset!r} is {len(found)} tables: choose methods, or an ablation of {', '.join(ABLATIONS)}")
    place = None if out is None else writable(Path(out), option="out")
    results = found[0].run()
    return results if place is None else found[0].write(results, place)


def studies(
    data=None,
    *,
    methods=None,
    metrics=None,
    tasks=None,
    seeds=(0,),
    scenarios=None,
    ablation="",
    preset="quick",
    device="cpu",
    split="published",
    jobs=None,
    executor=None,
    cache=None,
    quiet=False,
) -> list[Study]:
    """The tables that are asked for, by the options of ``run``: the main one and its preset's ablations, or one ablation."""
    for option, value, choices in (("preset", preset, PRESETS), ("device", device, DEVICES), ("split", split, SPLITS)):
        known(option, [value], choices)
    given = {"data": data, "methods": methods, "tasks": tasks, "seeds": seeds}
    for option, value in given.items():
        if isinstance(value, Sequence) and not isinstance(value, str) and not value:
            raise ValueError(f"--{option} needs at least one value")
    if jobs is not None and jobs < 1:
        raise ValueError(f"--jobs must be at least 1, got {jobs}")
    defaults, store = PRESETS[preset], Cache(Path(cache) if cache else default_cache())
    tasks, scenarios, seeds = _listed(tasks), _listed(scenarios), [seeds] if isinstance(seeds, int) else list(seeds)
    wanted = _experiments(defaults, methods, chosen_metrics() if metrics in (None, ()) else _metrics(metrics), tasks, ablation)
    opened = _opened(data, preset, split, store)
    known("scenario", scenarios, list(dict.fromkeys(name for found in opened for name in found.collection.scenarios)))
    planned = [(one, work) for one in wanted if (work := one.plan(opened, seeds=seeds, scenarios=scenarios))]
    if not planned:
        raise ValueError(f"nothing to do: no task of {', '.join(wanted[0].tasks)} is scored on the chosen recordings")
    shared = {"data": [found.path or found.collection.name for found in opened], "seeds": seeds, "scenarios": scenarios}
    shared |= {"preset": preset, "device": device, "split": split, "jobs": jobs} | (executor.options if executor else {})
    found = []
    for one, work in planned:
        own = {"methods": list(one.methods), "metrics": list(one.metrics), "tasks": list(one.tasks), "ablation": one.name}
        found.append(Study(one, work, store, defaults.budget, shared | own, jobs, quiet, executor))
    return found


def _opened(data, preset: str, split: str, cache: Cache) -> list[Opened]:
    if data is None:
        data = PRESETS[preset].data
        for path in data:
            if path != "sample" and not Path(path).exists():
                raise ValueError(
                    f"--preset {preset} is for the recordings in {path}: twinbench download data brings them, --data names others"
                )
    data = [data] if isinstance(data, str | os.PathLike | Collection) else list(data)
    made = [Opened(one, split=split) for one in data if isinstance(one, Collection)]
    return [*open_all([os.fspath(one) for one in data if not isinstance(one, Collection)], split=split, cache=cache), *made]


def _experiments(preset, methods, metrics: Mapping[str, Metric], tasks: Sequence[str], ablation: str) -> list[Experiment]:
    """The main table and the preset's ablations, or the one ablation that is asked for."""
    known("task", tasks, TASKS)
    if ablation:
        known("ablation", [ablation], ABLATIONS)
        found = Experiment.of(ablation, metrics, tasks=tasks)
        return [replace(found, methods=chosen("variant", _listed(methods), dict(found.methods)))] if methods else [found]
    main = Experiment(_methods(methods or preset.methods), metrics, tuple(tasks) or tuple(TASKS))
    further = () if methods or tasks else preset.ablations
    return [main, *(Experiment.of(name, metrics) for name in further)]


def _listed(names: Names) -> list[str]:
    return [] if names is None else [names] if isinstance(names, str) else list(names)


def _methods(given: Methods) -> dict[str, Callable[[], Method]]:
    if isinstance(given, Mapping):
        return dict(given)
    found: dict[str, Callable[[], Method]] = {}
    for one in [given] if isinstance(given, str | type) else given or ():
        if isinstance(one, str):
            found |= chosen_methods([one])
        elif isinstance(one, type) and issubclass(one, Method):
            found[one.name] = one if _file(one) else _Unwritten(one)
        else:
            raise ValueError(f"methods must be names or subclasses of Method, got {one!r}")
    return found


def _metrics(given: Metrics) -> dict[str, Metric]:
    found: dict[str, Metric] = {}
    for one in [given] if isinstance(given, str | Metric) else given or ():
        if isinstance(one, str):
            found |= chosen_metrics([one])
        elif isinstance(one, Metric):
            found[one.name] = one if type(one).__module__.startswith("twinbench.") else copy.copy(one)
            copied: Any = found[one.name]
            if copied is not one:
                copied.version = f"{one.version} {_identity(type(one))}"  # nobody raises the version of what is being tried out
        else:
            raise ValueError(f"metrics must be names or instances of Metric, got {one!r}")
    return found


def _file(kind: type) -> Path | None:
    """The file that a class is written in; None in a notebook or at a prompt."""
    try:
        file = Path(inspect.getsourcefile(kind) or "")
    except (TypeError, OSError):
        return None
    return file if file.is_file() else None


def _identity(kind: type) -> str:
    """What tells a class from its later versions: its file's content, or, where it has no file, this very class in this process."""
    file = _file(kind)
    return _SEEN.setdefault(kind, uuid.uuid4().hex) if file is None else file.read_text(encoding="utf-8")


_SEEN: dict[type, str] = {}


class _Unwritten:
    """A method that is in no file: its twins are remembered for as long as this very class is there. Else it is what its class is."""

    def __init__(self, kind: type[Method]):
        self._kind, self.__doc__, self.__module__ = kind, kind.__doc__, kind.__module__
        self.key = [kind.name, _identity(kind)]
        self.modules = tuple(dict.fromkeys(base.__module__ for base in kind.__mro__ if _file(base)))

    def __call__(self) -> Method:
        return self._kind()

    def __getattr__(self, name: str):
        return getattr(self._kind, name)
