"""The jobs that one command has on a cluster: submitted, looked at and cancelled through submitit."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ...datasets.temporary import idle, replacing
from .piece import perform

__all__ = ["Jobs", "Lost", "cancel_orphans"]

IDS = "jobs.json"  # in the folder of a command: which jobs it has
ASK = 60.0  # s between two questions to Slurm of how its jobs are, beside what their files say
LATE = 15.0  # s after the end of a job until its file must be seen on this machine
HOPELESS = ("TIMEOUT", "OUT_OF_ME", "DEADLINE")  # ends of jobs that would end so again
TAIL = 300  # characters of a lost job's log that are told


@dataclass(frozen=True)
class Lost:
    """How a job ended that left no result, in words; ``hopeless`` where another one would end the same way."""

    said: str
    hopeless: bool = False


class Jobs:
    """The jobs of one command, by the names of their pieces. ``executor`` is submitit's, ``folder`` the command's own."""

    def __init__(self, executor, folder: Path):
        self._executor, self._folder = executor, folder
        self._running: dict = {}
        self._gone: dict[object, float] = {}  # since when they are seen to have ended, where no file says so
        self._ids: set[str] = set()
        self._asked = time.monotonic()

    def __len__(self) -> int:
        return len(self._running)

    def submit(self, packed: Mapping[object, bytes]) -> None:
        """A job for each piece, in one array. Raises OSError where the cluster refuses."""
        try:
            jobs = self._executor.submit_array([partial(_work, piece) for piece in packed.values()])
        except Exception as error:  # submitit raises errors of its own and of the programs that it calls
            lines = str(error).strip().splitlines() or [type(error).__name__]
            raise OSError(f"the cluster refuses the jobs: {lines[-1]}") from error
        self._running |= dict(zip(packed, jobs, strict=True))
        self._ids |= {job.job_id.partition("_")[0] for job in jobs}
        if self._slurm:
            with replacing(self._folder / IDS) as temporary:
                temporary.write_text(json.dumps(sorted(self._ids)), encoding="utf-8")

    def ended(self) -> list[tuple[object, bytes | Lost]]:
        """The pieces whose jobs have ended since the last call: what ``perform`` returned, or how the job was lost."""
        if self._slurm and self._running and time.monotonic() - self._asked > ASK:
            self._asked = time.monotonic()
            if (queued := _queued(self._ids)) is not None:
                gone = [name for name, job in self._running.items() if job.job_id not in queued]
                self._gone = {name: self._gone.get(name, self._asked) for name in gone}
        found = [(name, outcome) for name, job in self._running.items() if (outcome := self._outcome(name, job)) is not None]
        for name, _ in found:
            self._running.pop(name)
            self._gone.pop(name, None)
        return found

    def cancel(self) -> None:
        """Cancel what has not ended, without waiting for it: this process may have less than a second left."""
        if self._running and self._slurm:
            _scancel(sorted(self._ids))
        elif self._running:
            for job in self._running.values():
                job.cancel()
        self._running.clear()

    @property
    def _slurm(self) -> bool:
        return self._executor.cluster == "slurm"

    def _outcome(self, name, job) -> bytes | Lost | None:
        if self._executor.cluster == "debug":
            job.wait()
        elif not job.paths.result_pickle.exists():
            now = time.monotonic()
            if now - self._gone.get(name, now) <= LATE if self._slurm else not job.done():
                return None
            state = _state(job.job_id) if self._slurm else job.state
            return Lost(f"job {job.job_id} ended without a result ({state}){_told(job)}", state.upper().startswith(HOPELESS))
        try:
            return job.result()
        except Exception as error:  # of submitit's side of the job: it could not begin
            lines = [line for line in str(error).splitlines() if line.strip(" -") and not line.startswith(("You can check", "  - "))]
            return Lost(f"job {job.job_id} could not begin: {lines[-1] if lines else error}", hopeless=True)


def cancel_orphans(folder: Path) -> int:
    """Cancel the jobs of commands that kept their files in ``folder`` and were killed; how many commands these were."""
    killed = 0
    for file in sorted(folder.glob(f".*/{IDS}")):
        with suppress(OSError, ValueError), idle(file.parent) as unused:
            if unused and (ids := [one for one in json.loads(file.read_text(encoding="utf-8")) if str(one).isdecimal()]):
                _scancel(ids)
                file.unlink()
                killed += 1
    return killed


def _queued(ids: set[str]) -> set[str] | None:
    """Which of these jobs wait or run, each job of an array for itself; None where Slurm does not say."""
    asked = ["squeue", "--noheader", "--array", "--format=%i", f"--jobs={','.join(sorted(ids))}"]
    try:
        told = subprocess.run(asked, capture_output=True, text=True, timeout=ASK, check=False)
    except (OSError, subprocess.SubprocessError):
        return None
    if told.returncode == 0:
        return set(told.stdout.split())
    return set() if "Invalid job id" in told.stderr else None  # what it says of one that has ended some time ago


def _state(job: str) -> str:
    """How a job ended, in a word of Slurm's. It is asked of the controller, which knows for minutes: not every cluster has accounting."""
    with suppress(OSError, subprocess.SubprocessError):
        told = subprocess.run(["scontrol", "show", "job", job], capture_output=True, text=True, timeout=ASK, check=False)
        if found := re.search(r"\bJobState=(\w+)", told.stdout):
            return found[1]
    return "unknown"


def _scancel(ids: list[str]) -> None:
    """In a session of its own, which outlives this process."""
    null = subprocess.DEVNULL
    with suppress(OSError):
        subprocess.Popen(["scancel", *ids], start_new_session=True, stdin=null, stdout=null, stderr=null)


def _told(job) -> str:
    """The end of what a job said on standard error."""
    with suppress(OSError):
        if said := " ".join(job.paths.stderr.read_text(encoding="utf-8", errors="replace").split()):
            return f", saying {said[-TAIL:]!r}"
    return ""


def _work(packed: bytes) -> bytes:
    """What a job does. It ends when it is told to: submitit would have it go on, to save what it has."""
    with suppress(ValueError):  # in a thread, where signals are nobody's business
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGUSR2, signal.SIG_IGN)  # "there is little time left", which Slurm sees to
    return perform(packed)
