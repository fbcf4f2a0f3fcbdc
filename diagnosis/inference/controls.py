"""Frozen sound recordings, among whose statistics those of a recording are judged.

Members are not exchangeable with recordings: each is off by what two twins differ in, while a recording's twin was fitted to it, and sound
recordings hold errors that no member has. So each statistic, as a logarithm over its members', for some kinds what a twin leaves of the
motion, and for some how much less of the body than was told the fit lets a hand hold, is compared with those of n recordings known to be
sound, of the same kind of body and weighed with the same config and the same usual errors of recordings; so is, for some, how far tracks
beside a hand stray from where it would carry them. They are taken as draws of a
Student t whose place, scale and degrees of freedom are the likeliest (``tails``): a sound recording that lies far out then makes the tail
heavier and leaves the rest alone, and p goes on where ranks among n end at 1 / (1 + n). What the most surprising of them costs is how often
these recordings have any that is: it hangs on how much they go together, and what other recordings may be off by further (``usual``) makes
a statistic less surprising, and no other more.

``python -m twinbench.diagnosis.inference.controls FILE ...`` freezes the sound rows of ``benchmark.concealed_inference``; kinds of body of
which there are none stay as they were frozen.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from ...datasets.temporary import replacing
from ..config import DiagnosisConfig
from ..effects import effects
from .tails import Tail, any_beyond, going_together

__all__ = ["FILE", "Controls", "frozen", "main"]

FILE = Path(__file__).parent / "controls.json"
COLUMNS = {"misfit": "over_misfit", "scan": "over_scan", "left": "left_share", "grip": "grip_narrowed", "stray": "hand_stray"}  # of tables
MARKED = "marked "  # goes before a kind of body of which markers are seen
DECIDING = (
    "level",
    "wandering",
    "held",
    "strays",
    "motion",
    "repeat",
    "ridges",
    "refitted",
    "astray",
    "reshaped",
    "steps",
    "runs",
    "behind",
    "parallel",
    "clearly",
    "listed",
    "roaming",
    "planned",
    "members",
)  # fields that change no statistic of a recording


@dataclass(frozen=True, eq=False)
class Controls:
    """standardised (n, k): the statistics ``names`` (k,) of n sound recordings (``significance.Significance.standardised``), NaN where one
    was not weighed by it; ``usual``: by name a standard deviation of what other recordings may have beyond these."""

    standardised: np.ndarray
    names: tuple[str, ...]
    usual: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, kind: str, config: DiagnosisConfig, *, marked: bool = False, recordings: int = 1) -> Controls | None:
        """Those of a ``kind`` of body, of which a few markers are seen instead of its surface if ``marked``, of as many ``recordings``
        together as there are controls of, at most so many; None where they are too few to hold one beyond the level, or weighed otherwise.
        """
        known = _known()
        if config.members < known["config"]["members"] or known["config"] != _shaping(config) | {"members": known["config"]["members"]}:
            return None
        for count in range(recordings, 0, -1):
            every = cls._read(known["kinds"].get(_group(MARKED + kind if marked else kind, count), []), config)
            enough = 1 / (1 + np.isfinite(every.standardised).sum(0)) < config.level
            kept = [k for k in range(len(every.names)) if enough[k]]
            if kept:
                return replace(every, standardised=every.standardised[:, kept], names=tuple(every.names[k] for k in kept))
        return None

    @classmethod
    def _read(cls, rows: Sequence[dict], config: DiagnosisConfig) -> Controls:
        told = [row["statistics"] for row in rows]
        names = tuple(name for name in COLUMNS if any(name in one for one in told))
        values = np.array([[one.get(name, np.nan) for name in names] for one in told])
        return cls(values.reshape(len(rows), len(names)), names, {"grip": config.held, "stray": config.strays})

    @staticmethod
    def known(kind: str, *, marked: bool = False) -> bool:
        """Whether there are frozen controls of a kind of body at all, however they were weighed."""
        return bool(_known()["kinds"].get(MARKED + kind if marked else kind))

    @classmethod
    def all(cls) -> dict[str, Controls]:
        """All that are frozen, by kind of body and number of recordings."""
        return {group: cls._read(rows, DiagnosisConfig()) for group, rows in _known()["kinds"].items()}

    def left_out(self) -> np.ndarray:
        """(n,) p of each of them by what it was weighed by, judged by the others."""
        found = []
        for k, row in enumerate(self.standardised):
            own = {name: value for name, value in zip(self.names, row, strict=True) if np.isfinite(value)}
            found.append(replace(self, standardised=np.delete(self.standardised, k, 0)).p(own))
        return np.array(found)

    @cached_property
    def tails(self) -> dict[str, Tail]:
        found = {name: Tail.of(own[np.isfinite(own)]) for name, own in zip(self.names, self.standardised.T, strict=True)}
        return {name: replace(one, further=self.usual.get(name, 0.0)) for name, one in found.items()}

    @cached_property
    def together(self) -> np.ndarray:
        """(k, k) correlation of the statistics, as they are rare: a block's misfit and largest score go together."""
        whole = np.isfinite(self.standardised).all(1)
        return going_together(self.standardised[whole], list(self.tails.values()))

    def p(self, standardised: Mapping[str, float]) -> float:
        """Of those statistics of a recording that are known of sound ones: of the most surprising one, that any is."""
        given = [k for k, name in enumerate(self.names) if name in standardised]
        rarest = min(float(self.tails[self.names[k]].beyond(standardised[self.names[k]])) for k in given)
        return self._any(rarest, given)

    def _any(self, p: float, given: Sequence[int]) -> float:
        """The share of these recordings of which one of the ``given`` statistics is as rare as ``p``; ``p`` at least."""
        return max(p, any_beyond([self.tails[self.names[k]].within(p) for k in given], self.together[np.ix_(given, given)]))

    def least(self, misfit: float, share: float) -> float:
        """The smaller p of a misfit, as a logarithm over its members', and of a ``share`` of the motion, where that is known."""
        given = {"misfit": misfit, "left": share}
        return float(min([1.0, *(tail.beyond(given[name]) for name, tail in self.tails.items() if name in given)]))

    def alarming(self, level: float) -> float:
        """The largest score, as a logarithm over members', above which p is below ``level`` whatever the misfit."""
        from scipy.optimize import brentq

        given = range(len(self.names))
        return self.tails["scan"].at(float(brentq(lambda p: self._any(p, given) - level, level / (2 * len(self.tails)), level)))


