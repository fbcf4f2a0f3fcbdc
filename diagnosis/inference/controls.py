"""Frozen sound recordings, among whose statistics those of a recording are judged.

Members are not exchangeable with recordings: each is off by what two twins differ in, while a recording's twin was fitted to it, so that
sound recordings lie lower among members than members do. Split-conformal calibration (Vovk et al. 2005) asks instead how many of n
recordings known to be sound, of the same kind of body and weighed with the same config, have a statistic as large.

``python -m twinbench.diagnosis.inference.controls FILE ...`` freezes the sound rows of ``benchmark.concealed_inference``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ...datasets.temporary import replacing
from ..config import DiagnosisConfig

__all__ = ["FILE", "Controls", "conformal", "frozen", "main"]

FILE = Path(__file__).parent / "controls.json"
DECIDING = ("level", "motion", "refitted", "steps", "parallel", "members")  # fields that change no statistic of a recording


def conformal(value: float, controls: Sequence[float]) -> float:
    """p of ``value`` among those of sound ``controls``, with which it is exchangeable if it is sound.

    (1 + how many are as large) / (1 + all): right for any distribution, and at least 1 / (1 + n).
    """
    return (1 + sum(c >= value for c in controls)) / (1 + len(controls))


@dataclass(frozen=True, eq=False)
class Controls:
    """standardised (n, 2): of n sound recordings the misfit and the largest score, in deviations of their members'."""

    standardised: np.ndarray

    @classmethod
    def of(cls, kind: str, config: DiagnosisConfig) -> Controls | None:
        """Those of a ``kind`` of body; None where they are too few to reach the level, or were weighed otherwise or with more members."""
        known = _known()
        own = known["kinds"].get(kind, [])
        if 1 / (1 + len(own)) >= config.level or config.members < known["config"]["members"]:
            return None
        if known["config"] != _shaping(config) | {"members": known["config"]["members"]}:
            return None
        return cls(np.array([row["standardised"] for row in own], float))

    def combined(self, standardised) -> np.ndarray:
        """(...) of (..., 2): the larger of the two, each in deviations of the controls' own."""
        mean, deviation = self.standardised.mean(0), self.standardised.std(0, ddof=1)
        return np.max((np.asarray(standardised, float) - mean) / deviation, axis=-1)

    def p(self, standardised) -> float:
        """Of a recording's two statistics."""
        return conformal(float(self.combined(standardised)), self.combined(self.standardised).tolist())

    def alarming(self, level: float) -> float:
        """The largest score, in deviations of members', above which p is below ``level`` whatever the misfit."""
        ordered = np.sort(self.combined(self.standardised))[::-1]
        most = int(np.ceil(level * (1 + len(ordered)))) - 2  # controls that may be as large
        mean, deviation = self.standardised[:, 1].mean(), self.standardised[:, 1].std(ddof=1)
        return float(mean + deviation * ordered[most])


@cache
def _known() -> dict:
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {"config": _shaping(DiagnosisConfig()), "kinds": {}}


def _shaping(config: DiagnosisConfig) -> dict:
    """What statistics depend on, as JSON has it; ``members`` is asked for on its own."""
    found = {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(config).items() if name not in DECIDING}
    return found | {"members": config.members}


def frozen(tables: Sequence[Path], config: DiagnosisConfig) -> dict:
    """The content of ``FILE``. Raises ValueError naming a table that has no sound rows or lacks a column."""
    import pandas as pd

    kinds: dict[str, list[dict]] = {}
    for path in tables:
        table = pd.read_csv(path)
        missing = {"set", "case", "kind", "effect", "far_misfit", "far_scan"} - set(table)
        if missing:
            raise ValueError(f"{path}: a table of controls must have the columns {', '.join(sorted(missing))}")
        sound = table[table.effect == "sound"]
        if sound.empty:
            raise ValueError(f"{path}: a table of controls must have sound rows, got none in {len(table)}")
        for row in sound.itertuples():
            values = [round(float(row.far_misfit), 4), round(float(row.far_scan), 4)]
            kinds.setdefault(row.kind, []).append({"set": row.set, "case": row.case, "standardised": values})
    return {"config": _shaping(config), "kinds": {kind: sorted(rows, key=lambda r: (r["set"], r["case"])) for kind, rows in kinds.items()}}


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.diagnosis.inference.controls", description="Freeze controls.")
    parser.add_argument("tables", nargs="+", type=Path, metavar="FILE", help="CSV of benchmark.concealed_inference; sound rows are taken")
    parser.add_argument("--members", type=int, default=DiagnosisConfig.members, help="with which they were weighed")
    parser.add_argument("--out", type=Path, default=FILE)
    given = parser.parse_args(arguments)
    found = frozen(given.tables, DiagnosisConfig(members=given.members))
    with replacing(given.out) as temporary:
        temporary.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(", ".join(f"{len(rows)} of kind {kind}" for kind, rows in found["kinds"].items()))


if __name__ == "__main__":
    main()
