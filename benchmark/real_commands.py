"""A trunk under the same motor commands with several loads: is a load noticed, at which disk, and are loads in order?

Every recording is compared with every one of a lighter load, joint by joint (``diagnosis.joints``): with the lightest, which bears nothing,
and with those between, which differ by weights alone.
"""

from __future__ import annotations

import re
import time
from itertools import combinations
from pathlib import Path

import numpy as np

from ..datasets.collection import open_collection
from ..diagnosis.config import MEMBERS, of_preset
from ..diagnosis.joints import MASS, STIFFNESS, Difference, compared
from ..diagnosis.motors import judged

__all__ = ["run"]

LOAD = re.compile(r"controlled_(\d+)g")


def run(data: Path, out: Path, *, preset: str = "quick", device: str = "cpu", progress=print) -> list[dict]:
    """Compare all recordings in ``data``/trunk; ``out``/commands.csv. Raises ValueError where fewer than two loads were commanded."""
    import pandas as pd

    collection, config = open_collection(data / "trunk"), of_preset(MEMBERS, preset)
    loads = sorted((int(found[1]), name) for name in collection.scenarios if (found := LOAD.fullmatch(name)))
    if len(loads) < 2:
        raise ValueError(f"{data / 'trunk'}: must hold recordings of at least two loads under one command, got {len(loads)}")
    recordings, rows = {name: collection.load(name) for _, name in loads}, []
    pairs = [*combinations(loads, 2), (loads[0], loads[0])]
    for (lighter, sound), (heavier, case) in pairs:
        begun = time.time()
        found = compared(recordings[case], [recordings[sound]])
        verdict, names = judged(found, config)
        row = dict(load=heavier, beside=lighter, verdict=verdict, effect=names[0] if names else None, alternatives=" ".join(names[1:]))
        rows.append(row | _row(found) | dict(seconds=round(time.time() - begun, 1)))
        progress(" | ".join(f"{k} {v}" for k, v in rows[-1].items()))
        pd.DataFrame(rows).to_csv(out / "commands.csv", index=False)
    return rows


def _row(found: Difference) -> dict:
    """p, mm apart on held-out frames, and of each explanation its nats, mm left there, and numbers by joint."""
    row = dict(p=round(found.p, 4), apart_mm=round(1e3 * found.left(), 2))
    for names, words in (((MASS,), "weight"), ((STIFFNESS,), "stiffness"), ((MASS, STIFFNESS), "both")):
        best = found.best(*names)
        row |= {f"{words}_nats": round(best.nats, 1), f"{words}_left_mm": round(1e3 * found.left(best), 2)}
        row |= {f"{words}_predicts": round(found.gain(best), 3)}
        if MASS in names:
            others = [e.nats for e in found.explanations if e.names == best.names and e.marker != best.marker]
            row |= {f"{words}_at_disk": best.marker + 1, f"{words}_nats_over_next_disk": round(best.nats - max(others), 1)}
            row |= {f"{words}_over_stiffness": _told(best.values[0], best.sds[0])}
        if STIFFNESS in names:
            row |= {f"{words}_stiffer": _told(best.values[1], best.sds[1])}
    return row


def _told(values, sds) -> str:
    """Values by joint with their standard deviations."""
    return " ".join(f"{v:.3f}+-{s:.3f}" for v, s in zip(np.asarray(values), np.asarray(sds), strict=True))
