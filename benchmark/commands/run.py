"""``twinbench run``: fit, roll out, score, and print the table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from ..options import DEVICES, SPLITS, Names, chosen, chosen_methods, chosen_metrics, known, writable

__all__ = ["Run"]


@dataclass(frozen=True)
class Run:
    """Fit twins, roll them out, score them, and print the table.

    Fitted twins and scored rows are kept in .cache/twinbench (or $TWINBENCH_CACHE): a killed run goes on where it stopped and a
    repeated run is instant. A method that fails or diverges on a recording is said below the table; the exit code is 1 if any failed.
    """

    data: Annotated[tuple[str, ...] | None, arg(metavar="PATH ...")] = None
    """Recordings: "sample" for the ones that ship with twinbench (the default), or folders in a known layout (see twinbench list)."""
    scenarios: Names = ()
    """Score only these recordings. Default: all."""
    methods: Names | None = None
    """Methods to compare (see twinbench list), with spaces or commas between them. all: every one but phystwin+diagnosed, which takes
    as long as several others. Default: static rigid phystwin."""
    ablation: str = ""
    """Compare what an ablation compares (see twinbench list), instead of methods."""
    metrics: Names = ()
    """Score only these (see twinbench list). Default: all. Without those of images no appearance is fitted, which is much faster."""
    tasks: Names | None = None
    """Any of: resimulation, prediction, transfer. Default: all; of an ablation, its own."""
    seeds: Annotated[tuple[int, ...], arg(metavar="INT ...")] = (0,)
    """Seeds; every method is fitted once with each."""
    preset: str = "quick"
    """How much work a fit may do: quick or full. paper: full, and all tables of the PhysTwin paper for the recordings in ./data."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""
    split: str = "published"
    """Which split: published, or clean (no recording session on both sides)."""
    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder for the rows, table.md, table.tex and the leaderboard. Default: results/NAME of the recordings; an ablation's beside it."""
    leaderboard: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder for leaderboard.md, leaderboard.csv and leaderboard.tex. Default: that of --out."""
    report: Annotated[Path | None, arg(metavar="FILE")] = None
    """Also write one HTML file with the tables and, frame by frame, what every twin did. It opens without a network."""

    def __call__(self) -> int:
        from ..cache import Cache, default_cache
        from ..opening import open_recordings
        from ..presets import PRESETS

        for option, value, choices in (("preset", self.preset, PRESETS), ("device", self.device, DEVICES), ("split", self.split, SPLITS)):
            known(option, [value], choices)
        for option in ("data", "methods", "tasks", "seeds"):
            if getattr(self, option) == ():
                raise ValueError(f"--{option} needs at least one value")
        preset, cache = PRESETS[self.preset], Cache(default_cache())
        wanted = self._experiments(preset)
        for path in () if self.data else preset.data:
            if path != "sample" and not Path(path).exists():
                raise ValueError(
                    f"--preset {self.preset} is for the recordings in {path}: twinbench download data brings them, --data names others"
                )
        opened = [open_recordings(path, split=self.split, cache=cache) for path in dict.fromkeys(self.data or preset.data)]
        known("scenario", self.scenarios, list(dict.fromkeys(name for found in opened for name in found.collection.scenarios)))
        planned = [(one, work) for one in wanted if (work := one.plan(opened, seeds=self.seeds, scenarios=self.scenarios))]
        if not planned:
            raise ValueError(f"nothing to do: no task of {', '.join(wanted[0].tasks)} is scored on the chosen recordings")
        failed = [self._run(one, work, cache, preset.budget, alone=len(planned) == 1) for one, work in planned]
        return 1 if any(failed) else 0

    def _experiments(self, preset) -> list:
        """The main table and the preset's ablations, or the one ablation that is asked for."""
        from ..ablations import ABLATIONS
        from ..experiment import Experiment
        from ..plan import TASKS

        tasks, metrics = self.tasks or (), chosen_metrics(self.metrics)
        known("task", tasks, TASKS)
        if self.ablation:
            known("ablation", [self.ablation], ABLATIONS)
            found = Experiment.of(self.ablation, metrics, tasks=tasks)
            return [replace(found, methods=chosen("variant", self.methods, found.methods))] if self.methods else [found]
        main = Experiment(chosen_methods(self.methods or preset.methods), metrics, tuple(tasks) or tuple(TASKS))
        further = () if self.methods or self.tasks else preset.ablations
        return [main, *(Experiment.of(name, metrics) for name in further)]

    def _run(self, experiment, work, cache, budget: str, *, alone: bool) -> bool:
        """One table: computed, written and printed. Whether anything in it failed."""
        from ..leaderboard import write_leaderboard
        from ..results import write_results
        from ..table import terminal

        name, own = experiment.name, "" if alone else experiment.name
        folder = Path("results") / "-".join(filter(None, ("+".join(dict.fromkeys(found.collection.name for found, _ in work)), name)))
        folder = writable(self.out / own if self.out else folder)
        board = writable(self.leaderboard / own if self.leaderboard else folder, option="--leaderboard")
        report = self.report and self.report.with_stem("-".join(filter(None, (self.report.stem, own))))
        if report:
            writable(report.parent, option="--report")
        results = experiment.run(work, cache=cache, budget=budget, device=self.device)
        written = [
            *write_results(results, folder),
            *write_leaderboard(results, board, says=experiment.says, published=experiment.published),
        ]
        print("\n\n".join(filter(None, (experiment.says, terminal(results)))))
        notes = [found.note for found, _ in work if found.note]
        for note in notes:
            print(note)
        for place in dict.fromkeys(path.parent for path in written):
            print(f"\nWritten to {place}: {', '.join(path.name for path in written if path.parent == place)}")
        if report:
            from ..progress import Bar
            from ..report import Replay, write_report

            settings = experiment.settings(budget, self.device)
            with Bar("report") as bar:
                runs = [(Replay(found, settings, cache), fits) for found, fits in work]
                write_report(results, runs, report, notes=notes, progress=bar)
            print(f"Report: {report}")
        return any(row["status"] == "failed" for row in results.rows)
