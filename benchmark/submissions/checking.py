"""Everything that is wrong with a submission, at once: its metadata, what is missing, and every roll-out beside its recording."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

from ...datasets.files import open_regular, read_json
from ...datasets.findings import UNREADABLE, Finding, Findings, attempt, changed, collected, error, refuse, shown, warning
from ...datasets.scenario import Scenario
from ...spelling import nearest
from ..cache import Cache
from ..checksum import Checksums
from ..opening import Opened
from ..plan import Evaluation, plan
from .format import FILE, Rollout, Submission
from .reading import rollout_rules
from .rules import submission_rules

__all__ = ["check", "checked", "content", "read_submission", "wanted"]

Progress = Callable[[str, float], None]


def check(folder: Path, opened: Opened, cache: Cache, *, progress: Progress = lambda label, fraction: None) -> list[Finding]:
    """All that is wrong with the submission in ``folder`` as one of the recordings ``opened``: errors, and warnings."""
    return collected(_rules(Path(folder), opened, cache, progress))[0]


def checked(folder: Path, opened: Opened, cache: Cache, *, progress: Progress = lambda label, fraction: None) -> Submission:
    """The submission in ``folder``. Raises ValueError with the first error and how many more there are."""
    found, submission = collected(_rules(Path(folder), opened, cache, progress))
    if wrong := [finding for finding in found if finding.severity == "error"]:
        more = f" (and {len(wrong) - 1} more: twinbench submit check {folder} lists all)" if len(wrong) > 1 else ""
        raise ValueError(f"{wrong[0].file}: {wrong[0].said}{more}")
    return submission


def read_submission(folder: Path) -> Submission:
    """What ``submission.json`` says. Raises ValueError with the first rule that is broken; no roll-out is looked at."""
    return refuse(_metadata(Path(folder)))


def wanted(submission: Submission, opened: Opened) -> dict[tuple, list[Evaluation]]:
    """What is scored with each roll-out that is asked for, by its key."""
    found: dict[tuple, list[Evaluation]] = {}
    for fit in plan(opened.collection, methods=[submission.method], tasks=submission.tasks, seeds=submission.seeds):
        for evaluation in fit.evaluations:
            found.setdefault((fit.sources, evaluation.target, fit.seed), []).append(evaluation)
    return found


def content(folder: Path, submission: Submission) -> str:
    """Hexadecimal SHA-256 of ``submission.json`` and of every file that it names."""
    state = hashlib.sha256()
    for name in dict.fromkeys((FILE, *(one.file for one in submission.rollouts if one.file))):
        with open_regular(Path(folder) / name) as stream:
            state.update(f"{name}\n".encode() + hashlib.file_digest(cast(Any, stream), "sha256").digest())
    return state.hexdigest()


def _metadata(folder: Path) -> Findings:
    file = folder / FILE
    values = yield from attempt(file, read_json, file)
    if values is UNREADABLE:
        return None
    return (yield from changed(submission_rules(values), lambda finding: Finding(file, finding.severity, finding.message, finding.field)))


def _rules(folder: Path, opened: Opened, cache: Cache, progress: Progress) -> Findings:
    """Returns the submission, or None where it does not say what it is of."""
    submission = yield from _metadata(folder)
    if submission is None:
        return None
    from ...methods.registry import methods

    if submission.method in methods():
        said = f"is {submission.method!r}, the name of a method of twinbench: give it another, unless it is that method"
        yield warning("method", said, folder / FILE)
    asked = yield from _coverage(folder, submission, opened)
    yield from _files(folder, submission)
    by_recording: dict[str, list[Rollout]] = {}
    for one in submission.rollouts:
        if one.key in asked:
            by_recording.setdefault(one.recording, []).append(one)
    learnt = Checksums(cache, opened.key)
    names = dict.fromkeys(name for sources, target, _ in asked for name in (target, *sources))
    for k, name in enumerate(names):
        progress(f"checking {name}", k / len(names))
        yield from _recording(folder, submission, opened, name, by_recording.get(name, ()), learnt)
    progress("done", 1.0)
    return submission


def _coverage(folder: Path, submission: Submission, opened: Opened) -> Findings:
    """Each roll-out that is asked for must be there once, and no other. Returns the keys of those that are asked for."""
    file, asked = folder / FILE, wanted(submission, opened)
    here = opened.collection.scenarios
    named = dict.fromkeys(one.recording for one in submission.rollouts)
    if named and here.keys().isdisjoint(named):
        said = f"are of {shown(list(named))}, and the recordings of {opened.collection.name} are {shown(list(here))}"
        yield error("rollouts", f"{said}: --data names the folder that they are in", file)
        return {}
    for name in submission.data["recordings"]:
        if name not in here:
            yield error("data.recordings", f"has the unknown recording {shown(name)}; {nearest(name, here)}", file)
    given = Counter(one.key for one in submission.rollouts)
    for number, one in enumerate(submission.rollouts):
        if one.key not in asked:
            unknown = [name for name in (one.recording, *one.fitted_on) if name not in here]
            nearby = f"unknown recording {unknown[0]!r}; {nearest(unknown[0], here)}" if unknown else ""
            yield error(f"rollouts[{number}]", f"is not asked for: {nearby or f'{one} is not scored'}", file)
    for key, times in given.items():
        if times > 1:
            yield error("rollouts", f"must give {_one(*key)} once, got it {times} times", file)
    for key in asked:
        if key not in given:
            yield error("rollouts", f"lack {_one(*key)}; where there is none, status and reason say why", file)
    if not asked:
        yield error("tasks", f"must have one that {opened.collection.name} has recordings for, got {', '.join(submission.tasks)}", file)
    return asked


def _one(fitted_on: tuple[str, ...], recording: str, seed: int) -> Rollout:
    return Rollout(recording, fitted_on, seed)


def _files(folder: Path, submission: Submission) -> Findings:
    """Files must lie in the folder, each be named once, and none be left over."""
    named = Counter(one.file for one in submission.rollouts if one.file)
    for name, times in named.items():
        if times > 1:
            yield error("rollouts", f"must name each file once, got {name} {times} times", folder / FILE)
        if not _lies_in(folder, name):
            yield error("", "must lie in the folder of the submission, got a link that leads out of it", folder / name)
    for place in sorted({(folder / name).parent for name in named}):
        for left in sorted(place.glob("*.npz")) if place.is_dir() else ():
            if left.relative_to(folder).as_posix() not in named:
                yield warning("", f"is not named in {FILE}, and not looked at", left)


def _recording(folder: Path, submission: Submission, opened: Opened, name: str, rollouts: Sequence[Rollout], learnt: Checksums) -> Findings:
    """The checksum of one recording, and the roll-outs of it."""
    loaded: list[Scenario] = []

    def load(name: str) -> Scenario:
        if not loaded:
            loaded.append(opened.collection.load(name))
        return loaded[0]

    file, said = folder / FILE, submission.data["recordings"].get(name)
    if (yield from attempt(file, learnt.learn, [name], load)) is UNREADABLE:
        return
    if said is None:
        yield error("data.recordings", f"lacks the checksum of {name}, which is {learnt[name]}", file)
    elif said != learnt[name]:
        rule = f"must have the checksum of {name} as it is here, {learnt[name]}"
        yield error(
            "data.recordings", f"{rule}, got {said}: the roll-outs were made for another recording, or one of them was changed", file
        )
    for one in rollouts:
        if one.file and _lies_in(folder, one.file):
            if (scenario := (yield from attempt(file, load, name))) is UNREADABLE:
                return
            yield from rollout_rules(folder, one, scenario)


def _lies_in(folder: Path, name: str) -> bool:
    """Whether a file is in the folder, all links followed."""
    return (folder / name).resolve().is_relative_to(folder.resolve())
