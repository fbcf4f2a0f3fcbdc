"""Answering a sealed set: every entrant on every case, and the hash of every answer, before anything is opened."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ...datasets.concealed.folder import Folder
from ...datasets.concealed.seal import parsed, read_json
from ...spelling import nearest
from ..executors.base import Executor
from ..executors.local import LocalProcesses
from ..provenance import commit
from .book import Answers
from .entrants import entrants
from .entrants.base import Given
from .opening import opened_labels
from .schema import LARGEST, Answer

__all__ = ["answer_case", "answer_set", "each", "read_answers", "take_answers"]


def each(
    function: Callable,
    items: Sequence[tuple],
    *,
    jobs: int = 1,
    device: str = "cpu",
    executor: Executor | None = None,
    reads: Sequence[Path] = (),
):
    """(item, what ``function(*item)`` returned) as they are done, in ``jobs`` fresh processes; in this one where that is 1.

    On ``device`` "cuda" the processes share out the graphics cards. An ``executor`` does it instead; ``reads`` are the folders that the
    function reads.
    """
    if jobs == 1 and executor is None:
        for item in items:
            yield item, function(*item)
        return
    done: dict[Hashable, Any] = dict(enumerate(items))
    work = {k: partial(function, *item) for k, item in done.items()}
    with closing((executor or LocalProcesses(jobs)).each(work, device=device, reads=reads)) as finished:
        for k, future in finished:
            yield done[k], future.result()


def answer_case(case: Path, names: Sequence[str], preset: str, device: str, label: dict | None = None) -> dict[str, dict]:
    """Answers of the entrants ``names`` to ``case``/fit, with fit_2 and so on, and ``case``/transfer.

    An error is an answer that says so, and so is nonsense.
    """
    found, given, shared = {}, None, 0.0
    for name in names:
        begun = time.time()
        try:
            given = given or _given(case, preset, device)
            given.label = label if entrants()[name].told else None
            answered = "diagnosis" in vars(given)
            said = _understood(entrants()[name].answer(given))
            seconds = time.time() - begun + (shared if answered else 0.0)  # who comes later did not wait for the diagnosis again
            said = replace(said, seconds=round(seconds, 1))
            shared = shared if answered or "diagnosis" not in vars(given) else float(given.diagnosis.result["seconds"])
        except Exception as error:
            traceback.print_exc()
            said = Answer.failed(f"{type(error).__name__}: {error}", round(time.time() - begun, 1))
        found[name] = said.plain()
    return found


def _given(case: Path, preset: str, device: str) -> Given:
    from ..opening import open_scenario

    further = sorted((path for path in case.glob("fit_*") if path.is_dir()), key=lambda path: int(path.name.removeprefix("fit_")))
    fit, transfer, *more = (open_scenario(str(path)) for path in (case / "fit", case / "transfer", *further))
    return Given(fit, transfer, tuple(more), preset=preset, device=device)


def _understood(said) -> Answer:
    """What an entrant said, as it would be read from a file. Raises ValueError where that is no answer."""
    text = json.dumps(said, allow_nan=False).encode()
    if len(text) > LARGEST:
        raise ValueError(f"an answer must have at most {LARGEST} bytes, got {len(text)}")
    return Answer.from_dict(parsed(text))


def answer_set(
    root: str | Path,
    *,
    names: Sequence[str] = ("diagnosis",),
    preset: str = "quick",
    device: str = "cpu",
    jobs: int = 1,
    executor: Executor | None = None,
    progress: Callable[[str], None] = lambda said: None,
) -> dict[str, str]:
    """Answer the sealed set in ``root``; answers that are there are kept. Returns the root hash of each entrant's answers.

    ``jobs`` cases are answered at the same time, by processes of this machine; or else ``executor`` says who answers.

    No label is read, but for entrants that are told, and for them only where the set was opened before. Raises ValueError for an unknown
    entrant, recordings that are not those that were published, or a told entrant on a set that is still sealed.
    """
    folder = Folder(Path(root))
    published, known = folder.published(), entrants()
    for name in names:
        if name not in known:
            raise ValueError(f"unknown entrant {name!r}; {nearest(name, known)}")
    cases = list(published["cases"])
    for name in cases:
        folder.check_recordings(name, published)
    labels = opened_labels(folder) if any(known[n].told for n in names) else {}
    about = {"commit": commit(), "preset": preset, "device": device}
    books = {name: Answers(folder, name) for name in names}
    for book in books.values():
        book.check_new()
    direct, derived = ([n for n in names if known[n].derived is so] for so in (False, True))
    if derived and "diagnosis" not in names:
        _source(folder, derived, cases)  # before work of hours
    there = {name: books[name].read(cases) for name in names}
    missing = {case: tuple(n for n in direct if case not in there[n]) for case in cases}
    todo = [(folder.cases / case, wanted, preset, device, labels.get(case)) for case, wanted in missing.items() if wanted]
    how = {"jobs": jobs, "device": device, "executor": executor, "reads": [folder.cases]}
    for done, (item, found) in enumerate(each(answer_case, todo, **how), 1):
        case = Path(item[0]).name
        for name, said in found.items():
            books[name].write(case, Answer.from_dict(said), about)
        progress(f"{done} of {len(todo)}: {case} " + ", ".join(f"{n}: {_short(a)}" for n, a in found.items()))
    roots = {name: books[name].publish(cases) for name in direct}
    for name in derived:
        source = {case: said.plain() for case, said in _source(folder, derived, cases).items()}
        for case, said in _derived(known[name], source, published["root"]).items():
            if case not in there[name]:
                books[name].write(case, said, about)
        roots[name] = books[name].publish(cases)
    return {name: roots[name] for name in names}


def _source(folder, derived, cases) -> dict[str, Answer]:
    """The answers of which others are made. Raises ValueError where some are missing."""
    source = Answers(folder, "diagnosis").read(cases)
    if len(source) < len(cases):
        raise ValueError(f"{derived[0]} is made of the answers of the diagnosis: have it answer all {len(cases)} cases first")
    return source


def _derived(entrant, source: Mapping[str, dict], seed: str) -> dict[str, Answer]:
    """The answers that are made of others'; one that fails fails by itself."""
    try:
        made = entrant.derive(source, seed)
        return {case: _or_failed(lambda case=case: _understood(made[case])) for case in source}
    except Exception as error:
        traceback.print_exc()
        return dict.fromkeys(source, Answer.failed(f"{type(error).__name__}: {error}"))


