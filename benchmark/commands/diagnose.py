"""``twinbench diagnose``: which physics a twin lacks."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import DEVICES, PRESETS, known, writable
from ..text import shown

__all__ = ["Diagnose"]


@dataclass(frozen=True)
class Diagnose:
    """Say which physics a recording shows and a spring-mass twin lacks: where, since when, how much it matters; or that nothing is missing.

    A recording is a folder in a known layout (see twinbench list), with /NAME behind it where the folder holds several.
    """

    case: Annotated[Positional[str], arg(metavar="CASE")]
    """The recording. Its held-out frames are never fitted."""
    transfer: Annotated[tuple[str, ...], arg(metavar="CASE ...")] = ()
    """Other interactions with the same object. They are never fitted."""
    fitted_on: Annotated[tuple[str, ...], arg(metavar="CASE ...")] = ()
    """Recordings that the twin is fitted on and taken as adequate for. Default: the training frames of CASE."""
    preset: str = "quick"
    """How much work: quick or full."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""
    quiet: bool = False
    """Say nothing on standard error of how far it is."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("results/diagnosis")
    """Folder for diagnosis.json and report.html."""

    def __call__(self) -> int:
        from ...diagnosis.diagnose import diagnose
        from ...diagnosis.page.words import headline, improvement
        from ..opening import open_scenario

        known("preset", [self.preset], PRESETS)
        known("device", [self.device], DEVICES)
        case = open_scenario(self.case)
        transfer, fitted_on = ([open_scenario(path) for path in paths] for paths in (self.transfer, self.fitted_on))
        folder = writable(self.out)

        def say(said: str) -> None:
            if not self.quiet:
                print(f"{shown(said)} ...", file=sys.stderr, flush=True)

        found = diagnose(case, transfer=transfer, fitted_on=fitted_on, preset=self.preset, device=self.device, progress=say)
        found.write(folder)
        for line in filter(None, (headline(found.result), improvement(found.result), found.result["experiment"])):
            print(shown(line))
        print(f"Written to {shown(str(folder))}: diagnosis.json, report.html")
        return 0
