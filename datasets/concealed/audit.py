"""Does the outside of a case tell what is concealed in it? A classifier on names, sizes, types, shapes and times must be at chance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import safe_pickle

__all__ = ["Audit", "audit", "outside_of"]

RIDGE = 1.0  # on standardised features: few cases, many features
SHUFFLES = 999


@dataclass(frozen=True)
class Audit:
    """auc  of the left-out cases, in the classifier's order: 0.5 is chance
    p    share of shufflings of the labels whose classifier is at least as good
    """

    auc: float
    p: float


def outside_of(case: str | Path) -> dict[str, float]:
    """Everything about the files of a case but their contents, as numbers by name: sizes, times, and of arrays types and shapes."""
    found = {}
    for file in sorted(Path(case).rglob("*")):
        name, stat = file.relative_to(case).as_posix(), file.stat()
        found |= {f"{name} is there": 1.0, f"{name} time": stat.st_mtime, f"{name} mode": float(stat.st_mode)}
        if file.is_file():
            found[f"{name} size"] = float(stat.st_size)
        if file.suffix == ".pkl":
            held = safe_pickle.load(file)
            for key, value in (held if isinstance(held, dict) else {"array": held}).items():
                array = safe_pickle.numbers_of(value, file, str(key))
                found |= {f"{name} {key} {axis}": float(n) for axis, n in enumerate(array.shape)}
                found[f"{name} {key} is {array.dtype} {type(value).__name__}"] = 1.0
    return found


def audit(cases: Mapping[str, str | Path], told: Mapping[str, bool], *, seed: int = 0) -> Audit:
    """How well the outsides of ``cases`` (folders by name) tell for which of them ``told`` is true: left-out ridge regression.

    Raises ValueError where all are alike in ``told``.
    """
    names = sorted(cases)
    truth = np.array([bool(told[n]) for n in names])
    if truth.all() or not truth.any():
        raise ValueError("an audit needs cases of both kinds")
    rows = [outside_of(cases[n]) for n in names]
    columns = sorted({key for row in rows for key in row})
    table = np.array([[row.get(key, -1.0) for key in columns] for row in rows])
    table = table[:, np.ptp(table, axis=0) > 0]
    if not table.shape[1]:
        return Audit(0.5, 1.0)
    table = (table - table.mean(0)) / table.std(0)
    table = np.concatenate([table, np.ones((len(table), 1))], 1)
    prior = np.diag([RIDGE * len(columns)] * (table.shape[1] - 1) + [1e-9])
    hat = table @ np.linalg.solve(table.T @ table + prior, table.T)
    rng = np.random.default_rng(seed)
    found = _left_out_auc(hat, truth)
    null = [_left_out_auc(hat, rng.permutation(truth)) for _ in range(SHUFFLES)]
    return Audit(found, (1 + sum(auc >= found for auc in null)) / (1 + SHUFFLES))


def _left_out_auc(hat, truth):
    """Area under the curve of what a linear smoother predicts of each case without it: (fit - h y) / (1 - h)."""
    y, h = truth.astype(float), np.diag(hat)
    told = (hat @ y - h * y) / (1 - h)
    above = told[truth][:, None] - told[~truth][None]
    return float(((above > 0) + 0.5 * (above == 0)).mean())
