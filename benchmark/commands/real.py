"""``twinbench real``: studies of real recordings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..options import known, usable, writable
from ..text import shown

__all__ = ["Real"]


@dataclass(frozen=True)
class Real:
    """Ask twins of real recordings which physics they lack, and score them with it on recordings that nobody fitted."""

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """cables: ropes held at both ends (DEFORM), extended term by term. hand, weight, gravity: something is kept from the twin. loads: free
    releases of a trunk with several loads; commands: what its motors do with several."""
    data: Annotated[Path, arg(metavar="PATH")] = Path("data_set")
    """Folder of the recordings: for cables data_set, for the others what holds data_set, dataset, softbeam and trunk."""
    seeds: Annotated[tuple[int, ...], arg(metavar="INT ...")] = (0, 1, 2)
    """Seeds; each draws other recordings to fit and other starts."""
    device: str = "cpu"
    """cpu or cuda."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("results/real")
    """Folder for the tables."""

    def __call__(self) -> int:
        from .. import real_cables, real_cases, real_commands, real_loads

        studies = {"cables": real_cables.run, "commands": real_commands.run, "loads": real_loads.run}
        studies |= dict.fromkeys(real_cases.CASES, partial(real_cases.run, self.study))
        known("study", [self.study], studies)
        usable(self.device)
        options: dict[str, Any] = {"seeds": self.seeds} if self.study == "cables" else {}
        studies[self.study](self.data, writable(self.out), device=self.device, **options)
        print(f"Written to {shown(str(self.out))}")
        return 0
