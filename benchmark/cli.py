"""The command line: ``twinbench run | table | picture | check | download | list | real``."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional, arg

from .options import known as _known
from .options import writable as _folder

__all__ = ["main"]

Names = Annotated[tuple[str, ...], arg(metavar="NAME ...")]


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
        from .cache import Cache, default_cache
        from .opening import open_recordings
        from .presets import PRESETS

        for option, value, known in (("preset", self.preset, PRESETS), ("device", self.device, _DEVICES), ("split", self.split, _SPLITS)):
            _known(option, [value], known)
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
        _known("scenario", self.scenarios, list(dict.fromkeys(name for found in opened for name in found.collection.scenarios)))
        planned = [(one, work) for one in wanted if (work := one.plan(opened, seeds=self.seeds, scenarios=self.scenarios))]
        if not planned:
            raise ValueError(f"nothing to do: no task of {', '.join(wanted[0].tasks)} is scored on the chosen recordings")
        failed = [self._run(one, work, cache, preset.budget, alone=len(planned) == 1) for one, work in planned]
        return 1 if any(failed) else 0

    def _experiments(self, preset) -> list:
        """The main table and the preset's ablations, or the one ablation that is asked for."""
        from .ablations import ABLATIONS
        from .experiment import Experiment
        from .plan import TASKS

        tasks, metrics = self.tasks or (), _metrics(self.metrics)
        _known("task", tasks, TASKS)
        if self.ablation:
            _known("ablation", [self.ablation], ABLATIONS)
            found = Experiment.of(self.ablation, metrics, tasks=tasks)
            return [replace(found, methods=_chosen("variant", self.methods, found.methods))] if self.methods else [found]
        main = Experiment(_methods(self.methods or preset.methods), metrics, tuple(tasks) or tuple(TASKS))
        further = () if self.methods or self.tasks else preset.ablations
        return [main, *(Experiment.of(name, metrics) for name in further)]

    def _run(self, experiment, work, cache, budget: str, *, alone: bool) -> bool:
        """One table: computed, written and printed. Whether anything in it failed."""
        from .leaderboard import write_leaderboard
        from .results import write_results
        from .table import terminal

        name, own = experiment.name, "" if alone else experiment.name
        folder = Path("results") / "-".join(filter(None, ("+".join(dict.fromkeys(found.collection.name for found, _ in work)), name)))
        folder = _folder(self.out / own if self.out else folder)
        board = _folder(self.leaderboard / own if self.leaderboard else folder, option="--leaderboard")
        report = self.report and self.report.with_stem("-".join(filter(None, (self.report.stem, own))))
        if report:
            _folder(report.parent, option="--report")
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
            from .progress import Bar
            from .report import Replay, write_report

            settings = experiment.settings(budget, self.device)
            with Bar("report") as bar:
                runs = [(Replay(found, settings, cache), fits) for found, fits in work]
                write_report(results, runs, report, notes=notes, progress=bar)
            print(f"Report: {report}")
        return any(row["status"] == "failed" for row in results.rows)


@dataclass(frozen=True)
class Table:
    """Print again the table of a folder that twinbench run wrote."""

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """Folder with rows.parquet."""
    format: str = "terminal"
    """terminal, markdown or latex."""

    def __call__(self) -> int:
        from . import table
        from .results import read_results

        _known("format", [self.format], ("terminal", "markdown", "latex"))
        print(getattr(table, self.format)(read_results(self.folder)))
        return 0


