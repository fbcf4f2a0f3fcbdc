"""``twinbench table``: a table again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import known

__all__ = ["Table"]


@dataclass(frozen=True)
class Table:
    """Print again the table of a run."""

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """Folder of a run, or the folder above it for the latest there."""
    format: str = "terminal"
    """terminal, markdown or latex."""

    def __call__(self) -> int:
        from .. import table
        from ..results import read_results

        known("format", [self.format], ("terminal", "markdown", "latex"))
        print(getattr(table, self.format)(read_results(self.folder)))
        return 0
