"""``twinbench concealed``: diagnoses whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import PRESETS, known, usable, writable
from ..text import shown

__all__ = ["Concealed"]


@dataclass(frozen=True)
class Concealed:
    """Diagnose pairs of recordings in which something known was concealed, and score the answers against their labels.

    The recordings are written by python -m twinbench.datasets.concealed. Answers that are there are kept.
    """

    data: Annotated[Positional[tuple[Path, ...]], arg(metavar="DIR")]
    """Folders of case_*/fit and case_*/transfer, each with labels.json."""
    preset: str = "quick"
    """quick or full."""
    device: str = "cpu"
    """cpu or cuda."""
    jobs: int = 1
    """Cases that are diagnosed at the same time."""
    calibrate: bool = False
    """Fit the decision to these labels, write calibration.json, and score each case by a decision that did not see it (8-fold)."""
    ceiling: bool = False
    """Have who is told the effect and its place answer too, and say what share of what they gain the answers gain."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("results/concealed")
    """Folder for the answers, scores.json and cases.md."""

    def __call__(self) -> int:
        from .. import concealed

        known("preset", [self.preset], PRESETS)
        usable(self.device)
        how = {"preset": self.preset, "device": self.device, "jobs": self.jobs, "calibrating": self.calibrate, "ceiling": self.ceiling}
        results, labels, scored = concealed.study(self.data, writable(self.out), **how)
        print(concealed.by_effect(results, labels))
        print("\n".join(f"{name:16} {value}" for name, value in scored.items()))
        print(f"Written to {shown(str(self.out))}")
        return 1 if any(r["verdict"] == "failed" for r in results.values()) else 0