@dataclass(frozen=True)
class Picture:
    """Draw one recording: where its points were, where each method's twin puts them, and the error over time.

    Twins that twinbench run fitted are taken from the cache, others are fitted. Needs matplotlib (the extra "plots").
    """

    scenario: Annotated[Positional[str], arg(metavar="[NAME]")] = ""
    """The recording to draw. Default: the first that is scored."""
    data: Annotated[str, arg(metavar="PATH")] = "sample"
    """Where it is, as for twinbench run."""
    methods: Names = ("static", "rigid", "phystwin")
    """Methods to draw."""
    metric: str = "chamfer"
    """The error to draw (see twinbench list)."""
    seed: int = 0
    """Seed of the fits."""
    preset: str = "quick"
    """quick or full."""
    device: str = "cpu"
    """cpu or cuda."""
    split: str = "published"
    """published or clean."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """Where to write it, a .png, .pdf or .svg. Default: results/RECORDINGS/NAME.png."""

    def __call__(self) -> int:
        from .cache import Cache, default_cache
        from .opening import open_recordings
        from .picture import Player, draw, drawable
        from .progress import Bar
        from .runner import Settings

        for option, value, known in (("preset", self.preset, _PRESETS), ("device", self.device, _DEVICES), ("split", self.split, _SPLITS)):
            _known(option, [value], known)
        methods, metrics, cache = _methods(self.methods), _metrics(), Cache(default_cache())
        _known("metric", [self.metric], metrics)
        opened = open_recordings(self.data, split=self.split, cache=cache)
        collection = opened.collection
        name = self.scenario or next(iter((*collection.in_domain, *(pair.target for pair in collection.pairs))), "")
        scenario, out = collection.load(name), self.out or Path("results") / collection.name / f"{name}.png"
        drawable(out)
        with Bar(name) as bar:
            rollouts, fitted = Player(opened, Settings(methods, metrics, self.preset, self.device), cache).play_all(name, self.seed, bar)
        draw(scenario, rollouts, metrics[self.metric], out, fitted=fitted)
        print(f"Written to {out}")
        return 0


@dataclass(frozen=True)
class Check:
    """Say what is missing or wrong in a recording of the published layout, file by file."""

    case: Annotated[Positional[str], arg(metavar="CASE")]
    """Folder of one recording, or of several; or "sample"."""

    def __call__(self) -> int:
        from ..datasets.check import check
        from .opening import folder_of

        folder = folder_of(self.case)
        if not folder.exists():
            raise ValueError(f"no recording at {folder}: no such folder")
        findings = check(folder)
        for finding in findings:
            print(finding)
        if not findings:
            print(f"{folder}: complete")
        return 1 if any(finding.severity == "error" for finding in findings) else 0


@dataclass(frozen=True)
class Download:
    """Download published archives and unpack them. Says first how much there is to fetch; goes on where it stopped."""

    archives: Annotated[Positional[tuple[str, ...]], arg(metavar="[ARCHIVE ...]")] = ("data",)
    """Any of: data, experiments_optimization, experiments, gaussian_output, additional_data."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("data")
    """Where to put them."""
    yes: bool = False
    """Do not ask."""
    url: Annotated[str | None, arg(metavar="URL")] = None
    """Another server that has the archives."""

    def __call__(self) -> int:
        from ..datasets.download import BASE_URL, download, plan
        from .progress import Bytes

        url = self.url or BASE_URL
        if self.yes:
            print(plan(self.archives, self.out, base_url=url))
        with Bytes() as bar:
            done = download(self.archives, self.out, base_url=url, progress=bar, yes=self.yes)
        print(f"{', '.join(archive.name for archive in done.archives)} in {done.out}")
        return 0


@dataclass(frozen=True)
class List:
    """List methods, metrics, tasks, layouts, and the recordings at hand."""

    data: Annotated[tuple[str, ...], arg(metavar="PATH ...")] = ("sample",)
    """Recordings to list."""
    split: str = "published"
    """published or clean."""

    def __call__(self) -> int:
        from ..datasets.collection import layouts
        from ..methods.registry import methods
        from .ablations import ABLATIONS
        from .cache import Cache, default_cache
        from .opening import open_recordings
        from .plan import TASKS

        _known("split", [self.split], _SPLITS)
        metrics = _metrics().values()
        _section("methods", {name: _first_line(method) for name, method in methods().items()})
        _section("metrics", {m.name: f"{_first_line(type(m))} {m.direction.capitalize()} is better." for m in metrics})
        _section("tasks", TASKS)
        _section("ablations", {name: found.says for name, found in ABLATIONS.items()})
        _section("layouts", {name: _first_line(type(layout)) for name, layout in layouts().items()})
        for path in self.data:
            collection = open_recordings(path, split=self.split, cache=Cache(default_cache())).collection
            _section(f"recordings of {collection.name} ({path})", {name: _roles(collection, name) for name in collection.scenarios})
        return 0


