"""Answering a sealed set: every rival on every case, and the hash of every answer, before anything is opened."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from pathlib import Path

from ...datasets.collection import nearest
from ...datasets.concealed.make import Folder
from ...datasets.concealed.seal import read_json, write_json
from ..processes import cards, workers
from ..provenance import commit
from .book import Answers, check_recordings
from .opening import opened_labels
from .rivals import rivals
from .rivals.base import FAILED, Given, sensible

__all__ = ["answer_case", "answer_set", "each", "take_answers"]


def each(function: Callable, items: Sequence[tuple], *, jobs: int = 1, device: str = "cpu"):
    """(item, what ``function(*item)`` returned) as they are done, in ``jobs`` fresh processes; in this one where that is 1.

    On ``device`` "cuda" the processes share out the graphics cards.
    """
    if jobs == 1:
        for item in items:
            yield item, function(*item)
        return
    with workers(jobs, cards(device)) as pool:
        running = {pool.submit(function, *item): item for item in items}
        for future in as_completed(running):
            yield running[future], future.result()


def answer_case(case: Path, names: Sequence[str], preset: str, device: str, label: dict | None = None) -> dict[str, dict]:
    """Answers of the rivals ``names`` to ``case``/fit with ``case``/transfer. An error is an answer that says so."""
    from ..opening import open_scenario

    found, given, shared = {}, None, 0.0
    for name in names:
        begun = time.time()
        try:
            given = given or Given(*(open_scenario(str(case / part)) for part in ("fit", "transfer")), preset=preset, device=device)
            given.label = label if rivals()[name].told else None
            answered = "diagnosis" in vars(given)
            found[name] = json.loads(json.dumps(rivals()[name].answer(given), allow_nan=False))
            own = time.time() - begun
            found[name]["seconds"] = round(own + (shared if answered else 0.0), 1)  # who comes later did not wait for the diagnosis again
            shared = shared if answered or "diagnosis" not in vars(given) else float(given.diagnosis.result["seconds"])
        except Exception as error:
            traceback.print_exc()
            found[name] = FAILED | {"error": f"{type(error).__name__}: {error}", "seconds": round(time.time() - begun, 1)}
    return found


def answer_set(
    root: str | Path,
    *,
    names: Sequence[str] = ("diagnosis",),
    preset: str = "quick",
    device: str = "cpu",
    jobs: int = 1,
    progress: Callable[[str], None] = lambda said: None,
) -> dict[str, str]:
    """Answer the sealed set in ``root``; answers that are there are kept. Returns the root hash of each rival's answers.

    No label is read, but for rivals that are told, and for them only where the set was opened before. Raises ValueError for an unknown
    rival, recordings that are not those that were published, or a told rival on a set that is still sealed.
    """
    folder = Folder(Path(root))
    published, known = folder.published(), rivals()
    for name in names:
        if name not in known:
            raise ValueError(f"unknown rival {name!r}; {nearest(name, known)}")
    cases = list(published["cases"])
    for name in cases:
        check_recordings(folder, name, published)
    labels = opened_labels(folder) if any(known[n].told for n in names) else {}
    about = {"commit": commit(), "preset": preset, "device": device}
    books = {name: Answers(folder, name) for name in names}
    direct = [n for n in names if not known[n].derived]
    missing = {case: tuple(n for n in direct if not books[n].file(case).exists()) for case in cases}
    todo = [(folder.cases / case, wanted, preset, device, labels.get(case)) for case, wanted in missing.items() if wanted]
    for done, (item, found) in enumerate(each(answer_case, todo, jobs=jobs, device=device), 1):
        case = item[0].name
        for name, said in found.items():
            write_json(books[name].file(case), said | {"by": about})
        progress(f"{done} of {len(todo)}: {case} " + ", ".join(f"{n}: {_short(a)}" for n, a in found.items()))
    for name in (n for n in names if known[n].derived):
        source = Answers(folder, "diagnosis").read(cases)
        if len(source) < len(cases):
            raise ValueError(f"{name} is made of the answers of the diagnosis: have it answer all {len(cases)} cases first")
        for case, said in known[name].derive(source, published["root"]).items():
            if not books[name].file(case).exists():
                write_json(books[name].file(case), said | {"by": about})
    return {name: books[name].publish(cases) for name in names}


def take_answers(root: str | Path, *, name: str, source: str | Path) -> str:
    """Seal the answers of another program under ``name``: ``source``/CASE.json, or /CASE/diagnosis.json as twinbench diagnose writes it.

    What an answer leaves out counts as not said. Returns their root. Raises ValueError for a name that is a rival's, where there are none,
    and for the first that is no answer.
    """
    folder, source = Folder(Path(root)), Path(source)
    published = folder.published()
    if name in rivals():
        raise ValueError(f"{name!r} answers by itself; choose another name for the answers in {source}")
    taken = {}
    for case in published["cases"]:
        for file in (source / f"{case}.json", source / case / "diagnosis.json"):
            if file.is_file():
                taken[case] = sensible(read_json(file), file)
                break
    if not taken:
        raise ValueError(f"{source}: no answers here; CASE.json or CASE/diagnosis.json for the cases of {folder.cases}")
    book = Answers(folder, name)
    for case, said in taken.items():
        write_json(book.file(case), said | {"by": {"commit": "unknown"}})
    return book.publish(list(published["cases"]))


def _short(said):
    return " ".join(filter(None, (said["verdict"], said.get("effect"))))
