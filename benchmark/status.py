"""How a row ended: "ok", or "diverged", "skipped", "failed" or "unreadable" (a recording that it needs) with the reason."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..methods.base import Diverged

__all__ = ["FAULTS", "Stopped", "as_status"]

FAULTS = ("failed", "unreadable")  # what somebody has to mend: a run with such rows ends with code 1


class Stopped(Exception):
    """Ends the work on some rows early; ``row`` says how."""

    def __init__(self, **row):
        super().__init__(row["status"])
        self.row = row


@contextmanager
def as_status() -> Iterator[None]:
    """Turn what a method raises into the status of its rows."""
    try:
        yield
    except Stopped:
        raise
    except Diverged as error:
        raise Stopped(status="diverged", reason=str(error), diverged_frame=int(error.frame)) from error
    except Exception as error:  # a method may fail in any way, and the other methods' rows must still come
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise Stopped(status="failed", reason=f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})") from error
