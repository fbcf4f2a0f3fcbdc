"""Pieces of a study, several at a time: rows go to a file as they come, what fails leaves the others alone.

The same command goes on where it was cut off.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from pathlib import Path

from ..datasets.temporary import replacing
from .processes import workers

__all__ = ["cases_of", "study"]


def cases_of(folders: Sequence[str | Path], asked: Sequence[str] | None = None) -> list[tuple[Path, str]]:
    """(folder, case) of all cases in sets of concealed ones, or of those ``asked`` for.

    Raises FileNotFoundError naming the ``labels.json`` that is missing, ValueError for a case that no set has and for two sets of one name.
    """
    folders = [Path(folder).resolve() for folder in folders]
    known = {folder: sorted(json.loads((folder / "labels.json").read_text(encoding="utf-8"))) for folder in folders}
    if len({folder.name for folder in folders}) < len(folders):
        raise ValueError(f"sets must have different names, got {', '.join(map(str, folders))}")
    for case in asked or ():
        if not any(case in cases for cases in known.values()):
            raise ValueError(f"case {case!r} is in none of {', '.join(map(str, folders))}")
    return [(folder, case) for folder, cases in known.items() for case in cases if case in (asked or cases)]


def study(
    work: Mapping[tuple, Callable[[], dict | list[dict]]],
    by: Sequence[str],
    *,
    jobs: int = 1,
    out: str | Path | None = None,
    say: Callable[[list[dict]], str] = lambda rows: "\n".join(map(json.dumps, rows)),
) -> list[dict]:
    """The rows of all pieces of ``work``, ``jobs`` at a time, each in a process of its own.

    work  pieces by their names: functions without arguments that other processes can import (``functools.partial``)
    by    columns of a row that hold the name of its piece, in the order of the names
    out   CSV of all rows, written anew after each piece, whole or not at all; a piece whose rows are in it is not done again, and rows of
          other pieces stay in it
    say   what is printed of a piece that is done; of one that fails, its error is, and it is tried again by the next call

    Raises ValueError where ``jobs`` is below 1, or the file has not the columns ``by``.
    """
    import pandas as pd

    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")
    out = Path(out) if out else None
    rows: list[dict] = []
    if out and out.exists() and out.stat().st_size:
        rows = pd.read_csv(out).to_dict("records")
        if not set(by) <= set(rows[0] if rows else by):
            raise ValueError(f"{out}: rows must have the columns {', '.join(by)}, got {', '.join(map(str, rows[0]))}")
    done = {_name(row[column] for column in by) for row in rows}
    names = {_name(key): key for key in work}
    left = [key for name, key in names.items() if name not in done]
    if len(left) < len(work):
        print(f"{len(work) - len(left)} of {len(work)} are in {out} and are not done again", flush=True)
    with workers(max(1, min(jobs, len(left)))) as pool:
        running = {pool.submit(work[key]): key for key in left}
        for future in as_completed(running):
            try:
                found = future.result()
            except Exception as error:  # one piece must not end the others
                print(*running[future], f"{type(error).__name__}: {error}", flush=True)
                continue
            found = [found] if isinstance(found, dict) else found
            rows += found
            print(say(found), flush=True)
            if out:
                with replacing(out) as temporary:
                    pd.DataFrame(rows).to_csv(temporary, index=False)
    return [row for row in rows if _name(row[column] for column in by) in names]


def _name(values) -> tuple[str, ...]:
    return tuple(map(str, values))
