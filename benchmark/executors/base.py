"""What all executors have in common: pieces of work go in, their results come out as they are done."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future
from typing import ClassVar, TypeVar

__all__ = ["MAX_ATTEMPTS", "Executor", "failed"]

Name = TypeVar("Name")
Paths = Sequence[str | os.PathLike]

MAX_ATTEMPTS = 3  # how often a piece is begun whose worker is lost: one lost node is chance, three are the piece's own doing


class Executor(ABC):
    """Does pieces of work in other processes, here or on other machines."""

    name: ClassVar[str]
    remote: ClassVar[bool] = True
    """Whether the processes may be on other machines."""

    @property
    @abstractmethod
    def options(self) -> dict[str, object]:
        """The options of a command that ask for this executor."""

    @abstractmethod
    def each(
        self, work: Mapping[Name, Callable[[], object]], *, device: str = "cpu", reads: Paths = (), writes: Paths = ()
    ) -> Generator[tuple[Name, Future]]:
        """The name of each piece of ``work`` with its finished future, as they are done.

        work    functions without arguments that other processes can import (``functools.partial``), by name
        device  "cuda": each piece has a graphics card to itself
        reads   files and folders that all workers must see
        writes  folders that all workers must see and share with this process

        What a piece raises is in its future. A piece whose worker is lost is done again, at most ``MAX_ATTEMPTS`` times in all by executors
        on other machines; then its future has an OSError. Whoever closes the iterator before its end (``contextlib.closing``) cancels all
        pieces that are not done, at once.
        Raises ValueError where a worker does not see a path, OSError where there are no workers.
        """


def failed(error: BaseException) -> Future:
    """A future that has failed with ``error``."""
    future: Future = Future()
    future.set_exception(error)
    return future
