"""Whether p-values of sound recordings are uniform: ``python -m twinbench.benchmark.calibration --out FILE`` (needs matplotlib).

Frozen controls, each judged by the others, and sound cases of sealed sets, which no control saw: ``--sealed CASES.csv`` with the columns
kind ("control" for a sound one) and p.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..diagnosis.config import DiagnosisConfig
from ..diagnosis.inference.controls import Controls
from .challenge.statistics import clopper_pearson
from .picture import COLORS, blank_figure, drawable, save

__all__ = ["Spread", "draw", "main", "sealed"]

BAND = 0.95  # of the k-th smallest of n uniform numbers, which is Beta(k, n + 1 - k)


@dataclass(frozen=True)
class Spread:
    """Of p-values: how many, how many below the ``level`` with the 95 % interval of their share (Clopper and Pearson), and Kolmogorov and
    Smirnov's p that they are uniform."""

    count: int
    below: int
    low: float
    high: float
    uniform: float

    @classmethod
    def of(cls, values, level: float) -> Spread:
        from scipy.stats import kstest

        values = np.asarray(values, float)
        below = int((values < level).sum())
        return cls(len(values), below, *clopper_pearson(below, len(values)), float(kstest(values, "uniform").pvalue))


def sealed(path: Path) -> np.ndarray:
    """(n,) p of the sound cases in a table; of those that were not answered there is none. Raises ValueError where there are no such."""
    import pandas as pd

    table = pd.read_csv(path)
    if missing := {"kind", "p"} - set(table):
        raise ValueError(f"{path}: a table of cases must have the columns kind and p, got none named {', '.join(sorted(missing))}")
    found = table[table.kind == "control"].p.dropna().to_numpy(float)
    if not len(found):
        raise ValueError(f"{path}: a table of cases must have sound ones, got none in {len(table)}")
    return found


def draw(groups: Mapping[str, np.ndarray], path: Path, level: float) -> None:
    """Write the picture: a panel for each of ``groups`` of p-values, the smallest first, beside the band of uniform ones."""
    from scipy.stats import beta

    drawable(path)
    figure = blank_figure(2.1 * len(groups), 2.5)
    for turn, (panel, (name, values)) in enumerate(zip(figure.subplots(1, len(groups), squeeze=False)[0], groups.items(), strict=True)):
        count, ranks = len(values), np.arange(1, len(values) + 1)
        ideal = ranks / (count + 1)
        low, high = (beta.ppf((1 + sign * BAND) / 2, ranks, count + 1 - ranks) for sign in (-1, 1))
        panel.fill_between(ideal, low, high, color="#dddddd", linewidth=0)
        panel.plot([0, 1], [0, 1], color="#888888", linewidth=0.8)
        panel.plot(ideal, np.sort(values), color=COLORS[turn % len(COLORS)], marker=".", markersize=3, linewidth=0.8)
        panel.axhline(level, color="#b5342b", linewidth=0.6, linestyle=":")
        panel.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
        panel.set_title(f"{name} ({count})", fontsize=8)
        panel.set_xlabel("rank / (n + 1)", fontsize=7)
        panel.tick_params(labelsize=6)
        if not turn:
            panel.set_ylabel("p", fontsize=8)
    save(figure, path)


def main(arguments=None) -> None:
    import pandas as pd

    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.calibration", description=str(__doc__).split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="picture, png, pdf or svg")
    parser.add_argument("--sealed", type=Path, nargs="*", default=[], metavar="CSV", help="cases of sealed sets, one set each")
    given = parser.parse_args(arguments)
    level = DiagnosisConfig.level
    groups = {name: one.left_out() for name, one in Controls.all().items()}
    groups |= {f"{path.parent.name.replace('_', ' ')}": sealed(path) for path in given.sealed}
    draw(groups, given.out, level)
    print(pd.DataFrame({name: vars(Spread.of(values, level)) for name, values in groups.items()}).T.round(3).to_string())


if __name__ == "__main__":
    main()
