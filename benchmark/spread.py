"""A run by several processes, here or on a cluster: fits are dealt out as processes fall idle, rows are those of one process."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from contextlib import closing, suppress
from functools import partial

from .cache import Cache
from .executors.base import Executor
from .executors.local import LocalProcesses
from .opening import Opened, folder_of, open_recordings
from .plan import Fit
from .runner import Progress, Runner, Settings

__all__ = ["spread"]


def spread(
    opened: Opened,
    settings: Settings,
    cache: Cache,
    fits: Sequence[Fit],
    devices: Sequence[str] = (),
    *,
    jobs: int = 0,
    executor: Executor | None = None,
    progress: Progress = lambda label, fraction: None,
) -> list[dict]:
    """The rows of ``fits`` in their order, computed by ``executor``; by default ``jobs`` processes that share out ``devices``, or else one
    for each of these.

    Twins and rows pass through ``cache``, as they do between runs. Raises as ``Runner.run`` and ``Executor.each`` do, and ValueError where
    other processes cannot find the recordings or the methods.
    """
    executor = executor or LocalProcesses(jobs or len(devices), devices)
    _check_portable(opened, settings, "--executor must be local" if executor.remote else "--jobs must be 1")
    groups = _together(fits, settings)
    rows: dict[int, list[dict]] = {}
    progress("reading", 0.0)

    def take(group, done: Sequence[tuple[list[dict], str]]) -> None:
        for k, (found, last) in zip(group, done, strict=True):
            rows[k] = found
            progress(last, len(rows) / len(fits))

    if executor.remote:  # what is in the cache is no job
        looker = _Looker(opened, settings, cache)
        for group in groups:
            with suppress(_Unknown):
                take(group, _run(looker, [fits[k] for k in group]))
    where = opened.path, opened.split, opened.collection.name
    left = [group for group in groups if group[0] not in rows]
    work = {tuple(group): partial(_rows, where, settings, cache, [fits[k] for k in group]) for group in left}
    seen = () if opened.path == "sample" else (folder_of(opened.path),)
    with closing(executor.each(work, device=settings.device, reads=seen, writes=(cache.root,))) as finished:
        for group, future in finished:
            take(group, future.result())
    return [row for k in range(len(fits)) for row in rows[k]]


def _together(fits: Sequence[Fit], settings: Settings) -> list[list[int]]:
    """Indices of fits that go to one process: a method that builds on another's twin waits for that twin.

    Different recordings come first, so that what all methods need of a recording, its appearance, is there when the next one comes.
    """
    groups: dict[tuple, list[int]] = {}
    for k, fit in enumerate(fits):
        base = getattr(settings.methods[fit.method], "builds_on", "") or fit.method
        groups.setdefault((base, fit.sources, fit.seed), []).append(k)
    methods = list(dict.fromkeys(base for base, *_ in groups))
    dealt = [groups[key] for key in sorted(groups, key=lambda key: methods.index(key[0]))]
    return [sorted(group, key=lambda k: bool(getattr(settings.methods[fits[k].method], "builds_on", ""))) for group in dealt]


def _check_portable(opened: Opened, settings: Settings, rule: str) -> None:
    if not opened.path:
        raise ValueError(f"{rule}: the recordings of {opened.collection.name} are in no folder where other processes find them")
    for kind in ("methods", "metrics"):
        for name, found in getattr(settings, kind).items():
            try:
                pickle.dumps(found)
                lost = getattr(found, "__module__", "") == "__main__"
            except (pickle.PicklingError, AttributeError, TypeError):
                lost = True
            if lost:
                raise ValueError(f"{rule}: {name!r} is not in a file of its own, from which other processes could import it")


def _rows(where: tuple[str, str, str], settings: Settings, cache: Cache, fits: list[Fit]) -> list[tuple[list[dict], str]]:
    """The rows of each of ``fits`` and how it ended, in a process of its own."""
    path, split, name = where
    return _run(Runner(open_recordings(path, split=split, cache=cache).called(name), settings, cache), fits)


def _run(runner: Runner, fits: list[Fit]) -> list[tuple[list[dict], str]]:
    found = []
    for fit in fits:
        told: list[str] = []
        rows = runner.run([fit], progress=lambda label, _, told=told: told.append(label))
        found.append((rows, told[-2]))  # the last is "done"
    return found


class _Unknown(Exception):
    """Something must be read or computed."""


class _Looker(Runner):
    """Knows the rows that are in the cache, and reads and computes nothing. Raises _Unknown instead."""

    def _load(self, name):
        raise _Unknown

    def _compute(self, fit, evaluations, report):
        raise _Unknown
