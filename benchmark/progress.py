"""How far a command is, on standard error: a bar with the time that is left on a terminal, else a line for each step."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterable
from typing import Any

from .text import shown

__all__ = ["REMEMBERED", "SCORED", "Bar", "Bytes", "say", "spoken_time"]

SCORED, REMEMBERED = "scored", "remembered"  # how a step ends: by work, or because its rows were there
SILENCE = 60.0  # s after which a step that goes on says so, where there is no bar


def say(text: str) -> None:
    """A line on standard error, above the bars that are there."""
    from tqdm import tqdm

    tqdm.write(shown(text), file=sys.stderr)


class Bar:
    """Progress of fits. Called with a label and the share of everything that is done; a label of a step is "METHOD on RECORDINGS: STAGE".

    ``steps`` are the methods of all steps. What is left is told once a step of every method that remains has been finished, from what those
    took; nothing is guessed before. ``quiet`` says nothing at all.
    """

    def __init__(self, title: str, steps: Iterable[str] = (), *, quiet: bool = False):
        self._title, self._quiet, self._done = shown(title), quiet, 0.0
        self._bar: Any = None  # before ``__enter__``
        self._left = Counter(steps)
        self._count = self._left.total()
        self._took: dict[str, list[float]] = {}
        self._ended = self._said = time.monotonic()

    def __enter__(self):
        from tqdm import tqdm

        shape = "{desc} {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
        hidden = True if self._quiet else None  # None: where standard error is no terminal
        self._bar = tqdm(total=1.0, disable=hidden, leave=False, bar_format=shape, desc=self._title, dynamic_ncols=True)
        return self

    def __call__(self, label: str, fraction: float) -> None:
        now, (step, _, stage) = time.monotonic(), shown(label).partition(": ")
        if stage in (SCORED, REMEMBERED):
            self._end(step, stage, now)
        elif stage and now - self._said > SILENCE:
            self._line(f"{step}: {stage}", now)
        self._bar.set_description_str(f"{self._title}: {shown(label)}", refresh=False)
        self._bar.set_postfix_str(self.remaining(now), refresh=False)
        self._bar.update(max(fraction - self._done, 0.0))
        self._bar.refresh()
        self._done = max(fraction, self._done)

    def _end(self, step: str, stage: str, now: float) -> None:
        method = step.split(" on ")[0]
        self._left[method] -= 1
        took, self._ended = now - self._ended, now
        if stage == SCORED:
            self._took.setdefault(method, []).append(took)
            left = self.remaining(now)
            self._line(f"{step}: {stage} after {spoken_time(took)}{', ' if left else ''}{left}", now)

    def remaining(self, now: float) -> str:
        """How much time is left, in words; "" where that is not known."""
        left = {method: count for method, count in self._left.items() if count > 0}
        if not left or not set(left) <= set(self._took):
            return ""
        expected = sum(count * sum(self._took[method]) / len(self._took[method]) for method, count in left.items())
        return f"about {spoken_time(max(expected - (now - self._ended), 0.0))} left"

    def _line(self, said: str, now: float) -> None:
        self._said = now
        if self._bar.disable and not self._quiet:
            done = f"{self._count - self._left.total()} of {self._count}: " if self._count else ""
            print(f"{self._title}: {done}{said}", file=sys.stderr, flush=True)

    def __exit__(self, *_):
        self._bar.close()


def spoken_time(seconds: float) -> str:
    """A time in words, as exact as one cares to know."""
    for limit, unit, name in ((100, 1, "s"), (6000, 60, "min"), (float("inf"), 3600, "h")):
        if seconds < limit:
            return f"{seconds / unit:.{int(seconds / unit < 9.95)}f} {name}"
    raise ValueError(f"seconds must be a number, got {seconds}")


class Bytes:
    """A progress bar for each file being fetched; nothing where standard error is no terminal."""

    def __init__(self):
        self._bars: dict = {}

    def __enter__(self):
        return self

    def __call__(self, name: str, here: int, size: int | None) -> None:
        from tqdm import tqdm

        if name not in self._bars:
            self._bars[name] = tqdm(total=size, disable=None, desc=name, unit="B", unit_scale=True, initial=here)
        self._bars[name].update(here - self._bars[name].n)

    def __exit__(self, *_):
        for bar in self._bars.values():
            bar.close()
