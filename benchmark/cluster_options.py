"""Options of commands that take long: who does the work, from which file the options come, and what is logged."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

if TYPE_CHECKING:
    from .executors import Executor

__all__ = ["OnCluster", "Reproducible"]


@dataclass(frozen=True, kw_only=True)
class Reproducible:
    """A command whose options may come from a file."""

    config: Annotated[Path | None, arg(metavar="FILE")] = None
    """Take options from FILE (TOML, or YAML), as every run leaves one in its folder. Options on the command line count more."""
    log_level: str = "warning"
    """What is said on standard error beside the progress: debug, info (which workers do what), warning or error."""


@dataclass(frozen=True, kw_only=True)
class OnCluster(Reproducible):
    """A command whose work may be done on other machines."""

    executor: str = "local"
    """Who does the work: local (processes of this machine), slurm (jobs), or dask (workers); see docs/clusters.md."""
    scheduler: str = ""
    """Address of the scheduler of --executor dask, as tcp://127.0.0.1:8786."""
    slurm: Annotated[tuple[str, ...], arg(metavar="KEY=VALUE ...")] = ()
    """What a job of --executor slurm asks for: partition, account, qos, constraint, time, memory, cpus, gpus, array, setup, cluster."""

    def on_cluster(self) -> Executor | None:
        """Who does the work, where that is not this machine. Raises ValueError as ``chosen_executor`` does."""
        from .executors import chosen_executor

        found = chosen_executor(self.executor, jobs=getattr(self, "jobs", None), scheduler=self.scheduler, slurm=self.slurm)
        return found if found.remote else None
