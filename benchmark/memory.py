"""How much memory the first-order stage of PhysTwin takes on a CPU, beside what it has to keep at once.

python -m twinbench.benchmark.memory                                20,000 particles, 70 frames, the corrected mode and the published one
python -m twinbench.benchmark.memory --particles 4000 --frames 12   a smaller body, in less than a minute

The recording is a made block, all of whose particles are tracked, carried along by two hands. One epoch is run: each takes the same.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .performance import block
from .provenance import peak_memory, reset_peak_memory

__all__ = ["Taken", "carried_block", "main", "measure", "table"]

METHODS = {"corrected": "phystwin-first", "as published": "phystwin-as-published"}
PACE = 0.002  # m that the block and its hands move in a frame


def carried_block(particles: int, frames: int, *, colliding: bool = False):
    """What a method sees of a block above a table that two hands carry along, every particle of it tracked in every frame."""
    from ..datasets.scenario import Observed, Plane

    made = block(particles, 1)
    points = made.positions - [0, 0, 0.05]  # z points down: 6 cm of air below it
    moved = PACE * np.arange(frames)[:, None, None]
    seen = np.ones((frames, particles), bool)
    return Observed(
        name=f"block of {particles}",
        points=points + moved,
        visible=seen,
        motion_valid=seen,
        controllers=points[[0, -1]] - [0, 0, 0.004] + moved,
        ground=Plane(np.array([0.0, 0.0, -1.0])),
        self_collision=colliding,
    )


@dataclass(frozen=True)
class Taken:
    """Memory [MiB] of one fit: ``before`` it (Python, libraries, the recording), at its ``peak``, and what it has to ``keep`` at once."""

    particles: int
    springs: int
    frames: int
    mode: str
    seconds: float
    before: float
    peak: float
    keep: float


def measure(particles: int, frames: int, mode: str = "corrected", *, colliding: bool = False) -> Taken:
    """One epoch of the first-order stage, from the published defaults, of ``mode`` (see ``METHODS``)."""
    fit(carried_block(64, 3, colliding=colliding), mode)  # libraries start, kernels are compiled
    recording = carried_block(particles, frames, colliding=colliding)
    reset_peak_memory()
    before, began = peak_memory()["peak_memory_mib"], time.perf_counter()
    twin = fit(recording, mode)
    seconds, peak = time.perf_counter() - began, peak_memory()["peak_memory_mib"]
    springs = len(twin.body.springs) + len(twin.body.pulls)
    return Taken(particles, springs, frames, mode, seconds, before, peak, keep(twin, frames) / 2**20)


def fit(recording, mode: str):
    from ..methods.registry import get_method

    method: Any = get_method(METHODS[mode])
    method.stages = ("first",)
    config = replace(method.config("quick", recording), epochs=1)
    return method.fitted([recording], config, seed=0, device="cpu")


def keep(twin, frames: int) -> int:
    """Bytes that gradients need at once: the history of the longest stretch, the state at every stretch's start, positions at the frames
    and their gradient, and of each spring its two ends, rest length, stiffness, gradient and Adam's two moments."""
    from ..methods.phystwin.body import system, time_step
    from ..physics.batch import Batch

    one = system(twin.body, twin.place, twin.config)
    substeps, dt = time_step([one], twin.place.fps, twin.config)
    batch = Batch([one], fps=twin.place.fps, substeps=substeps, dt=dt)
    window = 1 if twin.config.quirks.frame_gradients else min(twin.config.window, frames - 1)
    stretches = batch.stretches(window, history=True)
    number = batch.dtype.itemsize
    history = max(s.history for s in stretches) * batch.substep_bytes
    return history + number * (batch.node_count * (6 * len(stretches) + 2 * 3 * window) + 7 * len(one.springs))


def table(rows: list[Taken]) -> str:
    """``rows`` in Markdown."""
    text = ["| particles | springs | frames | mode | seconds an epoch | before [MiB] | must be kept [MiB] | peak [MiB] |"]
    text.append("|---:|---:|---:|---|---:|---:|---:|---:|")
    for t in rows:
        sizes = f"{t.particles:,} | {t.springs:,} | {t.frames} | {t.mode}"
        text.append(f"| {sizes} | {t.seconds:.0f} | {t.before:,.0f} | {t.keep:,.0f} | {t.peak:,.0f} |")
    return "\n".join(text)


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, default=20000)
    parser.add_argument("--frames", type=int, default=70, help="observed frames (3 or more)")
    parser.add_argument("--modes", nargs="+", default=list(METHODS), choices=METHODS)
    parser.add_argument("--self-collision", action="store_true")
    options = parser.parse_args(arguments)
    if options.frames < 3 or options.particles < 8:
        parser.error(f"--frames must be >= 3 and --particles >= 8, got {options.frames} and {options.particles}")
    print(table([measure(options.particles, options.frames, mode, colliding=options.self_collision) for mode in options.modes]))


if __name__ == "__main__":
    main()
