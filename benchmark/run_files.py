"""What a run leaves behind: a folder of its own with rows, tables, leaderboard and published figures, and what is said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from .config import NAME as CONFIG
from .folders import publish
from .leaderboard import write_leaderboard
from .published import write_published
from .results import Results, write_results
from .text import shown

__all__ = ["said_of", "write_run"]


def write_run(
    results: Results,
    place: Path,
    *,
    says: str = "",
    published: Sequence[str] | None = None,
    board: Path | None = None,
    config: str = "",
) -> Results:
    """``results`` with the new ``folder`` in ``place`` that they were written to; their leaderboard goes there, or to ``board``.

    ``says`` is what the tables ask, ``published`` the methods of the paper that stand beside them (None means all), ``config`` the text of
    the file by which the run is made again, if there is one.
    """

    def everything(folder: Path) -> None:
        write_results(results, folder)
        if config:
            (folder / CONFIG).write_text(config, encoding="utf-8")
        write_published(results, folder)
        if board is None:
            write_leaderboard(results, folder, says=says, published=published)

    folder = publish(place, datetime.fromisoformat(results.origin["started"]), everything)
    if board is not None:
        write_leaderboard(results, board, says=says, published=published)
    return replace(results, folder=folder)


def said_of(results: Results) -> str:
    """The line that says where they were written."""
    folder = results.folder
    assert folder is not None  # they were written
    return f"Written to {shown(str(folder))}: {', '.join(sorted(file.name for file in folder.iterdir()))}"