def _group(kind: str, recordings: int) -> str:
    return kind if recordings == 1 else f"{kind}, {recordings} recordings"


@cache
def _known() -> dict:
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else frozen([], DiagnosisConfig())


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
        needed = {COLUMNS[name] for kind in set(table.get("kind", ())) for name in _needed(kind)}
        missing = {"set", "case", "kind", "effect", "over_misfit", "over_scan", *needed} - set(table)
        if missing:
            raise ValueError(f"{path}: a table of controls must have the columns {', '.join(sorted(missing))}")
        sound = table[table.effect == "sound"]
        if sound.empty:
            raise ValueError(f"{path}: a table of controls must have sound rows, got none in {len(table)}")
        for row in sound.itertuples():
            told = {name: float(getattr(row, COLUMNS[name], np.nan)) for name in (*_needed(str(row.kind)), "grip", "stray")}
            values = {name: round(value, 4) for name, value in told.items() if np.isfinite(value)}
            group = _group(str(row.kind), int(getattr(row, "recordings", 1)))
            kinds.setdefault(group, []).append({"set": row.set, "case": row.case, "statistics": values})
    ordered = {kind: sorted(rows, key=lambda r: (r["set"], r["case"])) for kind, rows in kinds.items()}
    return {"config": _shaping(config), "kinds": ordered}


def _needed(kind: str) -> tuple[str, ...]:
    """Statistics that all have of a kind: what is left of the motion where it is a twin's, and not the tracks', as that of markers is."""
    return ("misfit", "scan", "left") if kind.startswith(MARKED) else ("misfit", "scan")


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
        then, now = before["config"], found["config"]
        differ = sorted(k for k in {*then, *now} if then.get(k) != now.get(k))
        if kept and differ:
            raise ValueError(
                f"{given.out}: {', '.join(sorted(kept))} were weighed with other {', '.join(differ)}; weigh them anew, or give --out"
            )
        found["kinds"] = {**before["kinds"], **found["kinds"]}
    with replacing(given.out) as temporary:
        temporary.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(", ".join(f"{len(rows)} of kind {kind}" for kind, rows in found["kinds"].items()))


if __name__ == "__main__":
    main()
