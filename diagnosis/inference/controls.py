"""Frozen sound recordings, among whose statistics those of a recording are judged.

Members are not exchangeable with recordings: each is off by what two twins differ in, while a recording's twin was fitted to it, and sound
recordings hold errors that no member has. So each statistic, as a logarithm over its members', and for some kinds what a twin leaves of
the motion, is compared with those of n recordings known to be sound, of the same kind of body and weighed with the same config and the
same usual errors of recordings. They are taken as draws of a Student t whose place, scale and degrees of freedom are the likeliest
(``tails``): a sound recording that lies far out then makes the tail heavier and leaves the rest alone, and p goes on where ranks among n
end at 1 / (1 + n). What the most surprising of them costs hangs on how much they go together, which these recordings tell as well.

``python -m twinbench.diagnosis.inference.controls FILE ...`` freezes the sound rows of ``benchmark.concealed_inference``; kinds of body of
which there are none stay as they were frozen.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from ...datasets.temporary import replacing
from ..config import DiagnosisConfig
from ..effects import effects
from .tails import Tail, any_beyond, going_together

__all__ = ["FILE", "Controls", "frozen", "main"]

FILE = Path(__file__).parent / "controls.json"
MARKED = "marked "  # goes before a kind of body of which markers are seen
DECIDING = (
    "level",
    "wandering",
    "motion",
    "repeat",
    "refitted",
    "astray",
    "reshaped",
    "steps",
    "runs",
    "parallel",
    "clearly",
    "roaming",
    "planned",
    "members",
)  # fields that change no statistic of a recording


@dataclass(frozen=True, eq=False)
class Controls:
    """standardised (n, 2 or 3): of n sound recordings the misfit and the largest score, as logarithms over their members', and for kinds of
    which it is known what is left of the motion (``significance``)."""

    standardised: np.ndarray

    @classmethod
    def of(cls, kind: str, config: DiagnosisConfig, *, marked: bool = False, recordings: int = 1) -> Controls | None:
        """Those of a ``kind`` of body, of which a few markers are seen instead of its surface if ``marked``, of as many ``recordings``
        together as there are controls of, at most so many; None where they are too few to hold one beyond the level, or weighed otherwise.
        """
        known = _known()
        if config.members < known["config"]["members"] or known["config"] != _shaping(config) | {"members": known["config"]["members"]}:
            return None
        for count in range(recordings, 0, -1):
            own = known["kinds"].get(_group(MARKED + kind if marked else kind, count), [])
            if 1 / (1 + len(own)) < config.level:
                return cls(np.array([row["standardised"] for row in own], float))
        return None

    @staticmethod
    def known(kind: str, *, marked: bool = False) -> bool:
        """Whether there are frozen controls of a kind of body at all, however they were weighed."""
        return bool(_known()["kinds"].get(MARKED + kind if marked else kind))

    @classmethod
    def all(cls) -> dict[str, Controls]:
        """All that are frozen, by kind of body and number of recordings."""
        return {group: cls(np.array([row["standardised"] for row in rows], float)) for group, rows in _known()["kinds"].items()}

    def left_out(self) -> np.ndarray:
        """(n,) p of each of them, judged by the others."""
        return np.array([Controls(np.delete(self.standardised, k, 0)).p(one) for k, one in enumerate(self.standardised)])

    @cached_property
    def tails(self) -> tuple[Tail, ...]:
        return tuple(Tail.of(values) for values in self.standardised.T)

    @cached_property
    def together(self) -> np.ndarray:
        """(2 or 3, 2 or 3) correlation of the statistics, as they are rare: a block's misfit and largest score go together."""
        return going_together(self.standardised, self.tails)

    def p(self, standardised) -> float:
        """Of a recording's statistics: of the most surprising one, that any is."""
        return any_beyond(min(tail.beyond(value) for tail, value in zip(self.tails, standardised, strict=False)), self.together)

    def least(self, misfit: float, share: float) -> float:
        """The smaller p of a misfit, as a logarithm over its members', and of a ``share`` of the motion, where that is known."""
        return float(min(self.tails[0].beyond(misfit), *(tail.beyond(share) for tail in self.tails[2:]), 1.0))

    def alarming(self, level: float) -> float:
        """The largest score, as a logarithm over members', above which p is below ``level`` whatever the misfit."""
        from scipy.optimize import brentq

        return self.tails[1].at(float(brentq(lambda p: any_beyond(p, self.together) - level, level / (2 * len(self.tails)), level)))


