"""Released twins scored on their recordings, and how far our roll-outs of them are from those that were stored."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..methods.base import Trajectory
from ..methods.phystwin.released import Files
from ..metrics.base import Metric
from .cache import Cache, replacing
from .opening import Opened
from .picture import Player
from .plan import Evaluation, Fit, plan
from .progress import Bar
from .released import ENGINE, STORED, Engine, Looks, Reader, StoredTrajectory
from .results import Results
from .runner import Settings

__all__ = ["Apart", "apart", "overall", "scored", "write_apart"]


@dataclass(frozen=True)
class Apart:
    """How far two roll-outs of a recording are apart, over all particles after frame 0 [m]: ``mean``, of the train and of the test frames
    alone too, and ``largest``, which is in ``frame``."""

    scenario: str
    mean: float
    mean_train: float
    mean_test: float
    largest: float
    frame: int

    def __str__(self):
        mean, train, test, largest = (f"{1e3 * value:.3g} mm" for value in (self.mean, self.mean_train, self.mean_test, self.largest))
        return (
            f"{self.scenario}: our engine is {mean} from the stored trajectory on average ({train} in the train frames, {test} in the "
            f"test frames), {largest} at most, in frame {self.frame}"
        )


def overall(gaps: Sequence[Apart]) -> str:
    """One line on several recordings, counted alike; "" where there are not several."""
    if len(gaps) < 2:
        return ""
    worst = max(gaps, key=lambda gap: gap.largest)
    mean = 1e3 * np.mean([gap.mean for gap in gaps])
    return f"All {len(gaps)}: {mean:.3g} mm on average, {1e3 * worst.largest:.3g} mm at most, in frame {worst.frame} of {worst.scenario}"


def apart(scenario: str, ours: Trajectory, stored: Trajectory, train_end: int) -> Apart:
    """The distance between two roll-outs of a recording whose train frames end before ``train_end``."""
    away = np.linalg.norm(ours.positions.astype(float) - stored.positions, axis=2)
    after, frame = away[1:], int(away[1:].max(axis=1).argmax()) + 1
    parts = after, away[1:train_end], away[train_end:]
    mean, train, test = (float(part.mean()) if part.size else float("nan") for part in parts)
    return Apart(scenario, mean, train, test, float(away[frame].max()), frame)


def scored(
    opened: Iterable[Opened],
    found: Mapping[str, Files],
    metrics: Mapping[str, Metric],
    *,
    cache: Cache,
    tasks: Sequence[str],
    scenarios: Sequence[str] = (),
    preset: str = "quick",
    device: str = "cpu",
) -> tuple[Results, list[Apart]]:
    """Rows of the twins ``found`` by the names of their recordings, in all ``tasks`` that apply, and how far each two roll-outs are apart.

    Raises ValueError where none is scored on the chosen recordings, and as ``Runner.run`` does.
    """
    opened, methods = list(opened), {kind.name: Reader(kind, found) for kind in (Engine, StoredTrajectory)}
    looks: Any = Looks(found)
    settings, rows, gaps = Settings(methods, metrics, preset, device, looks), [], []
    for one in opened:
        chosen = [name for name in scenarios if name in one.collection.scenarios]
        if scenarios and not chosen:
            continue
        fits = plan(one.collection, methods=methods, tasks=tasks, scenarios=chosen)
        fits = [fit for fit in fits if len(fit.sources) == 1 and fit.sources[0] in found]
        player = Player(one, settings, cache)
        with Bar(one.collection.name) as bar:
            rows += (own := player.run(fits, progress=bar))
        gaps += _gaps(player, own)
    if not rows:
        raise ValueError(f"nothing to score: no task of {', '.join(tasks)} is scored on the chosen recordings")
    return Results.of(rows, metrics, [one.collection for one in opened]), gaps


def _gaps(player: Player, rows: Sequence[dict]) -> list[Apart]:
    """Of the recordings on which both roll-outs were scored."""
    ok = {(row["scenario"], row["method"]) for row in rows if row["status"] == "ok" and row["task"] != "transfer"}
    found = []
    for name in dict.fromkeys(row["scenario"] for row in rows):
        if {(name, ENGINE), (name, STORED)} <= ok:
            evaluation = Evaluation("resimulation", name)
            ours, stored = (player.play(Fit(method, (name,), 0, (evaluation,)), evaluation) for method in (ENGINE, STORED))
            found.append(apart(name, ours, stored, player.collection.load(name).split.train_end))
    return found


def write_apart(gaps: Iterable[Apart], folder: Path) -> Path:
    """Write ``apart.csv`` into ``folder``, a line a recording, in metres."""
    file = Path(folder) / "apart.csv"
    with replacing(file) as temporary, temporary.open("w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, [field.name for field in fields(Apart)])
        writer.writeheader()
        writer.writerows(asdict(gap) for gap in gaps)
    return file
