"""Ctrl-C and SIGTERM end a command within two seconds, with the processes that it started, whatever it is computing.

Python hears of a signal only between two steps of its own, and a simulation may be one step of many seconds. So a thread hears of it too,
and ends the process where that has not ended by itself soon. Nothing is lost by that: all files appear in one rename.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

__all__ = ["Stop", "stoppable"]

GRACE = 0.7  # s: what a command may take to leave by itself
SIGNALS = (signal.SIGINT, signal.SIGTERM)
GOES_ON, ANEW = "twinbench: stopped; the same command goes on from here", "twinbench: stopped; the same command begins anew"


class Stop:
    """What a command was told: the ``signal``, 0 while it was told nothing; and whether the user has been ``answered``.

    ``goes_on`` is whether the same command goes on from where it was stopped.
    """

    def __init__(self):
        self.signal, self.answered, self.goes_on = 0, False, True

    @property
    def code(self) -> int:
        """The exit code by which a shell knows what ended a command."""
        return 128 + (self.signal or signal.SIGINT)

    def say(self) -> None:
        """Tell the user, once."""
        if not self.answered:
            self.answered = True
            with suppress(OSError, ValueError):
                os.write(2, f"{chr(10) if os.isatty(2) else ''}{GOES_ON if self.goes_on else ANEW}\n".encode())

    def end(self) -> None:
        """End this process and its children at once. Python would first take its libraries apart, for seconds."""
        self.say()
        with suppress(Exception):  # whatever state the process is in
            if "multiprocessing" in sys.modules:
                from .processes import end_children

                end_children()
        os._exit(self.code)


@contextmanager
def stoppable() -> Iterator[Stop]:
    """Within, the first SIGINT or SIGTERM raises KeyboardInterrupt. The process ends when that leaves the block, ``GRACE`` seconds later,
    or by a second signal, whichever is first.

    Outside the main thread, where signals are nobody's business, it does nothing.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    done = threading.Event()

    def heard(number, _) -> None:
        if not stop.signal and not done.is_set():
            stop.signal = number
            raise KeyboardInterrupt

    def unraisable(problem, before=sys.unraisablehook) -> None:
        if not isinstance(problem.exc_value, KeyboardInterrupt):  # heard where nothing can be raised: the thread will see to it
            before(problem)

    threading.Thread(target=_watch, args=(reading, stop), daemon=True).start()
    fd, hook = signal.set_wakeup_fd(writing, warn_on_full_buffer=False), sys.unraisablehook
    handlers = {number: signal.signal(number, heard) for number in SIGNALS}
    sys.unraisablehook = unraisable
    try:
        yield stop
    finally:
        done.set()
        if stop.signal:
            stop.end()
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(fd)
        sys.unraisablehook = hook
        os.close(writing)


def _watch(reading: int, stop: Stop) -> None:
    """Wait for a signal, and see to it that the process ends."""
    import select

    while (heard := os.read(reading, 1)) and heard[0] not in SIGNALS:
        pass
    if heard:
        select.select([reading], [], [], GRACE)
        stop.signal = stop.signal or heard[0]
        stop.end()
    os.close(reading)
