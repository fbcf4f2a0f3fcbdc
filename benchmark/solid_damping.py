"""Seconds of a core per simulated second of a damped solid: ``python -m twinbench.benchmark.solid_damping [--cuda]``.

Foam of 20 kPa and 100 kg/m^3 in blocks of several sizes, held at one end, at damping times of 5, 10 and 20 ms; float32, substeps and
rounds of damping as ``physics.stability`` chooses them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

from ..physics.batch import Batch
from ..physics.grids import embed
from ..physics.stability import stable_rounds, stable_substeps
from ..physics.system import System
from ..physics.terms import Gravity, KelvinVoigt, NeoHookean

__all__ = ["BLOCKS", "block", "main", "seconds"]

YOUNG, DENSITY, FPS, FRAMES = 2e4, 100.0, 30, 31
TIMES = (0.005, 0.01, 0.02)  # s
BLOCKS = (  # m, and the edge of a cell
    ((0.2, 0.12, 0.025), 0.025),
    ((0.16, 0.09, 0.05), 0.02),
    ((0.24, 0.06, 0.026), 0.013),
    ((0.2, 0.12, 0.025), 0.0125),
)
SAMPLE = 0.0025  # m, at most, between samples of a block


def block(size, pitch: float, tau: float) -> System:
    """A block of ``size`` (3,) m in cells of ``pitch`` m with damping time ``tau`` s, held where x is least."""
    counts = np.ceil(np.array(size) / SAMPLE).astype(int)
    along = [(np.arange(n) + 0.5) * s / n for n, s in zip(counts, size, strict=True)]
    samples = np.stack(np.meshgrid(*along, indexing="ij"), -1).reshape(-1, 3)
    grid = embed(samples, float(np.prod(size)), pitch, axes=np.eye(3))
    held = np.flatnonzero(grid.positions[:, 0] < grid.positions[:, 0].min() + 1e-6)
    return System(
        positions=grid.positions,
        masses=grid.masses(DENSITY),
        springs=np.zeros((0, 2), int),
        stiffness=np.zeros(0),
        controllers=np.repeat(grid.positions[held][None], FRAMES, 0),
        grips=held,
        grid=grid,
        terms=[NeoHookean({"youngs_modulus": YOUNG}), KelvinVoigt({"viscosity": tau * YOUNG}), Gravity()],
    )


def seconds(system: System, device: str = "cpu", repeats: int = 3) -> tuple[float, int, int]:
    """(seconds per simulated second, substeps a frame, rounds in each): of processor time on a CPU, of wall time elsewhere."""
    substeps = stable_substeps([system], 1 / FPS)
    rounds = stable_rounds(system, 1 / FPS / substeps)
    batch = Batch([system], fps=FPS, substeps=substeps, rounds=rounds, device=device, workers=1)
    clock = time.process_time if device == "cpu" else time.perf_counter
    batch.rollout(2)
    found = []
    for _ in range(repeats):
        began = clock()
        path = batch.rollout(FRAMES).positions[0].cpu()
        found.append((clock() - began) * FPS / (FRAMES - 1))
        if not bool(path.isfinite().all()):
            raise FloatingPointError(f"the block blew up with {substeps} substeps of {rounds} rounds")
    return min(found), substeps, rounds


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.solid_damping", description=str(__doc__).split("\n")[0])
    parser.add_argument("--cuda", action="store_true", help="on the GPU")
    parser.add_argument("--repeats", type=int, default=3, help="timings of each, of which the least counts")
    given = parser.parse_args(arguments)
    print("| body [mm] | cell [mm] | cells | " + " | ".join(f"tau = {1e3 * tau:g} ms" for tau in TIMES) + " |")
    print("|---|---:|---:|" + "---|" * len(TIMES))
    for size, pitch in BLOCKS:
        cells, count = [], 0
        for tau in TIMES:
            system = block(size, pitch, tau)
            taken, substeps, rounds = seconds(system, "cuda" if given.cuda else "cpu", given.repeats)
            cells.append(f"{taken:.2g} ({substeps} x {rounds})")
            assert system.grid is not None  # of a solid
            count = len(system.grid.cells)
        print(f"| {' x '.join(f'{1e3 * s:g}' for s in size)} | {1e3 * pitch:g} | {count} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