def _or_failed(read: Callable[[], Answer]) -> Answer:
    try:
        return read()
    except (ValueError, TypeError, KeyError) as error:
        return Answer.failed(f"{type(error).__name__}: {error}")


def read_answers(folder: Folder, source: Path) -> dict[str, Answer]:
    """Answers of another program by case, from ``source``/CASE.json, or /CASE/diagnosis.json as twinbench diagnose writes it.

    What says nothing sensible has failed, with the file and the reason. Raises ValueError where there are no answers, or none that is one.
    """
    found = {}
    for case in folder.published()["cases"]:
        file = next((f for f in (source / f"{case}.json", source / case / "diagnosis.json") if f.exists() or f.is_symlink()), None)
        if file is not None:
            found[case] = _read(file)
    if not found:
        raise ValueError(f"{source}: no answers here; CASE.json or CASE/diagnosis.json for the cases of {folder.cases}")
    if all(said.verdict == "failed" for said in found.values()):
        raise ValueError(f"{next(iter(found.values())).error or f'{source}: every answer says that it failed'}")
    return found


def _read(file):
    try:
        said = read_json(file, LARGEST)
    except ValueError as error:
        return Answer.failed(str(error))
    try:
        return Answer.from_dict(said)
    except ValueError as error:
        return Answer.failed(f"{file}: {error}")


def take_answers(root: str | Path, *, name: str, source: str | Path, seal: bool = True) -> tuple[dict[str, Answer], str]:
    """Seal the answers of another program under ``name``, see ``read_answers``; without ``seal`` only look at them.

    What an answer leaves out counts as not said, one that says nothing sensible as failed. Returns the answers and their root.
    Raises ValueError for a name that cannot be one or is an entrant's, and as ``read_answers`` does.
    """
    folder, source = Folder(Path(root)), Path(source)
    book = Answers(folder, name)
    if name in entrants():
        raise ValueError(f"{name!r} answers by itself; choose another name for the answers in {source}")
    book.check_new()
    taken = read_answers(folder, source)
    if not seal:
        return taken, ""
    for case in folder.published()["cases"]:
        if case in taken:
            book.write(case, taken[case], {"commit": "unknown"})
        else:
            book.file(case).unlink(missing_ok=True)
    return taken, book.publish(list(folder.published()["cases"]))


def _short(said):
    return " ".join(filter(None, (said["verdict"], said.get("effect"))))