@dataclass(frozen=True)
class Real:
    """Ask twins of real recordings which physics they lack, and score them with it on recordings that nobody fitted."""

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """cables: ropes held at both ends (DEFORM), extended term by term. hand, weight, gravity: something is kept from the twin."""
    data: Annotated[Path, arg(metavar="PATH")] = Path("data_set")
    """Folder of the recordings: for cables data_set, for the others what holds data_set, dataset and softbeam."""
    seeds: Annotated[tuple[int, ...], arg(metavar="INT ...")] = (0, 1, 2)
    """Seeds; each draws other recordings to fit and other starts."""
    device: str = "cpu"
    """cpu or cuda."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("results/real")
    """Folder for the tables."""

    def __call__(self) -> int:
        from . import real_cables, real_cases

        studies = {"cables": real_cables.run} | dict.fromkeys(real_cases.CASES, partial(real_cases.run, self.study))
        _known("study", [self.study], studies)
        _known("device", [self.device], _DEVICES)
        options = {"seeds": self.seeds} if self.study == "cables" else {}
        studies[self.study](self.data, _folder(self.out), device=self.device, **options)
        print(f"Written to {self.out}")
        return 0


@dataclass(frozen=True)
class Diagnose:
    """Say which physics a recording shows and a spring-mass twin lacks: where, since when, how much it matters; or that nothing is missing.

    A recording is a folder in a known layout (see twinbench list), with /NAME behind it where the folder holds several.
    """

    case: Annotated[Positional[str], arg(metavar="CASE")]
    """The recording. Its held-out frames are never fitted."""
    transfer: Annotated[tuple[str, ...], arg(metavar="CASE ...")] = ()
    """Other interactions with the same object. They are never fitted."""
    fitted_on: Annotated[tuple[str, ...], arg(metavar="CASE ...")] = ()
    """Recordings that the twin is fitted on and taken as adequate for. Default: the training frames of CASE."""
    preset: str = "quick"
    """How much work: quick or full."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("results/diagnosis")
    """Folder for diagnosis.json and report.html."""

    def __call__(self) -> int:
        from ..diagnosis.diagnose import diagnose
        from ..diagnosis.page.words import headline, improvement
        from .opening import open_scenario

        _known("preset", [self.preset], _PRESETS)
        _known("device", [self.device], _DEVICES)
        case = open_scenario(self.case)
        transfer, fitted_on = ([open_scenario(path) for path in paths] for paths in (self.transfer, self.fitted_on))
        folder = _folder(self.out)
        say = (lambda said: print(f"{said} ...", file=sys.stderr)) if sys.stderr.isatty() else (lambda said: None)
        found = diagnose(case, transfer=transfer, fitted_on=fitted_on, preset=self.preset, device=self.device, progress=say)
        found.write(folder)
        print(headline(found.result))
        for line in filter(None, (improvement(found.result), found.result["experiment"])):
            print(line)
        print(f"Written to {folder}: diagnosis.json, report.html")
        return 0


