"""Who does the pieces of a command: processes of this machine, jobs of Slurm, or workers of dask. A file each, one interface."""

from .base import Executor
from .choice import EXECUTORS, chosen_executor

__all__ = ["EXECUTORS", "Executor", "chosen_executor"]
