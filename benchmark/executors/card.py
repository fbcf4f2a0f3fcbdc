"""One piece of work to a graphics card, whatever processes of this machine share the cards out."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["claimed"]

POLL = 0.5  # s between two looks for a card that is free


@contextmanager
def claimed(cards: Sequence[str]) -> Iterator[str]:
    """One of ``cards`` that no other process of this user has claimed, as soon as there is one; "" where there are none.

    The claim is a lock on a file, which the system lets go of when the process ends, however it ends.
    """
    if not cards:
        yield ""
        return
    import fcntl

    held = None
    while held is None:
        for card in cards:
            name = "".join(c if c.isalnum() else "-" for c in card)
            found = os.open(Path(tempfile.gettempdir()) / f"twinbench-{os.getuid()}-card-{name}.lock", os.O_RDWR | os.O_CREAT, 0o600)
            with suppress(BlockingIOError):
                fcntl.flock(found, fcntl.LOCK_EX | fcntl.LOCK_NB)
                held = found
                break
            os.close(found)
        else:
            time.sleep(POLL)
    try:
        yield card
    finally:
        os.close(held)
