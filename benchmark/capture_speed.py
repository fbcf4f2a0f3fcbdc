"""``python -m twinbench.benchmark.capture_speed OUT``: time and memory of ``twinbench build`` on a recording of full length and size.

The plush's lift at 848 x 480, three cameras. ``FILMED`` frames are filmed and shown to and fro until there are ``FRAMES``: work and memory
are those of a recording of that length. The row is added to OUT/speed.jsonl.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from .capture_quality import SEED

__all__ = ["main", "speed_row", "to_and_fro"]

FILMED, FRAMES, FPS = 12, 100, 30.0
_BUILD = "import sys; from twinbench.benchmark.cli import main; sys.exit(main(sys.argv[1:]))"


def to_and_fro(recording, frames: int):
    """``recording``, its frames shown forwards and backwards until there are so many, at its own rate."""
    from ..datasets.capture.pictures import Held

    cameras = []
    for raw in recording.cameras:
        count = raw.frame_count
        order = np.concatenate([np.arange(count), np.arange(count - 2, 0, -1)])
        order = np.resize(order, frames)
        held = Held([raw.frames.color(t) for t in order], [raw.frames.depth(t) for t in order], raw.frames.background())
        times = np.arange(frames) / FPS
        arrivals = None if raw.arrivals is None else raw.arrivals[0] + times
        cameras.append(replace(raw, frames=held, stamps=raw.stamps[0] + times, arrivals=arrivals))
    return replace(recording, cameras=tuple(cameras))


def speed_row(seed: int = SEED, filmed: int = FILMED, frames: int = FRAMES, width: int = 848) -> dict:
    """Wall and processor time [s], both of all cores, and peak of memory [GB] of one ``twinbench build`` in a process of its own."""
    from ..datasets.capture.layout import write_layout
    from ..datasets.synthetic.studio import film_studio

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_layout(folder / "raw", to_and_fro(film_studio("plush", "lift", seed=seed, frames=filmed, width=width).recording, frames))
        started = time.monotonic()
        with (folder / "said").open("w") as said:
            command = [sys.executable, "-c", _BUILD, "build", str(folder / "raw"), "--out", str(folder / "case")]
            process = subprocess.Popen(command, stdout=said, stderr=said)
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise RuntimeError(f"twinbench build ended with {process.returncode}: {(folder / 'said').read_text()[-2000:]}")
        seconds = {"build_s": round(time.monotonic() - started, 1), "build_cpu_s": round(used.ru_utime + used.ru_stime, 1)}
    named = {"key": f"plush-lift-{width}-{frames}", "seed": seed, "cores": len(os.sched_getaffinity(0))}
    return named | seconds | {"peak_gb": round(used.ru_maxrss / 2**20, 2)}


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.capture_speed", description=__doc__)
    parser.add_argument("out", type=Path)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    row = speed_row()
    with (options.out / "speed.jsonl").open("a") as stream:
        stream.write(json.dumps(row) + "\n")
    print(row)


if __name__ == "__main__":
    main()
