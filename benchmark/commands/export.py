"""``twinbench export``: twins that were fitted here, in the layout that PhysTwin's authors publish."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from ..options import PRESETS, Names, known, usable, writable

__all__ = ["Export"]


@dataclass(frozen=True)
class Export:
    """Write twins of phystwin in the layout that its authors publish: searched parameters, checkpoint, roll-out and Gaussians.

    A twin that twinbench run fitted with the same options is taken from the cache, others are fitted. twinbench score reads the files.
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for experiments_optimization, experiments and gaussian_output. What is there of the same recordings is replaced."""
    data: Annotated[tuple[str, ...], arg(metavar="PATH ...")] = ("sample",)
    """Recordings, each of which has a twin of its own."""
    scenarios: Names = ()
    """Only these recordings. Default: all that twins are fitted on one at a time."""
    method: str = "phystwin"
    """phystwin, phystwin-zero, phystwin-first or phystwin-as-published."""
    gaussians: bool = True
    """Also write the Gaussians of recordings that have images, which are fitted where that was not done before."""
    seed: int = 0
    """Seed of the fit."""
    preset: str = "quick"
    """How much work a fit may do: quick or full."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""

    def __call__(self) -> int:
        from ...methods.phystwin import METHODS
        from ..cache import Cache, default_cache
        from ..export import exported
        from ..opening import open_recordings

        known("method", [self.method], [method.name for method in METHODS])
        known("preset", [self.preset], PRESETS)
        usable(self.device)
        cache, folder = Cache(default_cache()), writable(self.out)
        opened = [open_recordings(path, split="published", cache=cache) for path in dict.fromkeys(self.data)]
        alone = list(dict.fromkeys(name for one in opened for name in one.collection.in_domain))
        if not alone:
            raise ValueError(f"nothing to export: in {', '.join(self.data)} no twin is fitted on one recording alone")
        known("scenario", self.scenarios, alone)
        options = {"seed": self.seed, "preset": self.preset, "device": self.device, "gaussians": self.gaussians}
        failed = False
        for name, reason in exported(opened, self.method, folder, cache=cache, scenarios=self.scenarios, **options):
            failed |= bool(reason)
            print(f"{name}: not written: {reason}" if reason else f"{name}: written to {folder}")
        return 1 if failed else 0
