"""One batch kept from call to call: planners and fits ask for the same systems again and again, under other controllers or values."""

from __future__ import annotations

from collections.abc import Callable, Hashable

from .batch import Batch

__all__ = ["Latest"]


class Latest:
    """The batch that was made last, which is made anew only for another key. It is no part of what is copied, pickled or compared."""

    def __init__(self):
        self._key, self._batch = None, None

    def of(self, key: Hashable, make: Callable[[], Batch]) -> Batch:
        """The batch of ``key``, by ``make`` unless it is the last one's."""
        if self._batch is None or key != self._key:
            self._key, self._batch = None, None  # what is no longer needed makes room first
            self._key, self._batch = key, make()
        return self._batch

    def __reduce__(self):
        return Latest, ()
