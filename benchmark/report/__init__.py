"""A run as one HTML file that needs no network: its tables, and for every recording what the methods' twins did, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from ..cache import replacing
from ..plan import Fit
from ..results import Results
from .exhibits import Exhibit, Replay, exhibits
from .page import page
from .showing import show

__all__ = ["Replay", "write_report"]

PANELS = 2400  # pictures or clouds of points in a report, some 4 kB each: it still opens at once
FEWEST, MOST = 6, 60  # frames that are shown of a recording, however many or few recordings there are


def write_report(
    results: Results,
    runs: Sequence[tuple[Replay, Sequence[Fit]]],
    path: str | Path,
    *,
    notes: Iterable[str] = (),
    progress: Callable[[str, float], None] = lambda label, fraction: None,
) -> None:
    """Write ``results`` as one self-contained HTML file at ``path``, in one rename.

    ``runs`` are the fits that the rows come from, each collection's with what reads its twins from the cache: nothing is fitted. Of several
    seeds the first is shown; means are over all. Of a long run fewer frames are shown, at least 6 of each recording. ``notes`` are printed
    below the tables' own. Recordings that could not be read are named there only.

    Raises OSError where the file cannot be written, ValueError where a recording cannot be read.
    """
    found = [(replay, exhibit) for replay, fits in runs for exhibit in exhibits(replay.collection, fits)]
    found = [(replay, exhibit) for replay, exhibit in found if _readable(exhibit, results.rows)]
    panels = sum(1 + len(exhibit.rollouts) for _, exhibit in found)
    frames = min(max(PANELS // max(panels, 1), FEWEST), MOST)
    shown = []
    for i, (replay, exhibit) in enumerate(found):

        def report(label: str, *, i=i, exhibit=exhibit) -> None:
            progress(f"{exhibit.name}: {label}", i / len(found))

        shown.append(show(replay, exhibit, results.rows, frames=frames, progress=report))
    methods = {name: (method.__doc__ or "").strip() for replay, _ in runs for name, method in replay.settings.methods.items()}
    text = page(results, shown, methods, notes)
    with replacing(Path(path)) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")
    progress("done", 1.0)


def _readable(exhibit: Exhibit, rows: Iterable[Mapping]) -> bool:
    return any(row["status"] != "unreadable" for row in exhibit.rows(rows))
