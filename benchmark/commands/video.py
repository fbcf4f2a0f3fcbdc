"""``twinbench video``: what twins do beside what was recorded, as a film."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import PRESETS, Names, chosen_methods, known, usable, writable_file
from ..text import shown

__all__ = ["Video"]


@dataclass(frozen=True)
class Video:
    """Film roll-outs beside their recording, with lines to where points were seen: .mp4, .gif, or .html, a page that needs no network.

    Of a CASE twins are taken from the cache or fitted; of a RUN its rows are shown as they were scored, from the cache alone; of a
    DIAGNOSIS the twin without and with what was named.
    """

    what: Annotated[Positional[str], arg(metavar="CASE|RUN|DIAGNOSIS")]
    """A recording, as for twinbench diagnose; the folder of a run, or the one above it for the latest there; or that of a diagnosis."""
    out: Annotated[tuple[Path, ...], arg(metavar="FILE ...")]
    """What to write: files that end in .mp4, .gif or .html."""
    methods: Names = ()
    """Methods to show. Default: of a case phystwin, of a run all of its methods."""
    scenario: Annotated[str, arg(metavar="NAME")] = ""
    """Of a run or a diagnosis: the recording. Default: its first."""
    transfer: bool = False
    """Of a run: the twin that was brought over from another recording."""
    seed: int = 0
    """Seed of the fits."""
    preset: str = "quick"
    """Of a case: quick or full."""
    device: str = "cpu"
    """Of a case: cpu or cuda."""

    def __call__(self) -> int:
        from ..cache import Cache, default_cache
        from ..playground.diagnosed import is_diagnosis, of_diagnosis
        from ..playground.filming import KINDS, Film
        from ..playground.rows import of_case, of_run
        from ..progress import Bar

        known("preset", [self.preset], PRESETS)
        usable(self.device)
        for path in self.out:
            if path.suffix.lower() not in KINDS:
                raise ValueError(f"--out must end in {', '.join(KINDS)}, got {path}")
            writable_file(path)
        cache = Cache(default_cache())
        with Bar("video") as bar:
            if is_diagnosis(self.what):
                if self.methods or self.transfer:
                    raise ValueError(f"{self.what} is a diagnosis, which has its own twins: --methods and --transfer choose rows of a run")
                scenario, rollouts = of_diagnosis(self.what, self.scenario)
            elif (Path(self.what) / "rows.parquet").is_file() or (Path(self.what) / "latest").exists():
                scenario, rollouts = of_run(self.what, cache, self.scenario, self.methods, self.transfer, self.seed)
            else:
                if self.scenario or self.transfer:
                    raise ValueError(f"--scenario and --transfer choose a row of a run, and {self.what} is none")
                methods = chosen_methods(self.methods or ("phystwin",))
                scenario, rollouts = of_case(self.what, methods, cache, self.seed, self.preset, self.device, bar)
            film = Film(scenario, rollouts)
            for path in self.out:
                film.write(path, lambda share, path=path: bar(path.name, share))
        print(f"Written: {shown(', '.join(map(str, self.out)))}")
        return 0
