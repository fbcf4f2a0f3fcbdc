"""What ``--log-level`` shows: twinbench's log, on standard error, above the bars that are there."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from .options import known

__all__ = ["LEVELS", "logged"]

LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class _Above(logging.Handler):
    """Writes lines where they do not disturb a progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        from .progress import say

        say(self.format(record))


@contextmanager
def logged(level: str) -> Iterator[None]:
    """Within, messages of at least ``level`` are shown. Raises ValueError for an unknown level."""
    known("log level", [level], LEVELS)
    log, handler = logging.getLogger("twinbench"), _Above()
    handler.setFormatter(logging.Formatter("%(message)s" if level != "debug" else "%(asctime)s %(process)d %(message)s"))
    before = log.level
    log.addHandler(handler)
    log.setLevel(LEVELS[level])
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(before)
