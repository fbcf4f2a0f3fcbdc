"""A run on several graphics cards: a process a card, fits dealt out as cards fall idle, rows as one process would have computed them."""

from __future__ import annotations

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
    devices: Sequence[str],
    *,
    progress: Progress = lambda label, fraction: None,
) -> list[dict]:
    """The rows of ``fits`` in their order, computed by one process for each of ``devices``.

    Twins and rows pass through ``cache``, as they do between runs. Raises as ``Runner.run`` does.
    """
    groups = _together(fits, settings)
    rows: dict[int, list[dict]] = {}
    progress("reading", 0.0)
    with workers(min(len(devices), len(groups)), devices) as pool:
        running = {pool.submit(_rows, opened.path, opened.split, settings, cache, [fits[k] for k in group]): group for group in groups}
        for future in as_completed(running):
            group = running[future]
            rows |= zip(group, future.result(), strict=True)
            progress(f"{fits[group[-1]].method} on {'+'.join(fits[group[-1]].sources)}", len(rows) / len(fits))
    return [row for k in range(len(fits)) for row in rows[k]]


def _together(fits: Sequence[Fit], settings: Settings) -> list[list[int]]:
    """Indices of fits that go to one process: a method that builds on another's twin waits for that twin."""
    groups: dict[tuple, list[int]] = {}
    for k, fit in enumerate(fits):
        base = getattr(settings.methods[fit.method], "builds_on", "") or fit.method
        groups.setdefault((base, fit.sources, fit.seed), []).append(k)
    return [sorted(group, key=lambda k: bool(getattr(settings.methods[fits[k].method], "builds_on", ""))) for group in groups.values()]


def _rows(path: str, split: str, settings: Settings, cache: Cache, fits: list[Fit]) -> list[list[dict]]:
    """The rows of each of ``fits``, in a process of its own."""
    runner = Runner(open_recordings(path, split=split, cache=cache), settings, cache)
    return [runner.run([fit]) for fit in fits]