@dataclass(frozen=True)
class Concealed:
    """Diagnose pairs of recordings in which something known was concealed, and score the answers against their labels.

    The recordings are written by python -m twinbench.datasets.concealed. Answers that are there are kept.
    """

    data: Annotated[Positional[tuple[Path, ...]], arg(metavar="DIR")]
    """Folders of case_*/fit and case_*/transfer, each with labels.json."""
    preset: str = "quick"
    """quick or full."""
    device: str = "cpu"
    """cpu or cuda."""
    jobs: int = 1
    """Cases that are diagnosed at the same time."""
    calibrate: bool = False
    """Fit the decision to these labels, write calibration.json, and score each case by a decision that did not see it (8-fold)."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("results/concealed")
    """Folder for the answers, scores.json and cases.md."""

    def __call__(self) -> int:
        from . import concealed

        _known("preset", [self.preset], _PRESETS)
        _known("device", [self.device], _DEVICES)
        results, labels = concealed.study(
            self.data, _folder(self.out), preset=self.preset, device=self.device, jobs=self.jobs, calibrating=self.calibrate
        )
        print(concealed.by_effect(results, labels))
        print("\n".join(f"{name:16} {value}" for name, value in concealed.score(results, labels).items()))
        print(f"Written to {self.out}")
        return 1 if any(r["verdict"] == "failed" for r in results.values()) else 0


@dataclass(frozen=True)
class Challenge:
    """Make, answer, open and score a sealed challenge: twinbench challenge make | answer | open | score."""

    def __call__(self) -> int:
        raise ValueError("twinbench challenge needs one of make, answer, open, score")


_PRESETS, _DEVICES, _SPLITS = ("quick", "full"), ("cpu", "cuda"), ("published", "clean")


def _roles(collection, name: str) -> str:
    pairs = [pair.sources for pair in collection.pairs if pair.target == name]
    sources = [f"transfer from {'+'.join(found) if len(found) < 4 else f'{len(found)} recordings'}" for found in pairs]
    source_of = sum(name in pair.sources for pair in collection.pairs)
    in_domain = ["resimulation, prediction"] if name in collection.in_domain else []
    return "; ".join([*in_domain, *sources]) or (f"source of {source_of} transfer targets" if source_of else "not scored")


def _section(title: str, entries) -> None:
    print(f"{title}:")
    width = max((len(name) for name in entries), default=0)
    for name, text in entries.items():
        print(f"  {name.ljust(width)}  {text}".rstrip())
    print()


def _first_line(thing) -> str:
    return (thing.__doc__ or "").strip().split("\n")[0]


def _methods(names: Iterable[str]) -> dict:
    from ..methods.registry import methods

    found = methods()
    every = [name for name, method in found.items() if getattr(method, "room", "") == "methods"]  # a diagnosis takes as long as all others
    return _chosen("method", [one for name in names for one in (every if name == "all" else [name])], found)


def _metrics(names: Iterable[str] = ()) -> dict:
    """The metrics of these names; all where there are none."""
    from ..metrics.base import metrics

    found = metrics()
    return _chosen("metric", names, found) if names else found


def _chosen(kind: str, names: Iterable[str], found: dict) -> dict:
    """Those of ``found`` that are named, with commas between names or not."""
    names = [name for entry in names for name in entry.split(",") if name]
    _known(kind, names, found)
    return {name: found[name] for name in dict.fromkeys(names)}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code. Wrong input is one line on standard error and code 2, never a traceback."""
    arguments = sys.argv[1:] if arguments is None else arguments
    commands = {"run": Run, "table": Table, "picture": Picture, "check": Check, "download": Download, "list": List}
    commands |= {"diagnose": Diagnose, "concealed": Concealed, "challenge": Challenge, "real": Real}
    try:
        if arguments == ["--version"]:
            print(f"twinbench {version('twinbench')}")
            return 0
        if arguments and not arguments[0].startswith("-"):
            _known("command", arguments[:1], commands)
        says, prog = "Benchmark and diagnosis of physical digital twins of deformable objects.", "twinbench"
        if arguments[:1] == ["challenge"]:
            from .challenge.commands import COMMANDS as commands

            says, prog, arguments = Challenge.__doc__, "twinbench challenge", arguments[1:]
            if arguments and not arguments[0].startswith("-"):
                _known("command", arguments[:1], commands)
        command = tyro.extras.subcommand_cli_from_dict(commands, prog=prog, description=says, args=arguments)
        return command()
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, OSError) as error:
        said = error.strerror if isinstance(error, OSError) and error.strerror and not error.filename else str(error)  # without [Errno 28]
        print(f"twinbench: {' '.join(said.split())}", file=sys.stderr)
        return 2
    except ImportError as error:
        if error.name is not None:  # Python's own: a fault of ours, not a package that the command asks for
            raise
        print(f"twinbench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("twinbench: stopped; the same command goes on from here", file=sys.stderr)
        return 130
