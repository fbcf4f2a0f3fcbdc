"""One table's worth of work: what is compared, in which tasks, by which metrics. A run is one of these, or several."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from ..methods.base import Method
from ..metrics.base import Metric
from .ablations import ABLATIONS, Ablation, with_clips
from .cache import Cache
from .executors.base import Executor
from .opening import Opened
from .plan import TASKS, Fit, plan
from .processes import cards
from .progress import Bar
from .results import Results
from .runner import Runner, Settings
from .spread import spread

__all__ = ["Experiment"]

Work = Sequence[tuple[Opened, list[Fit]]]


@dataclass(frozen=True)
class Experiment:
    """``methods`` and ``metrics`` by name, ``tasks``; an ablation has a ``name`` and one line that ``says`` what it asks.

    published   methods of published tables to print beside ours; None means all
    clips       how many recordings of the object twins of a method are fitted on, where it is not one
    """

    methods: Mapping[str, Callable[[], Method]]
    metrics: Mapping[str, Metric]
    tasks: tuple[str, ...] = tuple(TASKS)
    name: str = ""
    says: str = ""
    published: tuple[str, ...] | None = None
    clips: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, name: str, metrics: Mapping[str, Metric], *, tasks: Iterable[str] = (), ablation: Ablation | None = None) -> Experiment:
        """The ablation of that name, by those of ``metrics`` that it looks at, in ``tasks`` or else its own."""
        ablation = ablation or ABLATIONS[name]
        methods = ablation.methods()
        return cls(
            methods,
            {key: metric for key, metric in metrics.items() if not ablation.metrics or key in ablation.metrics},
            tuple(tasks) or ablation.tasks or tuple(TASKS),
            name,
            f"{name}: {ablation.says}",
            ablation.published,
            {key: count for key, method in methods.items() if (count := getattr(method, "clips", None)) is not None},
        )

    def plan(self, opened: Iterable[Opened], *, seeds: Iterable[int] = (0,), scenarios: Sequence[str] = ()) -> Work:
        """The fits of each collection that has any. ``scenarios`` keeps only rows scored on these; none means all."""
        work = []
        for found in opened:
            chosen = tuple(name for name in scenarios if name in found.collection.scenarios)
            if scenarios and not chosen:
                continue
            fits = plan(found.collection, methods=self.methods, tasks=self.tasks, seeds=seeds, scenarios=chosen)
            if fits:
                work.append((found, with_clips(fits, found.collection, dict(self.clips))))
        return work

    def settings(self, budget: str, device: str) -> Settings:
        """What all rows of a run have in common."""
        return Settings(self.methods, self.metrics, budget, device)

    def run(
        self,
        work: Work,
        *,
        cache: Cache,
        budget: str,
        device: str,
        jobs: int | None = None,
        quiet: bool = False,
        executor: Executor | None = None,
    ) -> Results:
        """What comes of ``work``, computed by ``executor``, or by ``jobs`` processes: by default one for each graphics card, or one.

        Raises as ``Runner.run`` and ``spread`` do, and ValueError where not one recording can be read.
        """
        settings, rows = self.settings(budget, device), []
        devices = () if executor else cards(device)  # those of this machine
        for found, fits in work:
            with Bar(" ".join(filter(None, (found.collection.name, self.name))), [fit.method for fit in fits], quiet=quiet) as bar:
                if executor:
                    rows += spread(found, settings, cache, fits, executor=executor, progress=bar)
                elif (count := jobs or (len(devices) if found.path else 1)) > 1:
                    rows += spread(found, settings, cache, fits, devices, jobs=count, progress=bar)
                else:
                    rows += Runner(found, settings, cache).run(fits, progress=bar)
        if rows and all(row["status"] == "unreadable" for row in rows):
            raise ValueError("; ".join(dict.fromkeys(row["reason"] for row in rows)))
        return Results.of(rows, self.metrics, [found.collection for found, _ in work]).beside(self.published)
