"""``twinbench compare``: two runs side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import known

__all__ = ["Compare"]


@dataclass(frozen=True)
class Compare:
    """Say by how much the means of two runs differ on the same recordings, with paired 95 % intervals, and what changed in between."""

    a: Annotated[Positional[Path], arg(metavar="A")]
    """Folder of a run, or the folder above it for the latest there."""
    b: Annotated[Positional[Path], arg(metavar="B")]
    """The run to compare with it."""
    format: str = "terminal"
    """terminal, markdown or csv."""

    def __call__(self) -> int:
        from ..compare import compare

        known("format", [self.format], ("terminal", "markdown", "csv"))
        found = compare(self.a, self.b)
        print(getattr(found, self.format)(), end="" if self.format == "csv" else "\n")
        return 0
