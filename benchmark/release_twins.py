"""How right twins are about free releases of a trunk: ``python -m twinbench.benchmark.release_twins PATH/trunk --load 200g --out FILE``.

One twin of ``continuum`` is fitted on the releases of the first file, placed in each of the others as fast as its first two frames say, and
scored at the disks [mm]. Beside it stands the repeatability: how far apart two releases come to rest, although nothing differs but from
where they were let go. ``held``: what is predicted by the mean of the fitted releases' resting places.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from itertools import combinations
from pathlib import Path

import numpy as np

from ..datasets.collection import open_collection
from ..methods.continuum import Continuum

__all__ = ["disk_errors", "main", "repeatability", "resting"]

RESTING = 50  # last frames of a release, in which it is still


def resting(scenario) -> np.ndarray:
    """(K, 3) m, where the tracks come to rest."""
    return np.nanmean(scenario.tracks[-RESTING:], axis=0)


def repeatability(scenarios) -> np.ndarray:
    """(K,) mm, the mean distance between the resting places of two of ``scenarios``, track by track."""
    places = [resting(one) for one in scenarios]
    return 1e3 * np.mean([np.linalg.norm(a - b, axis=1) for a, b in combinations(places, 2)], axis=0)


def disk_errors(twin, scenario) -> np.ndarray:
    """(K,) mm, mean Euclidean distance from the tracks to the last K tracked points, over all frames."""
    path = twin.retarget(scenario.initial()).rollout(scenario.controllers).tracked[:, -scenario.tracks.shape[1] :]
    return 1e3 * np.nanmean(np.linalg.norm(path - scenario.tracks, axis=2), axis=0)


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--load", default="200g")
    parser.add_argument("--preset", choices=("quick", "full"), default="quick")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args(arguments)
    collection = open_collection(asked.data)
    pairs = [pair for pair in collection.pairs if f"_{asked.load}" in pair.target]
    if not pairs:
        raise SystemExit(f"no releases with a load of {asked.load!r} in {asked.data}")
    fitted, others = ([collection.load(n) for n in names] for names in (pairs[0].sources, [pair.target for pair in pairs]))
    begun = time.process_time()
    config = Continuum.presets[asked.preset]
    twin = Continuum().fitted([one.observed() for one in fitted], config, seed=asked.seed)
    spent, rest = time.process_time() - begun, np.mean([resting(one) for one in fitted], axis=0)
    rows = []
    for fit, scenario in [(True, one) for one in fitted] + [(False, one) for one in others]:
        off = disk_errors(twin, scenario)
        held = 1e3 * np.nanmean(np.linalg.norm(scenario.tracks - rest, axis=2), axis=0)
        named = {f"disk{k + 1}_mm": round(float(e), 2) for k, e in enumerate(off)} | dict(mean_mm=round(float(off.mean()), 2))
        rows.append(dict(recording=scenario.name, fitted=fit, **named, held_tip_mm=round(float(held[-1]), 2)))
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    with asked.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    for label, fit in (("fitted", True), ("others", False)):
        own = [row for row in rows if row["fitted"] == fit]
        means = {name: round(float(np.mean([row[name] for row in own])), 2) for name in own[0] if name.endswith("_mm")}
        print(f"{label} ({len(own)}): {', '.join(f'{n} {v}' for n, v in means.items())}")
    for label, group in (("all", fitted + others), ("fitted", fitted), ("others", others)):
        apart = repeatability(group)
        print(f"repeatability of {label}: disks {np.round(apart, 2).tolist()} mm, mean {apart.mean():.2f}; twice {2 * apart.mean():.2f}")
    print(f"fitted in {spent:.0f} s of a core: {json.dumps(twin.values)}")


if __name__ == "__main__":
    main()
