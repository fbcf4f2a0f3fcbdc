"""The command line of submissions: ``twinbench submit new | check | score | write``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import PRESETS, SPLITS, Names, chosen_metrics, known, usable, writable
from ..text import shown

__all__ = ["COMMANDS"]

Folder = Annotated[Positional[Path], arg(metavar="FOLDER")]
Data = Annotated[str, arg(metavar="PATH")]


@dataclass(frozen=True)
class New:
    """Write a submission to fill in: which roll-outs are asked for, what they must hold, and what a method may see of the recordings.

    Nothing of the test frames is in it, but the way of the hands or driven markers.
    """

    folder: Folder
    """Folder to write, which must be new or empty."""
    data: Data = "sample"
    """The recordings: a folder in a known layout (see twinbench list), or sample."""
    tasks: Names = ()
    """Any of: resimulation, prediction, transfer. Default: all."""
    seeds: Annotated[tuple[int, ...], arg(metavar="INT ...")] = (0,)
    """Seeds: every roll-out is asked for with each."""
    split: str = "published"
    """Which split: published, or clean (no recording session on both sides)."""

    def __call__(self) -> int:
        from ..cache import Cache, default_cache
        from ..opening import open_recordings
        from ..plan import TASKS
        from .template import write_template

        known("split", [self.split], SPLITS)
        known("task", self.tasks, TASKS)
        if not self.seeds:
            raise ValueError("--seeds needs at least one value")
        cache = Cache(default_cache())
        opened = open_recordings(self.data, split=self.split, cache=cache)
        rollouts = write_template(self.folder, opened, cache=cache, tasks=self.tasks or tuple(TASKS), seeds=self.seeds)
        print(f"{shown(str(self.folder))}: asks for {len(rollouts)} roll-outs; README.md in it says how to go on")
        return 0


@dataclass(frozen=True)
class Check:
    """List all that is missing or wrong in a submission. The exit code is 1 if it cannot be scored."""

    folder: Folder
    """Folder of the submission."""
    data: Data = "sample"
    """The recordings that it is of."""

    def __call__(self) -> int:
        from ..progress import Bar
        from .checking import check

        cache, opened = _opened(self.folder, self.data)
        with Bar("check") as bar:
            findings = check(self.folder, opened, cache, progress=bar)
        for finding in findings:
            print(shown(str(finding)))
        wrong = sum(finding.severity == "error" for finding in findings)
        print(f"{shown(str(self.folder))}: {f'{wrong} errors' if wrong > 1 else 'one error' if wrong else 'can be scored'}")
        return 1 if wrong else 0


@dataclass(frozen=True)
class Score:
    """Score a submission as twinbench run scores its methods, and print the same table. What is not in order is refused."""

    folder: Folder
    """Folder of the submission."""
    data: Data = "sample"
    """The recordings that it is of."""
    metrics: Names = ()
    """Score only these (see twinbench list). Default: all."""
    preset: str = "quick"
    """How much work goes into the appearance of the recordings, for metrics of images: quick or full."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""
    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder in which the scores get a folder of their own, as those of a run do. Default: results/NAME of the recordings-METHOD."""

    def __call__(self) -> int:
        from ..folders import name_for
        from ..progress import Bar
        from ..run_files import said_of, write_run
        from ..status import FAULTS
        from .checking import read_submission
        from .scoring import score

        known("preset", [self.preset], PRESETS)
        usable(self.device)
        metrics, (cache, opened) = chosen_metrics(self.metrics), _opened(self.folder, self.data)
        place = writable(self.out or Path("results") / name_for([opened.collection.name], read_submission(self.folder).method))
        with Bar(opened.collection.name) as bar:
            results = score(self.folder, opened, metrics, cache=cache, preset=self.preset, device=self.device, progress=bar)
        results = write_run(results, place)
        print(results)
        print(f"\n{said_of(results)}")
        return 1 if any(row["status"] in FAULTS for row in results.rows) else 0


@dataclass(frozen=True)
class Write:
    """Write a run's twins as submissions, a folder for each method. Twins come from the cache; what is not there is fitted again."""

    run: Annotated[Positional[Path], arg(metavar="DIR")]
    """Folder of a run, or the folder above it for the latest there."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder in which each method gets a folder, which must not be there."""
    methods: Names = ()
    """Only these. Default: all of the run."""
    authors: str = ""
    """Who submits. Default: twinbench."""
    code: str = "none"
    """A link to the code, or none."""

    def __call__(self) -> int:
        from ..cache import Cache, default_cache
        from ..progress import Bar
        from ..results import read_results
        from .writing import write_submissions

        options = {"methods": self.methods, "authors": self.authors, "code": self.code}
        for folder in write_submissions(read_results(self.run), writable(self.out), cache=Cache(default_cache()), progress=Bar, **options):
            print(f"Written to {shown(str(folder))}")
        return 0


COMMANDS = {"new": New, "check": Check, "score": Score, "write": Write}


def _opened(folder: Path, data: str):
    """The cache, and the recordings in the split that the submission in ``folder`` is of, or the published one where it does not say."""
    from ...datasets.files import read_json
    from ..cache import Cache, default_cache
    from ..opening import open_recordings
    from .format import FILE

    if not folder.is_dir():
        raise ValueError(f"no submission at {folder}: no such folder")
    try:
        split = read_json(folder / FILE).get("data", {}).get("split")
    except (ValueError, AttributeError):  # which the check says
        split = ""
    cache = Cache(default_cache())
    return cache, open_recordings(data, split=split if split in SPLITS else "published", cache=cache)
