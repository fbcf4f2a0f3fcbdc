"""``twinbench picture``: one recording, drawn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import DEVICES, PRESETS, SPLITS, Names, chosen_methods, chosen_metrics, known, writable_file
from ..text import shown

__all__ = ["Picture"]


@dataclass(frozen=True)
class Picture:
    """Draw one recording: where its points were, where each method's twin puts them, and the error over time.

    Twins that twinbench run fitted are taken from the cache, others are fitted. Needs matplotlib (the extra "plots").
    """

    scenario: Annotated[Positional[str], arg(metavar="[NAME]")] = ""
    """The recording to draw. Default: the first that is scored."""
    data: Annotated[str, arg(metavar="PATH")] = "sample"
    """Where it is, as for twinbench run."""
    methods: Names = ("static", "rigid", "phystwin")
    """Methods to draw."""
    metric: str = "chamfer"
    """The error to draw (see twinbench list)."""
    seed: int = 0
    """Seed of the fits."""
    preset: str = "quick"
    """quick or full."""
    device: str = "cpu"
    """cpu or cuda."""
    split: str = "published"
    """published or clean."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """Where to write it, a .png, .pdf or .svg. Default: results/RECORDINGS/NAME.png."""

    def __call__(self) -> int:
        from ..cache import Cache, default_cache
        from ..opening import open_recordings
        from ..picture import Player, draw, drawable
        from ..progress import Bar
        from ..runner import Settings

        for option, value, choices in (("preset", self.preset, PRESETS), ("device", self.device, DEVICES), ("split", self.split, SPLITS)):
            known(option, [value], choices)
        methods, metrics, cache = chosen_methods(self.methods), chosen_metrics(), Cache(default_cache())
        known("metric", [self.metric], metrics)
        opened = open_recordings(self.data, split=self.split, cache=cache)
        collection = opened.collection
        name = self.scenario or next(iter((*collection.in_domain, *(pair.target for pair in collection.pairs))), "")
        scenario, out = collection.load(name), self.out or Path("results") / collection.name / f"{name}.png"
        drawable(out)
        writable_file(out)
        with Bar(name) as bar:
            rollouts, fitted = Player(opened, Settings(methods, metrics, self.preset, self.device), cache).play_all(name, self.seed, bar)
        draw(scenario, rollouts, metrics[self.metric], out, fitted=fitted)
        print(f"Written to {shown(str(out))}")
        return 0
