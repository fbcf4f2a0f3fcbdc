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
    terms: bool = False
    """Also list the terms of the simulator. Those of other packages are listed in any case."""

    def __call__(self) -> int:
        from ...datasets.collection import KIND as LAYOUTS
        from ...datasets.collection import layouts
        from ...datasets.plugins import discover, offered
        from ...methods.registry import KIND as METHODS
        from ...methods.registry import methods
        from ...metrics.base import KIND as METRICS
        from ..ablations import ABLATIONS
        from ..cache import Cache, default_cache
        from ..opening import open_recordings
        from ..plan import TASKS

        known("split", [self.split], SPLITS)
        metrics = chosen_metrics().values()
        _found(METHODS, {name: first_line(method) for name, method in methods().items()})
        _found(METRICS, {m.name: f"{first_line(type(m))} {m.direction.capitalize()} is better." for m in metrics})
        _section("tasks", TASKS)
        _section("ablations", {name: found.says for name, found in ABLATIONS.items()})
        _found(LAYOUTS, {name: first_line(type(layout)) for name, layout in layouts().items()})
        if self.terms or offered("twinbench.terms"):  # they need the engine
            from ...physics.catalogue import KIND, terms

            _found(KIND, {name: first_line(term) for name, term in terms().items() if self.terms or discover(KIND).origins[name].package})
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


def _found(kind, entries) -> None:
    """What was found of a kind, with name and version of the package that brings it."""
    from ...datasets.plugins import discover

    origins = discover(kind).origins
    brought = {name: origins[name].package if name in origins else "" for name in entries}
    _section(f"{kind.noun}s", {name: f"{text} ({brought[name]})" if brought[name] else text for name, text in entries.items()})


def _section(title: str, entries) -> None:
    print(f"{title}:")
    width = max((len(name) for name in entries), default=0)
    for name, text in entries.items():
        print(f"  {name.ljust(width)}  {text}".rstrip())
    print()
