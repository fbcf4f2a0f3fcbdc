"""``twinbench score``: twins that were released, beside the trajectories that were stored with them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from ..options import DEVICES, PRESETS, SPLITS, Names, chosen_metrics, known, writable

__all__ = ["Score"]


@dataclass(frozen=True)
class Score:
    """Score twins in the layout that PhysTwin's authors publish, on the recordings that they were fitted to, without fitting anything.

    Each is rolled out by our engine, and its stored trajectory is scored beside it; below the tables stands how far the two are apart.
    Images show the released Gaussians where they are there. The exit code is 1 if any file could not be used.
    """

    released: Annotated[Path, arg(metavar="DIR")]
    """Folder with experiments_optimization, experiments and, if any, gaussian_output, as twinbench download unpacks them; or with one
    folder a twin, which holds all its files."""
    data: Annotated[tuple[str, ...], arg(metavar="PATH ...")] = ()
    """The recordings: folders in a known layout (see twinbench list). Default: those in the folder of the twins."""
    scenarios: Names = ()
    """Score only these recordings. Default: all of which there is a twin."""
    metrics: Names = ()
    """Score only these (see twinbench list). Default: all."""
    tasks: Names = ()
    """Any of: resimulation, prediction, transfer. Default: all."""
    preset: str = "quick"
    """How much work goes into the appearance of recordings without released Gaussians: quick or full."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""
    split: str = "published"
    """Which split: published, or clean (no recording session on both sides)."""
    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder for the rows, table.md, table.tex, the leaderboard and apart.csv. Default: results/NAME of the recordings, with -released."""

    def __call__(self) -> int:
        from ...methods.phystwin.released import released
        from ..cache import Cache, default_cache
        from ..leaderboard import write_leaderboard
        from ..opening import open_recordings
        from ..plan import TASKS
        from ..results import write_results
        from ..score import overall, scored, write_apart
        from ..table import terminal

        for option, value, choices in (("preset", self.preset, PRESETS), ("device", self.device, DEVICES), ("split", self.split, SPLITS)):
            known(option, [value], choices)
        known("task", self.tasks, TASKS)
        metrics, cache, found = chosen_metrics(self.metrics), Cache(default_cache()), released(self.released)
        data = list(dict.fromkeys(self.data)) or [str(self.released)]
        opened = [open_recordings(path, split=self.split, cache=cache) for path in data]
        here = list(dict.fromkeys(name for one in opened for name in one.collection.scenarios))
        known("scenario", self.scenarios, here)
        if not (both := [name for name in here if name in found]):
            raise ValueError(f"{self.released} holds twins of {_some(found)}, and {', '.join(data)} recordings of {_some(here)}")
        name = "+".join(dict.fromkeys(one.collection.name for one in opened))
        folder = writable(self.out or Path("results") / f"{name}-released")
        options = {"tasks": self.tasks or tuple(TASKS), "scenarios": self.scenarios, "preset": self.preset, "device": self.device}
        results, gaps = scored(opened, {name: found[name] for name in both}, metrics, cache=cache, **options)
        written = [*write_results(results, folder), *write_leaderboard(results, folder), write_apart(gaps, folder)]
        print(terminal(results))
        for line in filter(None, (*gaps, overall(gaps))):
            print(line)
        clouds = [name for name in both if found[name].point_cloud]
        if clouds and any(metric.images for metric in metrics.values()):
            print(f"Images show released Gaussians of {_some(clouds)}")
        for kind, missing in (("twin", [n for n in here if n not in found]), ("recording", [n for n in found if n not in here])):
            if missing:
                print(f"Not scored, for want of a {kind}: {_some(missing)}")
        print(f"\nWritten to {folder}: {', '.join(path.name for path in written)}")
        return 1 if any(row["status"] in ("failed", "unreadable") for row in results.rows) else 0


def _some(names) -> str:
    names = [name if name.isprintable() else ascii(name) for name in names]
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
