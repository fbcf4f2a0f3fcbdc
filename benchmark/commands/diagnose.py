"""``twinbench diagnose``: which physics a twin lacks."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..cluster_options import OnCluster
from ..options import PRESETS, known, usable, writable
from ..text import shown

__all__ = ["Diagnose"]


@dataclass(frozen=True)
class Diagnose(OnCluster):
    """Say which physics recordings show and a twin lacks: where, since when, how much it matters; or that nothing is missing.

    A recording is a folder in a known layout (see twinbench list), with /NAME behind it where the folder holds several.
    """

    cases: Annotated[Positional[tuple[str, ...]], arg(metavar="CASE [CASE ...]")]
    """The recording, or several of one object that are fitted jointly; with --each, any recordings, or folders of several. Their held-out
    frames are never fitted."""
    each: bool = False
    """Diagnose every recording by itself, into DIR/NAME of --out. Diagnoses that are there, with the same options, are kept."""
    jobs: int | None = None
    """With --each: recordings that are diagnosed at the same time. Default: one; on a cluster, as many as it allows."""
    transfer: Annotated[tuple[str, ...], arg(metavar="CASE ...")] = ()
    """Other interactions with the same object. They are never fitted."""
    fitted_on: Annotated[tuple[str, ...], arg(metavar="CASE ...")] = ()
    """Recordings in which nothing is missing: all of their frames are fitted beside the training frames of CASE, and effects are asked in
    CASE alone. Springs, and a continuum of markers, are fitted to these recordings only."""
    against: Annotated[tuple[str, ...], arg(metavar="CASE ...")] = ()
    """Sound recordings of the same command as CASE: how far it differs from them is asked (--twin continuum)."""
    twin: str = "auto"
    """Which twin is questioned: continuum, with sound twins beside it as a measure; springs, a coarse net as PhysTwin's; or auto: continuum
    for a body that is tracked all over, for one cable with markers that stands alone, for several recordings and with --against; else
    springs. Beside eight recordings or more of --fitted-on a continuum can be asked of markers as well, of one recording or several."""
    preset: str = "quick"
    """How much work: quick or full."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""
    quiet: bool = False
    """Say nothing on standard error of how far it is."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("results/diagnosis")
    """Folder for diagnosis.json, report.html and what twinbench video and twinbench play show of them."""

    @property
    def goes_on(self) -> bool:
        """Whether the same command goes on from where it was stopped: of one diagnosis nothing is kept before its end."""
        return self.each

    def __call__(self) -> int:
        from ...diagnosis.diagnose import TWINS, diagnose
        from ...diagnosis.page.words import headline, improvement
        from ..opening import open_scenario

        known("twin", [self.twin], TWINS)
        known("preset", [self.preset], PRESETS)
        usable(self.device, self.executor)
        if self.each:
            return self._each()
        if (given := self.jobs and "--jobs") or (given := self.on_cluster() and f"--executor {self.executor}"):
            raise ValueError(f"{given} needs --each: one diagnosis is the work of one process")
        cases = [open_scenario(path) for path in self.cases]
        groups = dict(transfer=self.transfer, fitted_on=self.fitted_on, against=self.against)
        others = {name: [open_scenario(path) for path in paths] for name, paths in groups.items()}
        folder = writable(self.out)

        def say(said: str) -> None:
            if not self.quiet:
                print(f"{shown(said)} ...", file=sys.stderr, flush=True)

        told: dict[str, Any] = dict(twin=self.twin, **others, preset=self.preset, device=self.device)
        found = diagnose(cases[0] if len(cases) == 1 else cases, **told, progress=say)
        found.write(folder)
        for line in filter(None, (headline(found.result), improvement(found.result), found.result["experiment"])):
            print(shown(line))
        twins = ", twins" if (folder / "twins" / "baseline").is_dir() else ""
        print(f"Written to {shown(str(folder))}: diagnosis.json, report.html, tracks.npz{twins}")
        return 0

    def _each(self) -> int:
        from ...diagnosis.page.words import headline
        from ..diagnosing import diagnose_each, recordings_of
        from ..executors import chosen_executor

        for name in ("transfer", "fitted_on", "against"):
            if getattr(self, name):
                raise ValueError(f"--{name.replace('_', '-')} belongs to one diagnosis; --each makes one of every recording")
        executor = self.on_cluster() or chosen_executor("local", jobs=self.jobs)
        recordings, failed = recordings_of(self.cases), 0
        how = {"twin": self.twin, "preset": self.preset, "device": self.device}
        for done, (name, found) in enumerate(diagnose_each(recordings, writable(self.out), executor, **how), 1):
            failed += isinstance(found, Exception)
            said = f"failed ({type(found).__name__}: {found})" if isinstance(found, BaseException) else headline(found)
            print(shown(f"{name}: {said}"), flush=True)
            if not self.quiet:
                print(f"{done} of {len(recordings)}", file=sys.stderr, flush=True)
        print(f"Written to {shown(str(self.out))}: {len(recordings) - failed} of {len(recordings)} diagnoses, NAME/diagnosis.json each")
        return 1 if failed else 0
