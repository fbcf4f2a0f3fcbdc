"""Workers of dask.distributed: any cluster on which somebody has started a scheduler and workers.

The scheduler gives the work of a lost worker to another one, and drops the work of a client that is gone; workers notice that and stop.
"""

from __future__ import annotations

import logging
import uuid
from collections import Counter, deque
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from typing import Any, ClassVar

from ..processes import VISIBLE, cards, share
from .base import MAX_ATTEMPTS, Executor, failed
from .card import claimed
from .child import ChildEnded, in_child
from .piece import future_of, pack, place

__all__ = ["DaskWorkers"]

CONNECT = 10.0  # s in which the scheduler must answer
LEAVE = 0.3  # s to say good-bye in: a command that is stopped has less than a second left
WANTED = ("executing", "long-running", "resumed")  # states of a task, as its worker knows it, in which somebody waits for it
LEAVING = ("closing", "closed", "failed")  # states of a worker that waits for nothing but the end of its threads
log = logging.getLogger("twinbench")


class DaskWorkers(Executor):
    """The workers of the scheduler at ``address``, as ``tcp://127.0.0.1:8786``; ``jobs`` pieces at the same time, or all that there are."""

    name: ClassVar[str] = "dask"

    def __init__(self, address: str, *, jobs: int | None = None):
        self.address, self.jobs = address, jobs

    @property
    def options(self):
        return {"executor": self.name, "scheduler": self.address, "jobs": self.jobs}

    def each(self, work, *, device="cpu", reads=(), writes=()):
        if not work:
            return
        with place(reads, writes) as where, self._client() as client:
            packed = {name: pack(where, piece) for name, piece in work.items()}
            under_way: dict = {}
            try:
                yield from self._finished(client, packed, device, under_way)
            finally:
                with suppress(Exception):  # the scheduler may be gone
                    client.cancel(list(under_way), force=True)

    @contextmanager
    def _client(self) -> Iterator:
        try:
            from distributed import Client
        except ImportError:
            raise ImportError("--executor dask needs dask.distributed: pip install 'twinbench[cluster]'") from None
        for name in ("distributed", "distributed.client"):  # what matters of their log is told here
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            client = Client(self.address, timeout=CONNECT, set_as_default=False, name="twinbench")
        except (OSError, ValueError, TimeoutError) as error:
            raise OSError(f"--scheduler {self.address}: no scheduler of dask answers there ({error})") from error
        try:
            threads: Any = client.nthreads()  # of a client that is not asynchronous
            count = len(threads)
            log.info("%d workers at %s", count, self.address)
            if not count:
                log.warning("the scheduler at %s has no workers yet; the work waits for the first", self.address)
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=LEAVE)

    def _finished(self, client, packed: Mapping[object, bytes], device: str, under_way: dict) -> Generator[tuple[object, Future]]:
        """The pieces with their futures, as workers are done; ``under_way`` has the names by futures of dask."""
        from distributed import as_completed

        run, attempts, waiting = uuid.uuid4().hex, Counter(), deque(packed)
        index, ready = {name: k for k, name in enumerate(packed)}, as_completed(loop=client.loop)

        def begin(name) -> None:
            attempts[name] += 1
            future = client.submit(_work, packed[name], device, key=f"twinbench-{run}-{index[name]}-{attempts[name]}", pure=False)
            under_way[future] = name
            ready.add(future)

        for _ in range(min(self.jobs or len(packed), len(packed))):
            begin(waiting.popleft())
        for future in ready:
            name = under_way.pop(future)
            outcome = self._outcome(future)
            future.release()
            if isinstance(outcome, ChildEnded) and attempts[name] < MAX_ATTEMPTS:
                log.warning("%s: its work is done again (%d of %d)", outcome, attempts[name] + 1, MAX_ATTEMPTS)
                begin(name)
                continue
            if waiting:
                begin(waiting.popleft())
            if isinstance(outcome, Exception):
                yield name, failed(OSError(f"{outcome}; the same command goes on from here"))
            else:
                yield name, future_of(outcome)

    def _outcome(self, future) -> bytes | Exception:
        """What ``perform`` returned, or why nothing came of it. Raises OSError where the scheduler is gone."""
        from distributed import CancelledError, KilledWorker

        try:
            return future.result()
        except CancelledError:
            raise OSError(f"the scheduler at {self.address} is gone, or dropped the work; the same command goes on from here") from None
        except KilledWorker as error:
            count = error.allowed_failures + 1
            return OSError(f"{count} workers were lost one after the other with the same work, the last at {error.last_worker.address}")
        except ChildEnded as error:
            return error
        except Exception as error:  # of dask's side: scheduler or worker cannot import this, for example
            said = f"a worker of dask could not begin ({type(error).__name__}: {error})"
            return OSError(f"{said}; scheduler and workers need twinbench and the packages of the command")


def _work(packed: bytes, device: str) -> bytes:
    """What a worker does."""
    from distributed import get_worker

    worker = get_worker()
    key, count = worker.get_current_task(), worker.state.nthreads

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state in WANTED and worker.status.name not in LEAVING

    with claimed(cards(device)) as card:
        return in_child(packed, share(count) | ({VISIBLE: card} if card else {}), wanted)
