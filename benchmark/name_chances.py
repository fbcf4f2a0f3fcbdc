"""How well probabilities of names tell right ones: ``python -m twinbench.benchmark.name_chances TABLE``.

A TABLE (csv) has a row for each recording in which something is missing: ``kind`` (effect, or outside: what no catalogue has), what was
``concealed``, the test's ``p``, and of the likeliest refit ``first``, what it leaves (``p_left``) and its ``gain`` with ``gain_error``;
empty where nothing was refitted, as where the test does not alarm. ``results/names.csv`` is one.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import cast

import numpy as np

from ..diagnosis.config import DiagnosisConfig
from ..diagnosis.inference.phases import Named, shortcoming
from ..diagnosis.inference.refit import Gain
from ..diagnosis.outcome import chance_of_listed, chance_of_sound
from .challenge.statistics import auroc

__all__ = ["chance", "main", "summary"]

TRIED = (0.5, 0.8, 0.95)  # of ``DiagnosisConfig.listed``
BINS = (0.0, 0.2, 0.5, 0.7, 1.0)
EQUAL = 1 / 24  # what the likeliest of so many effects has where nothing tells them apart


def chance(row, config: DiagnosisConfig, without: str = "") -> float:
    """Probability of the likeliest name of a ``row``; ``without`` what it leaves ("left"), or what it gains ("gain")."""
    missing = 1 - chance_of_sound(row.p)
    if not isinstance(row.first, str):
        return missing * config.listed * EQUAL
    left, share = (0.5 if without == "left" else row.p_left), (np.nan if without == "gain" else row.gain)
    return missing * chance_of_listed(config, left, Gain(share, row.gain_error))


def summary(rows: Sequence, chances: Sequence[float]) -> dict:
    """By ``chances`` of likeliest names: the area under the curve by which they tell effects from what is outside the catalogue; of what
    was refitted the Brier score, and in each bin how many names there are and which share is right."""
    told, refitted = np.array(chances), np.array([isinstance(row.first, str) for row in rows])
    outside = np.array([row.kind == "outside" for row in rows])
    right = np.array([row.first == row.concealed for row in rows])
    found: dict[str, float | str] = {"area": auroc(told[~outside], told[outside]), "brier": float(np.mean((told - right)[refitted] ** 2))}
    which = np.digitize(told, BINS[1:-1])
    for k, (low, high) in enumerate(pairwise(BINS)):
        own = right[refitted & (which == k)]
        found[f"{low:g} to {high:g}"] = f"{own.sum()} of {len(own)}"
    return found


def by_verdict(row, config: DiagnosisConfig) -> float:
    """All for the name where it is believed, nothing otherwise."""
    tried = SimpleNamespace(left=row.p_left, log_evidence=row.nats, gain=Gain(row.gain, row.gain_error))
    believed = isinstance(row.first, str) and row.p < config.level and shortcoming(cast(Named, tried), config) is None
    return (1 - chance_of_sound(row.p)) * float(believed)


def main(argv: Sequence[str] | None = None) -> int:
    import pandas as pd

    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("table", help="csv file")
    rows = list(pd.read_csv(parser.parse_args(argv).table).itertuples())
    usual, lines = DiagnosisConfig(), {}
    lines["by the verdict alone"] = summary(rows, [by_verdict(row, usual) for row in rows])
    for listed in TRIED:
        config = replace(usual, listed=listed)
        for without in ("", "gain", "left"):
            name = f"listed {listed:g}" + (f", without {without}" if without else "")
            lines[name] = summary(rows, [chance(row, config, without) for row in rows])
    print(pd.DataFrame(lines).T.to_string(float_format=lambda value: f"{value:.3f}"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
