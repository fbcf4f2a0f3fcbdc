"""Jobs of Slurm, through submitit: a job for each piece, in arrays. Each reads its work from a file and leaves a file with the result.

The jobs of a command that was killed are cancelled by the next one: the folder of a command is locked as long as the command lives.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import ClassVar

from ...datasets.temporary import lasting
from ...physics.cores import cores
from ..cache import default_cache
from .base import MAX_ATTEMPTS, Executor, failed
from .piece import future_of, pack, place
from .slurm_jobs import Jobs, Lost, cancel_orphans
from .slurm_options import SlurmOptions

__all__ = ["Slurm"]

POLL = (0.05, 2.0)  # s between two looks at the files of jobs: after one has ended, and at most
GROWTH = 1.3  # of that pause, from look to look
log = logging.getLogger("twinbench")


class Slurm(Executor):
    """A job for each piece, with what ``options`` (``KEY=VALUE`` each, see ``SlurmOptions``) ask for; of an array, ``jobs`` at a time.

    ``folder`` is where jobs keep their files: on a file system that all nodes see; by default ``jobs`` in the cache.
    """

    name: ClassVar[str] = "slurm"

    def __init__(self, options: Sequence[str] = (), *, jobs: int | None = None, folder: str | Path | None = None):
        self._given, self.asked, self.jobs = tuple(options), SlurmOptions.of(options), jobs
        self.folder = (Path(folder) if folder else default_cache() / "jobs").resolve()

    @property
    def options(self):
        return {"executor": self.name, "slurm": list(self._given), "jobs": self.jobs}

    def each(self, work, *, device="cpu", reads=(), writes=()):
        if not work:
            return
        if killed := cancel_orphans(self.folder):
            log.warning("jobs of %d commands that were killed are cancelled", killed)
        with place(reads, writes) as where, lasting(self.folder, self.folder / self.name) as folder:
            packed = {name: pack(where, piece) for name, piece in work.items()}
            jobs = Jobs(self._submitit(folder, device), folder)
            try:
                yield from self._finished(jobs, packed)
            finally:
                jobs.cancel()

    def _submitit(self, folder: Path, device: str):
        try:
            import submitit
        except ImportError:
            raise ImportError("--executor slurm needs submitit: pip install 'twinbench[cluster]'") from None
        logging.getLogger("submitit").setLevel(logging.ERROR)
        try:
            executor = submitit.AutoExecutor(folder=folder, cluster=self.asked.cluster)
        except RuntimeError as error:  # there is no srun
            raise ValueError("--executor slurm: no Slurm here (srun is missing); --slurm cluster=local does without it") from error
        executor.update_parameters(**self.asked.submitit(device=device, jobs=self.jobs))
        return executor

    def _finished(self, jobs: Jobs, packed: Mapping[object, bytes]) -> Generator[tuple[object, Future]]:
        """The pieces with their futures, as their jobs end."""
        limit = len(packed) if self.asked.cluster == "slurm" else self.jobs or cores()  # an array limits itself
        waiting, attempts, pause = list(packed), Counter(), POLL[0]
        while waiting or len(jobs):
            batch = waiting[: min(limit - len(jobs), self.asked.array)]
            if batch:
                waiting = waiting[len(batch) :]
                attempts.update(batch)
                jobs.submit({name: packed[name] for name in batch})
                log.info("%d jobs are submitted, %d wait", len(batch), len(waiting))
            ended = jobs.ended()
            for name, outcome in ended:
                if not isinstance(outcome, Lost):
                    yield name, future_of(outcome)
                elif attempts[name] < MAX_ATTEMPTS and not outcome.hopeless:
                    log.warning("%s: its work is done again (%d of %d)", outcome.said, attempts[name] + 1, MAX_ATTEMPTS)
                    waiting.append(name)
                else:
                    yield name, failed(OSError(f"{outcome.said}; the same command goes on from here"))
            pause = POLL[0] if ended else min(GROWTH * pause, POLL[1])
            if not ended:
                time.sleep(pause)
