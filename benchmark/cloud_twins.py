"""How right twins are about clouds of points: ``python -m twinbench.benchmark.cloud_twins PATH/diffcloud --out FILE``.

Each recording whose points do not correspond is fitted on its train frames. Errors of the test frames are Chamfer distances from what was
seen to the twin, Euclidean and as published by PhysTwin (Manhattan), beside a body that follows its grip rigidly and one that stays; frames
are reported apart in which hands are so slow that inertia hardly bends a hanging body.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from pathlib import Path

import numpy as np

from ..datasets.collection import open_collection
from ..methods.base import Budget
from ..methods.registry import get_method
from ..metrics.chamfer import one_sided_chamfer

__all__ = ["chamfers", "main", "quasi_static", "rows_of"]

METHODS = ("static", "rigid", "continuum")
INERTIA = 0.003  # v^2 over gravity times the body's extent, below which a frame is quasi-static: 0.1 m/s for 0.4 m


def quasi_static(scenario) -> np.ndarray:
    """(T,) whether no controller is fast there: v^2 < ``INERTIA`` g L, by the frame rate as it is said."""
    path = scenario.controllers
    speed = np.linalg.norm(np.gradient(path, axis=0), axis=-1).max(1, initial=0.0) * scenario.fps
    size = np.linalg.norm(np.ptp(scenario.structure[scenario.known], axis=0))
    return speed**2 < INERTIA * np.linalg.norm(scenario.gravity) * size


def chamfers(trajectory, scenario, frames, norm: int) -> np.ndarray:
    """(n,) m, of each of ``frames``: the one-sided distance in the L-``norm`` from what was seen to the twin's surface."""
    seen = [scenario.points[t][scenario.visible[t]] for t in frames]
    return np.array([one_sided_chamfer(cloud, trajectory.surface[t], norm=norm) for t, cloud in zip(frames, seen, strict=True)])


def rows_of(scenario, *, preset: str, seed: int) -> list[dict]:
    """A row for each method."""
    rows, slow = [], quasi_static(scenario)
    test = np.array(scenario.split.test)
    for name in METHODS:
        begun = time.process_time()
        twin = get_method(name).fit([scenario.observed()], budget=Budget(preset), seed=seed)
        spent = time.process_time() - begun
        trajectory = twin.rollout(scenario.controllers)
        row = dict(recording=scenario.name, method=name, seed=seed, test_frames=len(test), slow_frames=int(slow[test].sum()))
        for label, norm in (("euclidean", 2), ("published", 1)):
            off = 1e3 * chamfers(trajectory, scenario, test, norm)
            parts = {"": off, "_slow": off[slow[test]], "_fast": off[~slow[test]]}
            row |= {f"{label}{part}_mm": round(float(values.mean()), 2) if len(values) else None for part, values in parts.items()}
        rows.append(row | dict(fit_cpu=round(spent), values=json.dumps(getattr(twin, "values", {}))))
    return rows


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--preset", choices=("quick", "full"), default="quick")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args(arguments)
    collection, rows = open_collection(asked.data), []
    for name in collection.in_domain:
        scenario = collection.load(name)
        if scenario.correspond:
            continue
        rows += rows_of(scenario, preset=asked.preset, seed=asked.seed)
        asked.out.parent.mkdir(parents=True, exist_ok=True)
        with asked.out.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)
        for row in rows[-len(METHODS) :]:
            print(", ".join(f"{k} {v}" for k, v in row.items() if k != "values"), flush=True)


if __name__ == "__main__":
    main()
