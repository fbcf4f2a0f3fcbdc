"""``twinbench curve``: the error over the number of recordings, drawn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import known

__all__ = ["Curve"]


@dataclass(frozen=True)
class Curve:
    """Draw the error over the number of recordings that twins were fitted on, from a folder that twinbench run --ablation clips wrote.

    Needs matplotlib (the extra "plots").
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """Folder with rows.parquet."""
    metric: str = "chamfer"
    """The error to draw (see twinbench list)."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """Where to write it, a .png, .pdf or .svg. Default: DIR/METRIC.png."""

    def __call__(self) -> int:
        from ..curve import draw_curves
        from ..results import read_results

        results, out = read_results(self.folder), self.out or self.folder / f"{self.metric}.png"
        known("metric", [self.metric], results.units)
        draw_curves(results, self.metric, out)
        print(f"Written to {out}")
        return 0
