"""What a run would take from the cache, and why it would compute the rest."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator

from .cache import Cache, Entry
from .origin import Forerunners, spoken
from .plan import Fit
from .runner import Runner
from .status import Stopped
from .upkeep import Upkeep

__all__ = ["ago", "described", "explain", "explain_entry", "megabytes"]


def explain(runner: Runner, fits: Iterable[Fit]) -> Iterator[str]:
    """Lines on each fit and its rows: whether they are there, or why not."""
    cache = runner.cache
    fitted, scored = Forerunners(cache, "fits"), Forerunners(cache, "rows")
    for fit in fits:
        who = f"{fit.method} on {', '.join(fit.sources)}, seed {fit.seed}"
        if fit.skip:
            yield f"{who}: skipped, {fit.skip}"
            continue
        missing = {}
        try:
            origin = runner.origin(fit)
            for evaluation in fit.evaluations:
                row = runner.row_origin(fit, evaluation)
                if cache.read("rows", row.key) is None:
                    missing[evaluation] = scored.why(row)
        except Stopped as stopped:
            yield f"{who}: {stopped.row['reason']}"
            continue
        there = cache.read_folder("fits", origin.key) is not None
        if there:
            yield f"{who}: fitted, {origin.key[:12]}"
        elif not missing:
            yield f"{who}: all rows are there, the twin is not needed"
        elif why := fitted.why(origin):
            yield f"{who}: will be refitted because {why}"
        else:
            yield f"{who}: not fitted yet"
        for evaluation, why in missing.items() if there else ():
            yield f"  {evaluation.task} of {evaluation.target}: will be scored{' again because ' + why if why else ''}"


def explain_entry(cache: Cache, entry: Entry) -> Iterator[str]:
    """Lines on one entry: whose it is, what it was made from, and whether anything would use it."""
    yield f"{entry.kind} {entry.key}"
    yield f"stored {ago(entry.stored)}, {megabytes(entry.bytes)}"
    if entry.made:
        inputs, subject = entry.made["inputs"], entry.made["subject"]
        yield described(entry)
        yield from (f"{name} {inputs[name]}" for name in ("seed", "preset", "device", "split", "task") if name in inputs)
        yield from (f"{spoken(name)} {value[:12]}" for name, value in zip(subject.get("data", ()), inputs.get("data", ()), strict=False))
        yield f"code of {len(inputs.get('code', {}))} files, from {', '.join(subject.get('modules', ()))}"
    why = Upkeep(cache).unused(entry)
    yield f"Nothing would use it: {why}" if why else "It would be used again."


def described(entry: Entry) -> str:
    """Whose an entry is."""
    if not entry.made:
        return "" if entry.sound else "damaged, or of another version"
    subject = entry.made["subject"]
    if "recordings" not in subject:
        return str(subject.get("folder", ""))
    who = f"{subject['method']} on " if "method" in subject else ""
    scored = f": {subject['task']} of {subject['target']}" if "task" in subject else ""
    return f"{who}{', '.join(subject['recordings'])}{scored}"


def ago(then: float) -> str:
    """How long ago a time was, in its largest unit."""
    passed = max(0.0, time.time() - then)
    for seconds, unit in ((86400, "day"), (3600, "hour"), (60, "minute")):
        if passed >= seconds:
            count = int(passed // seconds)
            return f"{count} {unit}{'s' if count > 1 else ''} ago"
    return "just now"


def megabytes(size: int) -> str:
    """A number of bytes as people read it."""
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"
