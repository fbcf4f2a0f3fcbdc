"""What ``--slurm KEY=VALUE`` may say of a job."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields

from ..options import known

__all__ = ["SlurmOptions"]

CLUSTERS = ("slurm", "local", "debug")
GIB = {"M": 1 / 1024, "G": 1.0, "T": 1024.0}  # of Slurm's units


@dataclass(frozen=True)
class SlurmOptions:
    """One job's share of the cluster. What is "" or 0 is left to the cluster's own default.

    partition, account, qos, constraint   as sbatch has them
    time      how long a piece may take [min]
    memory    of a piece [GiB]
    cpus      cores of a piece
    gpus      graphics cards of a piece; where the device is "cuda", one
    array     jobs in one array at most; clusters allow up to their MaxArraySize, which is 1001 unless somebody changed it
    setup     a shell command before each job, as "module load cuda"
    cluster   "slurm"; "local": processes of this machine; "debug": this process, which tries a command out without a cluster
    """

    partition: str = ""
    account: str = ""
    qos: str = ""
    constraint: str = ""
    time: int = 24 * 60
    memory: float = 0.0
    cpus: int = 1
    gpus: int = 0
    array: int = 1000
    setup: str = ""
    cluster: str = "slurm"

    @classmethod
    def of(cls, given: Iterable[str]) -> SlurmOptions:
        """From ``KEY=VALUE`` each. Raises ValueError for an unknown key or a wrong value, and for one that is given twice."""
        names, found = [field.name for field in fields(cls)], {}
        for one in given:
            name, equals, value = one.partition("=")
            if not equals or not value.strip():
                raise ValueError(f"--slurm must be KEY=VALUE, got {one!r}")
            known("key of --slurm", [name], names)
            if name in found:
                raise ValueError(f"--slurm {name} is given twice")
            found[name] = _READ.get(name, _text)(name, value.strip())
        return cls(**found)

    def submitit(self, *, device: str, jobs: int | None) -> dict:
        """The same for ``submitit.AutoExecutor.update_parameters``; at most ``jobs`` of an array run at the same time."""
        gpus = self.gpus or (1 if device == "cuda" else 0)
        threads = "export OMP_NUM_THREADS=${OMP_NUM_THREADS:-${SLURM_CPUS_PER_TASK:-1}}"  # before Python: it is read when numpy is loaded
        found = {
            "name": "twinbench",
            "timeout_min": self.time,
            "cpus_per_task": self.cpus,
            "slurm_setup": [threads, *filter(None, [self.setup])],
            **{f"slurm_{name}": value for name in ("partition", "account", "qos", "constraint") if (value := getattr(self, name))},
        }
        found |= {"mem_gb": self.memory} if self.memory else {}
        found |= {"gpus_per_node": gpus} if gpus else {}
        return found | ({"slurm_array_parallelism": jobs} if jobs else {})


def _text(name: str, value: str) -> str:
    if "\n" in value:
        raise ValueError(f"--slurm {name} must be one line, got {value!r}")
    return value


def _count(name: str, value: str, least: int = 1) -> int:
    if not value.isdecimal() or int(value) < least:
        raise ValueError(f"--slurm {name} must be a whole number of at least {least}, got {value!r}")
    return int(value)


def _minutes(name: str, value: str) -> int:
    """Of minutes, minutes:seconds, hours:minutes:seconds, days-hours, days-hours:minutes or days-hours:minutes:seconds, rounded up."""
    if not re.fullmatch(r"\d+(:\d\d){0,2}|\d+-\d\d?(:\d\d){0,2}", value):
        raise ValueError(f"--slurm time must be minutes or [DAYS-]HOURS:MINUTES:SECONDS, got {value!r}")
    days, dash, rest = value.rpartition("-")
    parts = [int(part) for part in rest.split(":")]
    if dash:
        hours, minutes, seconds = (*parts, 0, 0)[:3]
    else:
        hours, minutes, seconds = {1: (0, *parts, 0), 2: (0, *parts), 3: tuple(parts)}[len(parts)]
    found = 1440 * int(days or 0) + 60 * hours + minutes + (seconds > 0)
    if found < 1:
        raise ValueError(f"--slurm time must be at least a minute, got {value!r}")
    return found


def _gib(name: str, value: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d+)?)([MGT])(?:i?B)?", value)
    if not found or not float(found[1]):
        raise ValueError(f"--slurm memory must be a size as 16G or 4000M, got {value!r}")
    return float(found[1]) * GIB[found[2]]


def _cluster(name: str, value: str) -> str:
    known("cluster of --slurm", [value], CLUSTERS)
    return value


_READ: dict[str, Callable] = {
    "time": _minutes,
    "memory": _gib,
    "cpus": _count,
    "gpus": _count,
    "array": _count,
    "cluster": _cluster,
}
