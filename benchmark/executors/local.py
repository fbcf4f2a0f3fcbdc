"""Processes of this machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from ...datasets.pool import finished
from ..processes import cards, workers
from .base import Executor

__all__ = ["LocalProcesses"]


class LocalProcesses(Executor):
    """``jobs`` fresh processes, each with its part of the cores and, on ``devices``, with one graphics card.

    ``devices`` are by default the cards that this process sees. A lost process is not replaced: what ended it is most often want of memory.
    """

    name: ClassVar[str] = "local"
    remote: ClassVar[bool] = False

    def __init__(self, jobs: int = 1, devices: Sequence[str] | None = None):
        self.jobs, self.devices = jobs, devices

    @property
    def options(self):
        return {"executor": self.name, "jobs": self.jobs}

    def each(self, work, *, device="cpu", reads=(), writes=()):
        if not work:
            return
        devices = cards(device) if self.devices is None else self.devices
        with workers(max(1, min(self.jobs, len(work))), devices) as pool:
            yield from finished(pool, work)
