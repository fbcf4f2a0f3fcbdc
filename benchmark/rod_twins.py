"""How right twins are about marked cables: ``python -m twinbench.benchmark.rod_twins PATH/DLO1 ... --seeds 0 --jobs 2 --out FILE``.

One twin of ``continuum`` is fitted on the training recordings and placed in every evaluation recording: as fast as its first two frames
say (as DEFORM's evaluation does, which is given these), and at rest, told the first alone. Errors are mean absolute ones per coordinate
over the whole recording, of all markers, driven ones included, and of the free ones. ``--split clean`` leaves training recordings out that
are of one take with an evaluation recording.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..datasets.collection import open_collection
from ..methods.base import Diverged
from ..methods.continuum import Continuum
from .studies import study

__all__ = ["coordinate_errors", "main", "rows_of"]


def coordinate_errors(twin, scenario) -> tuple[float, float]:
    """(all markers, free markers) mm; infinite where the roll-out diverged."""
    try:
        path = twin.rollout(scenario.controllers).tracked
    except Diverged:
        return np.inf, np.inf
    off = np.where(scenario.visible[..., None], np.abs(path - scenario.points), np.nan)
    free = ~np.isin(np.arange(off.shape[1]), scenario.grips)
    return 1e3 * float(np.nanmean(off)), 1e3 * float(np.nanmean(off[:, free]))


def rows_of(path: Path, *, split: str, preset: str, seed: int) -> list[dict]:
    """A row for each evaluation recording of the cable at ``path``."""
    collection = open_collection(path, split=split)
    begun = time.time(), time.process_time()
    sources = [collection.load(name).observed() for name in collection.pairs[0].sources]
    twin = Continuum().fitted(sources, replace(Continuum.presets[preset], start="frames"), seed=seed)
    spent = dict(fit_seconds=round(time.time() - begun[0]), fit_cpu=round(time.process_time() - begun[1]))
    rows = []
    for pair in collection.pairs:
        scenario = collection.load(pair.target)
        moving, still = twin.retarget(scenario.initial()), twin.retarget(scenario.observed(1))
        errors = (*coordinate_errors(moving, scenario), *coordinate_errors(still, scenario))
        named = dict(zip(("all_mm", "free_mm", "still_all_mm", "still_free_mm"), (round(e, 3) for e in errors), strict=True))
        rows.append(
            dict(cable=path.resolve().name, seed=seed, recording=pair.target) | named | spent | dict(values=json.dumps(twin.values))
        )
    return rows


def summary(rows) -> str:
    """A line for each cable and seed: mean and median of each column."""
    lines = []
    for cable, seed in dict.fromkeys((row["cable"], row["seed"]) for row in rows):
        own = [row for row in rows if (row["cable"], row["seed"]) == (cable, seed)]
        said = [
            f"{n} {np.mean([r[n] for r in own]):.2f} (median {np.median([r[n] for r in own]):.2f})" for n in own[0] if n.endswith("_mm")
        ]
        lines.append(f"{cable} seed {seed}: {', '.join(said)}; fitted in {own[0]['fit_cpu']} s of a core")
    return "\n".join(lines)


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n")[0])
    parser.add_argument("cables", nargs="+", type=Path)
    parser.add_argument("--preset", choices=("quick", "full"), default="quick")
    parser.add_argument("--split", choices=("published", "clean"), default="published")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--jobs", type=int, default=1, help="fits at a time, each in a process of its own")
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args(arguments)
    work = {
        (path.resolve().name, seed): partial(rows_of, path, split=asked.split, preset=asked.preset, seed=seed)
        for seed in asked.seeds
        for path in asked.cables
    }
    study(work, ("cable", "seed"), jobs=asked.jobs, out=asked.out, say=summary)


if __name__ == "__main__":
    main()
