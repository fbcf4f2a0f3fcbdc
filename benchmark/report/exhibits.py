"""What a report shows: each recording with the roll-outs of all methods in it, read from the cache of a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from ...datasets.collection import Collection
from ...datasets.scenario import Scenario
from ...methods.base import Trajectory
from ..picture import Player
from ..plan import Evaluation, Fit
from ..status import Stopped

__all__ = ["Exhibit", "Replay", "exhibits", "said"]


@dataclass(frozen=True)
class Exhibit:
    """One recording, and by method the fit whose roll-out of it is shown: of its own train frames, or, as a transfer, of ``sources``."""

    collection: str
    name: str
    sources: tuple[str, ...]
    transfer: bool
    seed: int
    rollouts: dict[str, tuple[Fit, Evaluation]] = field(default_factory=dict)

    def rows(self, rows: Iterable[Mapping]) -> list[Mapping]:
        """Those of a run's rows that these roll-outs were scored in."""
        own = self.collection, self.name, "+".join(self.sources), self.seed, self.transfer
        return [r for r in rows if (r["collection"], r["scenario"], r["sources"], r["seed"], r["task"] == "transfer") == own]


def exhibits(collection: Collection, fits: Sequence[Fit]) -> list[Exhibit]:
    """What ``fits`` score, recording by recording, each as fitted before brought over from others; of several seeds the first."""
    found: dict[tuple, Exhibit] = {}
    for fit in fits:
        if fit.seed != fits[0].seed:
            continue
        for evaluation in fit.evaluations:
            transfer = evaluation.task == "transfer"
            key = evaluation.target, transfer, fit.sources
            exhibit = found.setdefault(key, Exhibit(collection.name, evaluation.target, fit.sources, transfer, fit.seed))
            exhibit.rollouts.setdefault(fit.method, (fit, evaluation))
    order = list(collection.scenarios)
    return [found[key] for key in sorted(found, key=lambda key: (order.index(key[0]), key[1], key[2]))]


def said(row: Mapping) -> str:
    """How a row without a score ended, in words."""
    frame = f" at frame {row['diverged_frame']}" if row["status"] == "diverged" else ""
    return f"{row['status']}{frame}: {row['reason']}"


class Replay(Player):
    """Hands out roll-outs of the twins that a run left in the cache. It fits none."""

    def _fit(self, method, fit, origin, report):
        raise Stopped(status="skipped", reason="its twin is not in the cache any more")

    def load(self, name: str) -> Scenario:
        """The recording of that name. Raises ValueError where it cannot be read."""
        try:
            return self._load(name)
        except Stopped as stopped:
            raise ValueError(stopped.row["reason"]) from stopped

    def play_exhibit(self, exhibit: Exhibit, rows: Sequence[Mapping], *, progress) -> tuple[dict[str, Trajectory], dict[str, str]]:
        """By method the roll-out, and why there is none, or none to its end. ``rows`` are the exhibit's."""
        rollouts, reasons = {}, {}
        for method, (fit, evaluation) in exhibit.rollouts.items():
            progress(method)
            own = [row for row in rows if row["method"] == method]
            ended = [said(row) for row in own if row["status"] != "ok"]
            if ended:
                reasons[method] = ended[0]
            if not any(row["status"] in ("ok", "diverged") for row in own):
                continue  # nothing of it came to a roll-out
            try:
                rollouts[method] = self.play(fit, evaluation)
            except ValueError as error:
                reasons.setdefault(method, str(error))
        return rollouts, reasons
