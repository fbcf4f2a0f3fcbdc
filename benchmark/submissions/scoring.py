"""Scores of a submission: its roll-outs take the place of those that a run makes, everything after is what a run does."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from ...metrics.base import Metric
from ..cache import Cache
from ..opening import Opened
from ..plan import Evaluation, Fit, plan
from ..provenance import origin
from ..results import Results
from ..runner import Rolled, Runner, Settings
from ..status import Stopped
from .checking import checked, content
from .format import Submission
from .reading import read_rollout

__all__ = ["score"]

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Submitted:
    """What stands in a run's place of a method. Its rows are known by what is in the submission and by the code that reads it."""

    key: list
    appearance: str
    modules: tuple[str, ...] = (read_rollout.__module__,)

    def __call__(self):
        raise ValueError("a submission is not fitted here")


class Reader(Runner):
    """A runner that reads roll-outs instead of making them."""

    def __init__(self, opened: Opened, settings: Settings, cache: Cache, folder: Path, submission: Submission):
        super().__init__(opened, settings, cache)
        self._place, self._submission = folder, submission
        self._given = {one.key: one for one in submission.rollouts}

    def _rollouts(self, fit: Fit, evaluations: Sequence[Evaluation], report: Progress) -> Iterator[Rolled]:
        for target in dict.fromkeys(evaluation.target for evaluation in evaluations):
            report(f"scoring {target}", 1.0)
            own = tuple(evaluation for evaluation in evaluations if evaluation.target == target)
            one = self._given[fit.sources, target, fit.seed]
            about = {"note": one.note, "fit_seconds": _number(one.fit_seconds), "rollout_seconds": _number(one.rollout_seconds)}
            if one.status != "ok":
                yield Rolled(own, about, row={"status": one.status, "reason": one.reason, "diverged_frame": one.diverged_frame})
                continue
            try:
                trajectory = read_rollout(self._place, one)
                yield Rolled(own, about, self._load(target), trajectory, self._submission.appearance)
            except Stopped as stopped:
                yield Rolled(own, about, row=stopped.row)


def _number(seconds: float | None) -> float:
    return float("nan") if seconds is None else float(seconds)


def score(
    folder: Path,
    opened: Opened,
    metrics: Mapping[str, Metric],
    *,
    cache: Cache,
    preset: str = "quick",
    device: str = "cpu",
    progress: Progress = lambda label, fraction: None,
) -> Results:
    """The rows of the submission in ``folder``, as a run of its method on the recordings ``opened`` would have them.

    ``preset`` and ``device`` are those of the appearance, for metrics of images. Raises ValueError where ``checked`` does: nothing is
    scored of a submission that is not in order.
    """
    began, folder = datetime.now(UTC), Path(folder)
    submission = checked(folder, opened, cache, progress=progress)
    digest = content(folder, submission)
    settings = Settings({submission.method: Submitted(["submission", digest], submission.appearance)}, metrics, preset, device)
    fits = plan(opened.collection, methods=[submission.method], tasks=submission.tasks, seeds=submission.seeds)
    rows = Reader(opened, settings, cache, folder, submission).run(fits, progress=progress)
    options = {"data": [opened.path or opened.collection.name], "preset": preset, "device": device, "split": opened.split}
    options |= {"methods": [submission.method], "metrics": list(metrics), "tasks": list(submission.tasks), "seeds": list(submission.seeds)}
    about = origin(began, metrics.values(), options) | {"submission": submission.about | {"sha256": digest}}
    return replace(Results.of(rows, metrics, [opened.collection]), origin=about)
