"""What the study of the cables found, as rows and as a table."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..datasets.temporary import replacing
from ..diagnosis.fit import Fit
from ..diagnosis.ladder import Climb, believed

__all__ = ["FIELDS", "Found", "markdown", "repeated", "write"]

FIELDS = ("cable", "seed", "step", "term", "recording", "all_mm", "free_mm", "still_all_mm", "still_free_mm")
STEP_FIELDS = ("cable", "seed", "step", "term", "said", "before_mm", "after_mm", "log_gain", "log_gain_se")
VALUE_FIELDS = ("cable", "seed", "step", "term", "parameter", "value")
COLUMNS = ("eval, all markers: mean", "median", "free markers: mean", "median", "started at rest, all: mean")
# what takes energy out of bends: by which law, motions of a second or two hardly tell, and each stands for most of the others
LOSSES: dict[str, str] = dict.fromkeys(("rope_creep", "rope_friction", "rope_relaxing", "rope_yielding"), "bending_damping")


@dataclass(frozen=True)
class Found:
    """What a study of one cable with one seed found.

    names, fits  of the steps, the twin first
    rows         ``FIELDS`` of every eval recording after every step
    published    errors [m] of others, by name
    fitted       recordings that were fitted or that candidates were accepted on
    """

    cable: str
    seed: int
    climb: Climb
    names: tuple[str, ...]
    fits: tuple[Fit, ...]
    rows: list[dict]
    seconds: float
    published: dict[str, float]
    fitted: tuple[str, ...] = ()

    def mean(self, step: int, field: str) -> float:
        """Mean over the eval recordings of a field of the rows of one step."""
        return float(np.mean([r[field] for r in self.rows if r["step"] == step]))

    def errors(self, step: int) -> list[float]:
        """``COLUMNS`` [mm] after a step."""
        rows = [[r[c] for c in ("all_mm", "free_mm", "still_all_mm")] for r in self.rows if r["step"] == step]
        every, free, still = np.array(rows, float).T
        return [every.mean(), np.median(every), free.mean(), np.median(free), still.mean()]

    def told(self) -> list[dict]:
        """What was said of every candidate that was refitted, step by step, and of every accepted one when it was taken out at the end."""
        found = []

        def add(step, term, said, before, after, gain, spread):
            numbers = (round(v, 4) for v in (1e3 * before, 1e3 * after, gain, spread))
            found.append(dict(zip(STEP_FIELDS, (self.cable, self.seed, step, term, said, *numbers), strict=True)))

        steps, last = self.climb.steps, self.climb.steps[-1].after if self.climb.steps else self.climb.error
        for k, step in enumerate(steps, 1):
            for rung in step.rivals:
                said = "accepted" if rung.name == step.name else "refused"
                add(k, rung.name, said, step.before, rung.error, rung.gain, rung.spread)
            for name in step.dropped:
                add(k, name, "dropped", step.before, step.after, 0.0, 0.0)
        for rung in self.climb.rivals if not steps or self.climb.rivals is not steps[-1].rivals else ():
            add(len(steps) + 1, rung.name, "refused", last, rung.error, rung.gain, rung.spread)
        for name, (loss, spread) in self.climb.losses.items():
            add(len(steps), name, "taken out", last, np.nan, -loss, spread)
        return found

    def values(self) -> list[dict]:
        """The parameters of every step."""
        rows = [(k, name, p, v) for k, (name, one) in enumerate(zip(self.names, self.fits, strict=True)) for p, v in one.values.items()]
        return [dict(zip(VALUE_FIELDS, (self.cable, self.seed, k, n, p, float(f"{v:.5g}")), strict=True)) for k, n, p, v in rows]


def write(found: Sequence[Found], out: Path) -> None:
    """Rows and the table of all studies so far: cables.csv, cables_steps.csv, cables_values.csv and cables.md in ``out``."""
    tables = {"cables.csv": (FIELDS, "rows"), "cables_steps.csv": (STEP_FIELDS, "told"), "cables_values.csv": (VALUE_FIELDS, "values")}
    for name, (fields, source) in tables.items():
        rows = [row for f in found for row in (f.rows if source == "rows" else getattr(f, source)())]
        _put(out / name, lambda stream, fields=fields, rows=rows: _write_csv(stream, fields, rows))
    _put(out / "cables.md", lambda stream: stream.write(markdown(found)))


def _write_csv(stream, fields, rows):
    writer = csv.DictWriter(stream, fields, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)


def _put(path, fill):
    with replacing(path) as temporary, temporary.open("w", newline="") as stream:
        fill(stream)


def markdown(found: Sequence[Found]) -> str:
    """Per cable: validation and eval errors after every step, by seed, and the order in which terms were accepted."""
    text = []
    for cable in dict.fromkeys(f.cable for f in found):
        mine = [f for f in found if f.cable == cable]
        text += [f"### {cable}", "", "| seed | step | validation, free: before, mm | after | " + " | ".join(COLUMNS) + " |"]
        text.append("|---|---|---|---|" + "---|" * len(COLUMNS))
        ends = {}
        for f in mine:
            for k, name in enumerate(f.names):
                step = f.climb.steps[k - 1] if 0 < k <= len(f.climb.steps) else None
                before = f"{1e3 * step.before:.2f}" if step else ""
                after = f"{1e3 * step.after:.2f}" if step else f"{1e3 * f.climb.error:.2f}" if not k else ""
                errors = f.errors(k)
                ends.setdefault("twin" if not k else name, []).append(errors)
                text.append(f"| {f.seed} | {name} | {before} | {after} | " + " | ".join(f"{e:.2f}" for e in errors) + " |")
        for name in ("twin", "all refitted"):
            text.append(f"| mean | {name} | | | " + " | ".join(f"{e:.2f}" for e in np.mean(ends[name], axis=0)) + " |")
        for who, value in mine[0].published.items():
            text.append(f"| | {who} | | | {1e3 * value:.2f} |" + " |" * (len(COLUMNS) - 1))
        orders = [f"seed {f.seed}: {', '.join(f.climb.accepted) or 'nothing'}" for f in mine]
        text += ["", f"Order of what was accepted: {'; '.join(orders)}.", "", repeated(mine), ""]
        text += [f"Wall time by seed: {', '.join(f'{f.seconds:.0f} s' for f in mine)}.", ""]
    return "\n".join(text)


def _with_laws(name: str, found: Sequence[Found]) -> str:
    """``name``, and as or with which other laws some seeds found it."""
    laws = [(f.seed, "with" if name in f.climb.kept else "as", [n for n in f.climb.kept if LOSSES.get(n) == name]) for f in found]
    said = "; ".join(f"seed {seed}: {how} {', '.join(own)}" for seed, how, own in laws if own)
    return f"{name} ({said})" if said else name


def repeated(found: Sequence[Found]) -> str:
    """What every seed found of one cable, and what one or some did."""
    if len(found) < 2:
        return "Believed is what every one of several seeds ends with; this is one seed."
    every = believed([f.climb for f in found], LOSSES)
    others = {n: [f.seed for f in found if n in f.climb.kept] for f in found for n in f.climb.kept if LOSSES.get(n, n) not in every}
    said = f"Believed, since every seed ends with it: {', '.join(_with_laws(name, found) for name in every) or 'nothing'}."
    once = ", ".join(f"{name} (seed {', '.join(map(str, seeds))})" for name, seeds in others.items())
    return said + (f" Not repeated: {once}." if once else "")
