"""One thing kept from call to call, as a batch: planners and fits ask for the same systems again and again, under other controllers or
values."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar

__all__ = ["Latest"]

Made = TypeVar("Made")


class Latest(Generic[Made]):
    """What was made last, which is made anew only for another key; threads wait for each other. It is no part of what is copied, pickled
    or compared."""

    def __init__(self):
        self._key, self._made, self._lock = None, None, Lock()

    def of(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """That of ``key``, by ``make`` unless it is the last one's."""
        with self._lock:
            if self._made is None or key != self._key:
                self._key, self._made = None, None  # what is no longer needed makes room first
                self._key, self._made = key, make()
            return self._made

    def __reduce__(self):
        return Latest, ()
