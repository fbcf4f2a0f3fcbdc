"""Where a row came from: commit, versions, device, peak memory."""

from __future__ import annotations

import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from contextvars import ContextVar
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path

from ..metrics.base import Metric

__all__ = ["command_line", "device_name", "origin", "peak_memory", "provenance", "reset_peak_memory"]

PACKAGES = {"numpy": "numpy", "torch": "torch", "warp": "warp-lang", "twinbench": "twinbench"}
command_line: ContextVar[tuple[str, ...]] = ContextVar("command_line", default=())  # what twinbench was called with, if it was


@cache
def commit() -> str:
    """The git commit of the source tree, with "+" if it has changes that are not in it; "unknown" outside a clone."""
    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return "unknown"
    try:
        run = {"cwd": root, "capture_output": True, "text": True, "check": True, "timeout": 10}
        head = subprocess.run(["git", "rev-parse", "HEAD"], **run).stdout.strip()
        changed = subprocess.run(["git", "status", "--porcelain", "--untracked-files=no"], **run).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return head + ("+" if changed else "")


def installed(package: str) -> str:
    """Version of an installed package, without importing it; "" where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


@cache
def device_name(device: str) -> str:
    """Name of the processor or graphics card behind ``device`` ("cpu" or "cuda"). Raises ValueError where there is none."""
    if device == "cpu":
        return f"cpu: {_processor()}"
    import torch

    if not torch.cuda.is_available():
        raise ValueError(f"device {device!r} is not there: torch {torch.__version__} finds no CUDA device; use --device cpu")
    return f"cuda: {torch.cuda.get_device_name()}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def provenance(device: str) -> dict[str, str]:
    """The columns that say how and when a row was computed."""
    return {
        "device": device_name(device),
        "commit": commit(),
        "python": platform.python_version(),
        **{column: installed(package) for column, package in PACKAGES.items()},
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def origin(began: datetime, used: Iterable, options: Mapping) -> dict:
    """How and when results came about, as ``about.json`` has it: nothing in it but the command line depends on whose machine it was.

    ``used`` are the methods and metrics; the distributions that they come from are named with their versions, and metrics with theirs:
    another one gives other numbers.
    """
    head, used = commit(), list(used)
    return {
        "command": shlex.join(("twinbench", *command_line.get())) if command_line.get() else "",
        "options": dict(options),
        "started": began.isoformat(timespec="seconds"),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": head.rstrip("+"),
        "dirty": head.endswith("+"),
        "python": platform.python_version(),
        "packages": {package: installed(package) for package in PACKAGES.values()},
        "plugins": _plugins(used),
        "metric_versions": {one.name: one.version for one in used if isinstance(one, Metric)},
    }


def _plugins(used: Iterable) -> dict[str, str]:
    """Versions of the distributions, beside twinbench, that methods and metrics come from."""
    modules = [name for one in used for name in getattr(one, "modules", None) or (getattr(one, "__module__", None),)]
    outside = {name.split(".")[0] for name in modules if name} - {"twinbench", "__main__", "builtins"}
    if not outside:
        return {}
    known = packages_distributions()
    return {name: installed(name) for module in sorted(outside) for name in known.get(module, ())}


def reset_peak_memory() -> None:
    """Start a new count of peak memory where the system allows it (Linux); elsewhere the process's peak goes on."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")
    if (torch := _torch()) is not None:
        torch.cuda.reset_peak_memory_stats()


def peak_memory() -> dict[str, float]:
    """Peak memory [MiB] of this process since the last reset, and of the graphics card: torch since the reset, Warp since the start."""
    card = 0.0
    if (torch := _torch()) is not None:
        card += torch.cuda.max_memory_allocated()
    if (warp := sys.modules.get("warp")) is not None:
        with suppress(RuntimeError, AttributeError):  # Warp without CUDA, or imported and not yet started
            card += sum(warp.get_mempool_used_mem_high(device) for device in warp.get_cuda_devices())
    return {"peak_memory_mib": _resident(), "peak_device_memory_mib": card / 2**20}


def _resident() -> float:
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
        return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024
    except (OSError, StopIteration):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 1024)


def _torch():
    """torch, where somebody has imported it and used its CUDA side."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and torch.cuda.is_available() and torch.cuda.is_initialized() else None
