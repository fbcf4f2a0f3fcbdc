"""``twinbench play``: twins under one's hands, in a browser."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..options import PRESETS, Names, chosen_methods, known, usable, writable
from ..text import shown

__all__ = ["Play"]


@dataclass(frozen=True)
class Play:
    """Simulate twins live in a browser, under hands that are dragged: forces, colours, sliders, recordings beside them.

    Twins that twinbench run fitted are taken from the cache, others are fitted. Needs viser (the extra "view"). Ctrl-C ends it.
    """

    what: Annotated[Positional[str], arg(metavar="CASE|TWIN|DIAGNOSIS")]
    """A recording, as for twinbench diagnose; the folder of one saved twin, with its method in --methods; or the folder of a diagnosis:
    its twin without and with what was named."""
    methods: Names = ()
    """Methods whose twins stand side by side under the same hands. Default: phystwin; a diagnosis has its own."""
    case: Annotated[str, arg(metavar="CASE")] = ""
    """With TWIN: its recording, which tells hands that the twin does not know, and is shown beside it."""
    host: str = "127.0.0.1"
    """Where to listen. 0.0.0.0 lets everybody in who reaches this machine."""
    port: int = 8080
    """Where to listen."""
    gaussians: bool = False
    """Show what the recording looks like, by Gaussians that are fitted to its images in frame 0."""
    seed: int = 0
    """Seed of the fits."""
    preset: str = "quick"
    """quick or full."""
    device: str = "cpu"
    """cpu or cuda."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("played")
    """Folder for scenarios that are recorded on the page."""

    def __call__(self) -> int:
        from ..cache import Cache, default_cache
        from ..playground.casting import opened, stage_of
        from ..playground.diagnosed import is_diagnosis
        from ..playground.page import Page, free_port
        from ..playground.splats import Splats

        if is_diagnosis(self.what) and (self.methods or self.case):
            raise ValueError(f"{self.what} is a diagnosis, which has its own twins and recording: leave --methods and --case away")
        known("preset", [self.preset], PRESETS)
        usable(self.device)
        if not 1 <= self.port <= 65535:
            raise ValueError(f"--port must lie in [1, 65535], got {self.port}")
        writable(next(place for place in (self.out, *self.out.parents) if place.exists()))  # it is made for the first scenario
        methods = chosen_methods(self.methods or ("phystwin",))
        free_port(self.host, self.port)

        def say(said: str) -> None:
            print(f"{shown(said)} ...", file=sys.stderr, flush=True)

        asked: dict[str, Any] = dict(seed=self.seed, preset=self.preset, device=self.device, case=self.case, say=say)
        twins, scenario, made = opened(self.what, methods, Cache(default_cache()), **asked)
        stage = stage_of(twins, scenario)
        splats = {}
        if self.gaussians:
            if made is None or scenario is None:
                raise ValueError("--gaussians needs a CASE: a saved twin or a diagnosis has no images")
            for player in stage.players:
                say(f"{player.name}: Gaussians, fitted or taken from the cache")
                splats[player.name] = Splats(made.gaussians(scenario.name, player.name), player.live.positions)
        page = Page(stage, host=self.host, port=self.port, out=self.out, title=shown(f"{self.what}"), splats=splats)
        print(f"http://{self.host}:{self.port}  (Ctrl-C ends it)", flush=True)
        try:
            page.serve()
        finally:
            page.close()
        return 0
