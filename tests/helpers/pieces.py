"""Pieces of work that say where they run."""

import os
import time
from pathlib import Path


def waits(folder, name, *, seconds=0.0, until=""):
    """Leave a file NAME-PID-PARENT in ``folder``, then take ``seconds``, or as long as the file ``until`` is not there."""
    (Path(folder) / f"{name}-{os.getpid()}-{os.getppid()}").touch()
    time.sleep(seconds)
    while until and not os.path.exists(until):
        time.sleep(0.02)
    return name


def begun(folder):
    """(name, process, its parent) of each piece that was begun."""
    return [(name, int(process), int(parent)) for name, process, parent in (file.name.split("-") for file in Path(folder).iterdir())]


def fails():
    raise ValueError("stiffness must be > 0 [N], got -3.0")


def dies_once(folder):
    """The first time, the process is killed."""
    file = Path(folder) / "died"
    if not file.exists():
        file.touch()
        os.kill(os.getpid(), 9)
    return "done"


def environment(*names):
    return [os.environ.get(name) for name in names]


def place():
    return os.getcwd()
