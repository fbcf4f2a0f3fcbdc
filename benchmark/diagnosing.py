"""Diagnoses of many recordings, each by itself: several at a time, on a cluster if need be. What is there is kept."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from ..datasets.collection import Unrecognised, open_collection
from ..datasets.temporary import replacing
from .config import NAME, config_text
from .executors.base import Executor
from .opening import folder_of, open_scenario
from .text import check_name

__all__ = ["diagnose_each", "recordings_of"]


def recordings_of(paths: Sequence[str]) -> dict[str, str]:
    """Where the recordings at ``paths`` are, by name; of a folder that holds several, all.

    Raises ValueError where none is at a path, or two have one name.
    """
    found: dict[str, str] = {}
    for path in paths:
        try:
            names = list(open_collection(path).scenarios) if folder_of(path).exists() else []
        except Unrecognised:  # as a folder; it may lie in one
            names = []
        if not names:
            open_scenario(path)  # says what is wrong
        inside = {name: f"{path}/{name}" for name in names} if len(names) > 1 else {Path(path).name: path}
        for name, place in inside.items():
            check_name(name, where=path)
            if found.get(name, place) != place:
                raise ValueError(f"two recordings are called {name!r}: {found[name]} and {place}; diagnose them into two folders (--out)")
            found[name] = place
    return found


def diagnose_each(
    recordings: Mapping[str, str], out: Path, executor: Executor, *, twin: str = "auto", preset: str = "quick", device: str = "cpu"
) -> Iterator[tuple[str, dict | BaseException]]:
    """The name of each recording (see ``recordings_of``) with what ``diagnosis.json`` in ``out``/NAME holds, or with the error of one that
    failed, as they are done. A diagnosis that is there, made with the same options, is kept; the same call goes on where it was stopped.

    Raises as ``Executor.each`` does.
    """
    options = {"twin": twin, "preset": preset, "device": device}
    todo = {}
    for name, path in recordings.items():
        text = config_text("diagnose", {"cases": [str(Path(path).resolve()) if Path(path).exists() else path], **options})
        if (kept := _kept(out / name, text)) is not None:
            yield name, kept
        else:
            todo[name] = partial(_diagnose, path, out / name, options, text)
    seen = [folder for path in (recordings[name] for name in todo) if (folder := folder_of(path)).exists()]
    with closing(executor.each(todo, device=device, reads=seen, writes=[out])) as finished:
        for name, future in finished:
            yield name, future.exception() or future.result()


def _kept(folder: Path, text: str) -> dict | None:
    """The diagnosis in ``folder``, where it was made from ``text``."""
    try:
        if (folder / NAME).read_text(encoding="utf-8") == text:
            return json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        pass
    return None


def _diagnose(path: str, folder: Path, options: Mapping[str, str], text: str) -> dict:
    """One of them, in a process of its own."""
    from ..diagnosis.diagnose import diagnose

    (folder / NAME).unlink(missing_ok=True)  # what it is written from is written last
    told: dict[str, Any] = dict(options)
    found = diagnose(open_scenario(path), **told)
    found.write(folder)
    with replacing(folder / NAME) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
