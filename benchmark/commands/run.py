"""``twinbench run``: fit, roll out, score, and print the table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from ..cluster_options import OnCluster
from ..options import Names, writable, writable_file
from ..text import shown

__all__ = ["Run"]


ASKED = ("data", "scenarios", "methods", "ablation", "metrics", "tasks", "seeds", "preset", "device", "split", "jobs", "quiet")


@dataclass(frozen=True)
class Run(OnCluster):
    """Fit twins, roll them out, score them, and print the table.

    Fitted twins and scored rows are kept in .cache/twinbench (or $TWINBENCH_CACHE): a killed run goes on where it stopped and a
    repeated run is instant. A method that fails or diverges on a recording, and a recording that cannot be read, are said below the table;
    the exit code is 1 if anything failed or could not be read.
    """

    data: Annotated[tuple[str, ...] | None, arg(metavar="PATH ...")] = None
    """Recordings: "sample" for the ones that ship with twinbench (the default), or folders in a known layout (see twinbench list)."""
    scenarios: Names = ()
    """Score only these recordings. Default: all."""
    methods: Names | None = None
    """Methods to compare (see twinbench list), with spaces or commas between them. all: every one but phystwin+diagnosed and
    continuum+diagnosed, which take as long as several others. Default: static rigid phystwin."""
    ablation: str = ""
    """Compare what an ablation compares (see twinbench list), instead of methods."""
    metrics: Names = ()
    """Score only these (see twinbench list). Default: all. Without those of images no appearance is fitted, which is much faster."""
    tasks: Names | None = None
    """Any of: resimulation, prediction, transfer. Default: all; of an ablation, its own."""
    seeds: Annotated[tuple[int, ...], arg(metavar="INT ...")] = (0,)
    """Seeds; every method is fitted once with each."""
    preset: str = "quick"
    """How much work a fit may do: quick or full. paper: full, and all tables of the PhysTwin paper for the recordings in ./data, as
    published, the main one also corrected; it says first what it will do, and how long that takes."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""
    split: str = "published"
    """Which split: published, or clean (no recording session on both sides)."""
    jobs: int | None = None
    """Processes that share the work; the results are the same. Default: one for each graphics card, or one; on a cluster, no limit."""
    quiet: bool = False
    """Say nothing on standard error of how far it is."""
    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder in which this run gets a folder of its own, and a link named latest leads to it. Default: results/NAME of the recordings; an
    ablation's beside it."""
    leaderboard: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder for leaderboard.md, leaderboard.csv and leaderboard.tex, which are replaced there. Default: the run's own."""
    report: Annotated[Path | None, arg(metavar="FILE")] = None
    """Also write one HTML file with the tables and, frame by frame, what every twin did. It opens without a network."""

    def __call__(self) -> int:
        from ..announcement import announce
        from ..api import studies
        from ..presets import PRESETS

        asked = {name: getattr(self, name) for name in ASKED}
        found = studies(**asked, executor=self.on_cluster())
        places = [self._places(study, "" if len(found) == 1 else study.experiment.name) for study in found]
        if PRESETS[self.preset].announced and not self.quiet:
            announce(found)
        failed = [self._run(study, *place) for study, place in zip(found, places, strict=True)]
        return 1 if any(failed) else 0

    def _places(self, study, own: str) -> tuple[Path, Path | None, Path | None]:
        """Where a table, its leaderboard and its report go; ``own`` tells it from others of this run."""
        from ..folders import name_for

        place = writable(self.out / own if self.out else Path("results") / name_for(study.collections, study.experiment.name))
        board = writable(self.leaderboard / own, option="--leaderboard") if self.leaderboard else None
        report = self.report and writable_file(self.report, option="--report")
        if report and own:
            report = writable_file(report.with_stem(f"{report.stem}-{own}"), option="--report")
        return place, board, report

    def _run(self, study, place: Path, board: Path | None, report: Path | None) -> bool:
        """One table: computed, written and printed. Whether anything in it failed."""
        from ..published import compared, terminal
        from ..published_figure import undrawable
        from ..run_files import said_of
        from ..status import FAULTS

        experiment = study.experiment
        results = study.write(study.run(), place, board=board)
        print("\n\n".join(filter(None, (experiment.says, str(results)))))
        if figures := compared(results):
            print(f"\n{terminal(figures)}")
            if reason := undrawable():
                print(f"No picture of these figures: {reason}")
        notes = [found.note for found, _ in study.work if found.note]
        for note in notes:
            print(shown(note))
        print(f"\n{said_of(results)}")
        if board:
            print(f"\nWritten to {shown(str(board))}: leaderboard.csv, leaderboard.md, leaderboard.tex")
        if report:
            from ..progress import Bar
            from ..report import Replay, write_report

            settings = experiment.settings(study.budget, self.device)
            with Bar("report", quiet=self.quiet) as bar:
                runs = [(Replay(found, settings, study.cache), fits) for found, fits in study.work]
                write_report(results, runs, report, notes=notes, progress=bar)
            print(f"Report: {shown(str(report))}")
        return any(row["status"] in FAULTS for row in results.rows)
