"""``twinbench leaderboard``: runs and submissions on one page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import PRESETS, Names, chosen_metrics, known, usable, writable_file
from ..text import shown

__all__ = ["Leaderboard"]


@dataclass(frozen=True)
class Leaderboard:
    """Write one HTML file with the tables of runs and submissions, sortable by metric, with intervals and where every line comes from.

    It opens without a network. A submission that was not scored yet is scored first; one that is not in order is refused.
    """

    folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="DIR ...")]
    """Folders of runs, of scored submissions (or the folders above them for the latest there), and of submissions."""
    data: Annotated[tuple[str, ...], arg(metavar="PATH ...")] = ("sample",)
    """The recordings that submissions are of."""
    out: Annotated[Path, arg(metavar="FILE")] = Path("leaderboard.html")
    """The page."""
    metrics: Names = ()
    """Score submissions by these only (see twinbench list). Default: all."""
    preset: str = "quick"
    """How much work goes into the appearance of the recordings, where submissions are scored: quick or full."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""

    def __call__(self) -> int:
        from ..cache import Cache, default_cache
        from ..leaderboard_page import gather, write_page
        from ..opening import open_recordings
        from ..results import read_results
        from ..submissions.format import FILE

        known("preset", [self.preset], PRESETS)
        usable(self.device)
        writable_file(self.out)
        metrics, cache = chosen_metrics(self.metrics), Cache(default_cache())
        for path in self.data:  # which is wrong also where no submission asks for it
            open_recordings(path, split="published", cache=cache)
        found = [
            self._scored(folder, metrics, cache) if (folder / FILE).is_file() else read_results(folder)
            for folder in dict.fromkeys(self.folders)
        ]
        gathered = gather(found)
        write_page(gathered, self.out)
        methods = {row["method"] for row in gathered.results.rows}
        print(f"Written to {shown(str(self.out))}: {len(gathered.entries)} sources, {len(methods)} methods")
        return 0

    def _scored(self, folder: Path, metrics, cache):
        from dataclasses import replace

        from ..opening import open_recordings
        from ..progress import Bar
        from ..submissions.checking import read_submission
        from ..submissions.scoring import score

        data = read_submission(folder).data
        opened = [open_recordings(path, split=data["split"], cache=cache) for path in dict.fromkeys(self.data)]
        fitting = [one for one in opened if set(data["recordings"]) <= set(one.collection.scenarios)]
        if not fitting:
            raise ValueError(f"{folder}: its recordings of {data['collection']} are not in --data {' '.join(self.data)}")
        with Bar(folder.name) as bar:
            results = score(folder, fitting[0], metrics, cache=cache, preset=self.preset, device=self.device, progress=bar)
        return replace(results, folder=folder)