def _group(kind: str, recordings: int) -> str:
    return kind if recordings == 1 else f"{kind}, {recordings} recordings"


@cache
def _known() -> dict:
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {"config": _shaping(DiagnosisConfig()), "kinds": {}}


def _shaping(config: DiagnosisConfig) -> dict:
    """What statistics depend on, as JSON has it; ``members`` is asked for on its own."""
    found = {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(config).items() if name not in DECIDING}
    usual = {amount.name: amount.usual for effect in effects() for amount in effect.amounts if amount.usual}
    return found | {"members": config.members, "usual": usual}


def frozen(tables: Sequence[Path], config: DiagnosisConfig) -> dict:
    """The content of ``FILE``. Raises ValueError naming a table that has no sound rows or lacks a column."""
    import pandas as pd

    kinds: dict[str, list[dict]] = {}
    for path in tables:
        table = pd.read_csv(path)
        more = {name for kind in set(table.get("kind", ())) for name in _more(kind)}
        missing = {"set", "case", "kind", "effect", "over_misfit", "over_scan", *more} - set(table)
        if missing:
            raise ValueError(f"{path}: a table of controls must have the columns {', '.join(sorted(missing))}")
        sound = table[table.effect == "sound"]
        if sound.empty:
            raise ValueError(f"{path}: a table of controls must have sound rows, got none in {len(table)}")
        for row in sound.itertuples():
            values = [round(float(getattr(row, name)), 4) for name in ("over_misfit", "over_scan", *_more(row.kind))]
            group = _group(str(row.kind), int(getattr(row, "recordings", 1)))
            kinds.setdefault(group, []).append({"set": row.set, "case": row.case, "standardised": values})
    return {"config": _shaping(config), "kinds": {kind: sorted(rows, key=lambda r: (r["set"], r["case"])) for kind, rows in kinds.items()}}


def _more(kind: str) -> tuple[str, ...]:
    """Further statistics of a kind: what is left of the motion where it is a twin's, and not the tracks', as that of markers is."""
    return ("left_share",) if kind.startswith(MARKED) else ()


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.diagnosis.inference.controls", description="Freeze controls.")
    parser.add_argument("tables", nargs="+", type=Path, metavar="FILE", help="CSV of benchmark.concealed_inference; sound rows are taken")
    parser.add_argument("--members", type=int, default=DiagnosisConfig.members, help="with which they were weighed")
    parser.add_argument("--out", type=Path, default=FILE)
    given = parser.parse_args(arguments)
    found = frozen(given.tables, DiagnosisConfig(members=given.members))
    if given.out.exists():
        before = json.loads(given.out.read_text(encoding="utf-8"))
        kept = set(before["kinds"]) - set(found["kinds"])
        if kept and before["config"] != found["config"]:
            differ = sorted(k for k in {*before["config"], *found["config"]} if before["config"].get(k) != found["config"].get(k))
            raise ValueError(
                f"{given.out}: {', '.join(sorted(kept))} were weighed with other {', '.join(differ)}; weigh them anew, or give --out"
            )
        found["kinds"] = {**before["kinds"], **found["kinds"]}
    with replacing(given.out) as temporary:
        temporary.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(", ".join(f"{len(rows)} of kind {kind}" for kind, rows in found["kinds"].items()))


if __name__ == "__main__":
    main()
