"""Which executor the options of a command ask for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..options import known
from .base import Executor

__all__ = ["EXECUTORS", "chosen_executor"]

EXECUTORS = ("local", "slurm", "dask")


def chosen_executor(
    name: str, *, jobs: int | None = None, scheduler: str = "", slurm: Sequence[str] = (), folder: Path | None = None
) -> Executor:
    """The executor of that name.

    jobs       pieces at the same time; default: one here, on clusters as many as these allow
    scheduler  address of dask's scheduler
    slurm      options of Slurm, KEY=VALUE each
    folder     where jobs of Slurm keep their files, which all nodes must see

    Raises ValueError for an unknown name, or an option that this executor has no use for.
    """
    known("executor", [name], EXECUTORS)
    if jobs is not None and jobs < 1:
        raise ValueError(f"--jobs must be at least 1, got {jobs}")
    if slurm and name != "slurm":
        raise ValueError(f"--slurm is for --executor slurm, got --executor {name}")
    if bool(scheduler) != (name == "dask"):
        wanted = "needs --scheduler ADDRESS, as tcp://127.0.0.1:8786" if name == "dask" else "has no use for --scheduler"
        raise ValueError(f"--executor {name} {wanted}")
    if name == "slurm":
        from .slurm import Slurm

        return Slurm(slurm, jobs=jobs, folder=folder)
    if name == "dask":
        from .dask_workers import DaskWorkers

        return DaskWorkers(scheduler, jobs=jobs)
    from .local import LocalProcesses

    return LocalProcesses(jobs or 1)
