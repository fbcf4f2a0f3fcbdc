"""``twinbench cache list | explain | prune``: what is remembered, why something is computed again, and what nothing needs any more."""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import DEVICES, PRESETS, SPLITS, Names, chosen_methods, chosen_metrics, known

__all__ = ["COMMANDS"]


@dataclass(frozen=True)
class List:
    """List what is remembered in .cache/twinbench (or $TWINBENCH_CACHE): how much of each kind, and every fitted twin."""

    kinds: Names = ("fits",)
    """Entries of these kinds one by one: fits, rows, appearances, collections, checksums."""

    def __call__(self) -> int:
        from ..cache import KINDS, Cache, default_cache
        from ..explaining import ago, described, megabytes

        known("kind", self.kinds, KINDS)
        cache = Cache(default_cache())
        total = 0
        for kind in KINDS:
            entries = list(cache.entries(kind))
            total += (size := sum(entry.bytes for entry in entries))
            print(f"{kind:12} {len(entries):6} {megabytes(size):>12}")
            for entry in sorted(entries, key=lambda entry: (described(entry), -entry.stored)) if kind in self.kinds else ():
                inputs = (entry.made or {}).get("inputs", {})
                options = ", ".join(f"seed {inputs[name]}" if name == "seed" else inputs[name] for name in OPTIONS if name in inputs)
                print(f"  {entry.key[:12]}  {ago(entry.stored):>14} {megabytes(entry.bytes):>12}  {described(entry)} ({options})")
        print(f"{'together':12} {'':6} {megabytes(total):>12}  in {cache.root}")
        return 0


@dataclass(frozen=True)
class Explain:
    """Say what a run would take from the cache and what it would compute, and why: "phystwin on plush_lift: will be refitted because
    physics/forward.py changed". Nothing is fitted.
    """

    what: Annotated[Positional[str], arg(metavar="METHOD|KEY")]
    """A method (see twinbench list), or an entry's key (see twinbench cache list)."""
    data: Annotated[tuple[str, ...], arg(metavar="PATH ...")] = ("sample",)
    """Recordings, as of twinbench run; so are the other options."""
    scenarios: Names = ()
    """Only rows scored on these. Default: all."""
    metrics: Names = ()
    """Scores by these. Default: all."""
    seeds: Annotated[tuple[int, ...], arg(metavar="INT ...")] = (0,)
    """Seeds."""
    preset: str = "quick"
    """quick or full."""
    device: str = "cpu"
    """cpu or cuda."""
    split: str = "published"
    """published or clean."""

    def __call__(self) -> int:
        from ..cache import Cache, default_cache
        from ..experiment import Experiment
        from ..explaining import explain, explain_entry
        from ..opening import open_recordings
        from ..runner import Runner

        for option, value, choices in (("preset", self.preset, PRESETS), ("device", self.device, DEVICES), ("split", self.split, SPLITS)):
            known(option, [value], choices)
        cache = Cache(default_cache())
        if re.fullmatch("[0-9a-f]{6,64}", self.what):
            found = [entry for entry in cache.entries() if entry.key.startswith(self.what)]
            if not found:
                raise ValueError(f"{cache.root}: no entry whose key begins with {self.what}")
            print("\n\n".join("\n".join(explain_entry(cache, entry)) for entry in found))
            return 0
        experiment = Experiment(chosen_methods([self.what]), chosen_metrics(self.metrics))
        opened = [open_recordings(path, split=self.split, cache=cache) for path in self.data]
        known("scenario", self.scenarios, [name for one in opened for name in one.collection.scenarios])
        for one, fits in experiment.plan(opened, seeds=self.seeds, scenarios=self.scenarios):
            runner = Runner(one, experiment.settings(self.preset, self.device), cache)
            runner.learn(fits)
            for line in explain(runner, fits):
                print(line)
        return 0


@dataclass(frozen=True)
class Prune:
    """Remove what nothing would use any more: entries of code or recordings that changed or are gone, damaged ones, those of other
    versions, and what killed runs left. It asks nothing; what is removed costs only the time to compute it again.

    Entries of scripts and of plug-ins that are not installed here are kept, unless they are older than --older-than.
    """

    older_than: Annotated[float | None, arg(metavar="DAYS")] = None
    """Also remove whatever was stored more than so many days ago."""
    dry_run: bool = False
    """Remove nothing, only say what would be."""

    def __call__(self) -> int:
        from ..cache import Cache, default_cache
        from ..explaining import megabytes
        from ..upkeep import prune

        if self.older_than is not None and not self.older_than >= 0:
            raise ValueError(f"--older-than must be a number of days >= 0, got {self.older_than}")
        cache, found = Cache(default_cache()), defaultdict(list)
        for kind, size, why in prune(cache, older_than=self.older_than, dry_run=self.dry_run):
            found[kind, why].append(size)
        for (kind, why), sizes in found.items():
            print(f"{kind:12} {len(sizes):6} {megabytes(sum(sizes)):>12}  {why}")
        freed = sum(map(sum, found.values()))
        print(f"{'Would free' if self.dry_run else 'Freed'} {megabytes(freed)} in {cache.root}")
        return 0


OPTIONS = ("seed", "preset", "device", "split")
COMMANDS = {"list": List, "explain": Explain, "prune": Prune}
