"""What a submission is: a method, who answers for it, and its roll-outs, as ``submission.json`` says it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from ..cache import replacing
from ..plan import TASKS

__all__ = ["FILE", "FORMAT", "NO_CODE", "Rollout", "Submission", "write_json"]

FILE = "submission.json"
FORMAT = 1  # raised when an older file would mean something else
NO_CODE = "none"
ORDER = (
    *("format", "method", "description", "authors", "date", "code", "commit", "versions", "hardware"),
    *("other_data", "test_frames_unseen", "appearance", "tasks", "data", "rollouts"),
)


@dataclass(frozen=True)
class Rollout:
    """One roll-out of ``recording``, from frame 0 on, of a twin that was fitted on the recordings ``fitted_on`` with ``seed``.

    file            the .npz file in the submission's folder, "" where there is no roll-out: ``status`` and ``reason`` then say why
    diverged_frame  the first frame that is not finite, None where all are
    """

    recording: str
    fitted_on: tuple[str, ...]
    seed: int = 0
    file: str = ""
    status: str = "ok"
    reason: str = ""
    diverged_frame: int | None = None
    fit_seconds: float | None = None
    rollout_seconds: float | None = None
    note: str = ""

    @property
    def key(self) -> tuple[tuple[str, ...], str, int]:
        """What tells it from the others of a submission."""
        return self.fitted_on, self.recording, self.seed

    @property
    def transfer(self) -> bool:
        """Whether the twin was fitted on other recordings."""
        return self.fitted_on != (self.recording,)

    def __str__(self):
        more = f" and {len(self.fitted_on) - 1} more" if len(self.fitted_on) > 1 else ""
        whose = f" by the twin fitted on {next(iter(self.fitted_on))}{more}" if self.transfer else ""
        return f"the roll-out of {self.recording}{whose}, seed {self.seed}"


@dataclass(frozen=True)
class Submission:
    """A method and its roll-outs. See docs/submissions.md for what each field means."""

    method: str
    authors: str
    date: str
    code: str
    other_data: str
    test_frames_unseen: bool
    data: Mapping
    rollouts: tuple[Rollout, ...]
    format: int = FORMAT
    description: str = ""
    commit: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    hardware: str = ""
    appearance: str = "corrected"
    tasks: tuple[str, ...] = tuple(TASKS)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Of its roll-outs; 0 where it has none."""
        return tuple(dict.fromkeys(one.seed for one in self.rollouts)) or (0,)

    @property
    def about(self) -> dict:
        """Who, when and by what, as a table's provenance has it."""
        found = self.values
        del found["rollouts"], found["format"]
        return found

    @property
    def values(self) -> dict:
        """What ``submission.json`` says, its fields in the order in which they are read."""
        found = asdict(self) | {"tasks": list(self.tasks)}
        found["rollouts"] = [_spoken(one) for one in self.rollouts]
        return {name: found[name] for name in ORDER}


def _spoken(rollout: Rollout) -> dict:
    """Its fields without those that say nothing."""
    found = {name: value for name, value in asdict(rollout).items() if value not in ("", None)}
    return found | {"fitted_on": list(rollout.fitted_on)}


def write_json(values: Mapping, file: Path) -> None:
    """Write ``submission.json``, or what begins one."""
    with replacing(file) as temporary:
        temporary.write_text(json.dumps(values, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
