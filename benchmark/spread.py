"""A run by several processes, on graphics cards one a card: fits are dealt out as processes fall idle, rows are those of one process."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from concurrent.futures import as_completed

from .cache import Cache
from .opening import Opened, open_recordings
from .plan import Fit
from .processes import workers
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
    progress: Progress = lambda label, fraction: None,
) -> list[dict]:
    """The rows of ``fits`` in their order, computed by ``jobs`` processes that share out ``devices``, or else one for each of these.

    Twins and rows pass through ``cache``, as they do between runs. Raises as ``Runner.run`` and ``workers`` do, and ValueError where other
    processes cannot find the recordings or the methods.
    """
    _check_portable(opened, settings)
    groups = _together(fits, settings)
    rows: dict[int, list[dict]] = {}
    progress("reading", 0.0)
    where = opened.path, opened.split, opened.collection.name
    with workers(min(jobs or len(devices), len(groups)), devices) as pool:
        running = {pool.submit(_rows, where, settings, cache, [fits[k] for k in group]): group for group in groups}
        for future in as_completed(running):
            for k, (found, last) in zip(running[future], future.result(), strict=True):
                rows[k] = found
                progress(last, len(rows) / len(fits))
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


def _check_portable(opened: Opened, settings: Settings) -> None:
    if not opened.path:
        raise ValueError(f"--jobs must be 1: the recordings of {opened.collection.name} are in no folder where other processes find them")
    for kind in ("methods", "metrics"):
        for name, found in getattr(settings, kind).items():
            try:
                pickle.dumps(found)
                lost = getattr(found, "__module__", "") == "__main__"
            except (pickle.PicklingError, AttributeError, TypeError):
                lost = True
            if lost:
                raise ValueError(f"--jobs must be 1: {name!r} is not in a file of its own, from which other processes could import it")


def _rows(where: tuple[str, str, str], settings: Settings, cache: Cache, fits: list[Fit]) -> list[tuple[list[dict], str]]:
    """The rows of each of ``fits`` and how it ended, in a process of its own."""
    path, split, name = where
    runner = Runner(open_recordings(path, split=split, cache=cache).called(name), settings, cache)
    found = []
    for fit in fits:
        told: list[str] = []
        rows = runner.run([fit], progress=lambda label, _, told=told: told.append(label))
        found.append((rows, told[-2]))  # the last is "done"
    return found
