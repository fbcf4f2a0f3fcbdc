"""How far a twin in its usual steps is from itself in eight times as many: ``python -m twinbench.benchmark.step_errors RECORDING ...``.

No twin is fitted: its body moves by the usual numbers of its kind, under the recorded hands. Distances are between nodes at the same time,
over all nodes of the body and all frames; the *lag* is the shift in time [frames] that explains most of them, *left* what it does not.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
import torch

from ..methods.continuum.config import Config
from ..methods.continuum.joint import scenes_of
from ..methods.continuum.simulate import Simulator
from .opening import open_scenario

__all__ = ["errors", "main"]

FINEST = 8  # times as many steps


def errors(recording: str) -> list[dict]:
    """Of a twin in its usual steps and in twice as many: kind of body, steps a frame, rounds, s of processor time, RMS [m], largest [m],
    lag [frames] and what is left [m] of distances to its nodes in ``FINEST`` times as many."""
    used, scenes, body = scenes_of([open_scenario(recording).observed()], Config(), seed=0)
    simulator, frames = Simulator(scenes[0]), used[0].observed_frames
    (steps, rounds), values = simulator.steps({}), simulator.under({})[1]

    def path(times):
        batch, inputs = simulator.ready([values], frames, times=times)
        began = time.process_time()
        with torch.no_grad():
            found = torch.cat([inputs.x[None], batch.march(0, frames - 1, inputs)[0]])
        return batch.split(found)[0].double().numpy(), time.process_time() - began

    fine, rows = path(FINEST)[0], []
    speed = np.gradient(fine, axis=0)
    for times in (1, 2):
        found, seconds = path(times)
        off = found - fine
        lag = float((off * speed).sum() / (speed**2).sum())
        rms, left = (float(np.sqrt((d**2).sum(-1).mean())) for d in (off, off - lag * speed))
        largest = float(np.linalg.norm(off, axis=-1).max())
        rows.append(dict(kind=body.kind, steps=times * steps, rounds=rounds, seconds=seconds, rms=rms, largest=largest, lag=lag, left=left))
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.step_errors", description=str(__doc__).split("\n")[0])
    parser.add_argument("recordings", nargs="+", metavar="RECORDING")
    given = parser.parse_args(arguments)
    print("| recording | body | steps a frame x rounds | core [s] | RMS [mm] | largest [mm] | lag [frames] | left [mm] |")
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    for recording in given.recordings:
        for e in errors(recording):
            sizes = f"{1e3 * e['rms']:.3f} | {1e3 * e['largest']:.2f} | {e['lag']:.4f} | {1e3 * e['left']:.3f}"
            print(f"| {recording} | {e['kind']} | {e['steps']} x {e['rounds']} | {e['seconds']:.2f} | {sizes} |", flush=True)


if __name__ == "__main__":
    main()
