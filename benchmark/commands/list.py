"""``twinbench list``: what there is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from ..options import SPLITS, chosen_metrics, first_line, known
from ..text import shown

__all__ = ["List"]


@dataclass(frozen=True)
class List:
    """List methods, metrics, tasks, layouts, and the recordings at hand."""

    data: Annotated[tuple[str, ...], arg(metavar="PATH ...")] = ("sample",)
    """Recordings to list."""
    split: str = "published"
    """published or clean."""

    def __call__(self) -> int:
        from ...datasets.collection import layouts
        from ...methods.registry import methods
        from ..ablations import ABLATIONS
        from ..cache import Cache, default_cache
        from ..opening import open_recordings
        from ..plan import TASKS

        known("split", [self.split], SPLITS)
        metrics = chosen_metrics().values()
        _section("methods", {name: first_line(method) for name, method in methods().items()})
        _section("metrics", {m.name: f"{first_line(type(m))} {m.direction.capitalize()} is better." for m in metrics})
        _section("tasks", TASKS)
        _section("ablations", {name: found.says for name, found in ABLATIONS.items()})
        _section("layouts", {name: first_line(type(layout)) for name, layout in layouts().items()})
        for path in self.data:
            collection = open_recordings(path, split=self.split, cache=Cache(default_cache())).collection
            _section(f"recordings of {collection.name} ({shown(path)})", {name: _roles(collection, name) for name in collection.scenarios})
        return 0


def _roles(collection, name: str) -> str:
    pairs = [pair.sources for pair in collection.pairs if pair.target == name]
    sources = [f"transfer from {'+'.join(found) if len(found) < 4 else f'{len(found)} recordings'}" for found in pairs]
    source_of = sum(name in pair.sources for pair in collection.pairs)
    in_domain = ["resimulation, prediction"] if name in collection.in_domain else []
    return "; ".join([*in_domain, *sources]) or (f"source of {source_of} transfer targets" if source_of else "not scored")


def _section(title: str, entries) -> None:
    print(f"{title}:")
    width = max((len(name) for name in entries), default=0)
    for name, text in entries.items():
        print(f"  {name.ljust(width)}  {text}".rstrip())
    print()
