"""A collection is what a folder of recordings offers to the benchmark: scenarios by name, in-domain tasks and transfer pairs.

A data set is one file in this folder that holds a ``LAYOUT``: an object with a ``name``, ``matches(path)`` and ``open(path, **options)``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Protocol

from .findings import refuse
from .plausible import plausible
from .scenario import Scenario, TransferPair

__all__ = ["Collection", "Layout", "Unrecognised", "layouts", "nearest", "open_collection"]


@dataclass(frozen=True)
class Collection:
    """Recordings that are scored together.

    scenarios   name -> function that reads it (nothing is read before it is asked for)
    in_domain   scenarios that are fitted on their train frames and scored on both ranges
    pairs       twins fitted on some recordings, scored on the whole of another
    published   {(task, method, metric): value in the metric's unit} to print beside ours
    citation    whom to cite
    """

    name: str
    scenarios: Mapping[str, Callable[[], Scenario]]
    in_domain: tuple[str, ...] = ()
    pairs: tuple[TransferPair, ...] = ()
    published: Mapping[tuple[str, str, str], float] = field(default_factory=dict)
    citation: str = ""

    def __post_init__(self):
        named = {*self.in_domain, *(p.target for p in self.pairs), *(s for p in self.pairs for s in p.sources)}
        for name in sorted(named - set(self.scenarios)):
            raise ValueError(f"collection {self.name}: {name} is scored but is not among its scenarios")

    def load(self, name: str) -> Scenario:
        """Read one scenario. Raises ValueError with the nearest name for an unknown one, and where its fields cannot belong together."""
        if name not in self.scenarios:
            raise ValueError(f"unknown scenario {name!r} in {self.name}; {nearest(name, self.scenarios)}")
        scenario = self.scenarios[name]()
        refuse(plausible(vars(scenario)), where=f" (scenario {name} of {self.name})")
        return scenario


class Layout(Protocol):
    """How the recordings of one source lie on disk."""

    name: str

    def matches(self, path: Path) -> bool:
        """Whether ``path`` looks like this layout. Cheap, never raises."""
        ...

    def open(self, path: Path, *, split: str = "published") -> Collection:
        """The collection at ``path``. ``split`` is "published" or "clean" (no session on both sides)."""
        ...


def layouts() -> dict[str, Layout]:
    """Every layout found in this folder, by name."""
    found = {}
    for file in sorted(Path(__file__).parent.glob("*.py")):
        if "LAYOUT" in file.read_text(encoding="utf-8"):
            layout = getattr(import_module(f".{file.stem}", __package__), "LAYOUT", None)
            if layout is not None:
                found[layout.name] = layout
    return found


class Unrecognised(ValueError):
    """Something is there, and no layout knows it."""


def open_collection(path: str | Path, *, split: str = "published") -> Collection:
    """Open the recordings at ``path``, or the shipped ones by the name ``"sample"``.

    Raises ValueError where nothing is there, Unrecognised where no layout recognises it.
    """
    if split not in ("published", "clean"):
        raise ValueError(f"split must be 'published' or 'clean', got {split!r}")
    if str(path) == "sample":
        path = Path(__file__).parent / "sample"
    path = Path(path)
    if not path.exists():
        raise ValueError(f"no recordings at {path}: no such file or folder")
    known = layouts()
    for layout in known.values():
        if layout.matches(path):
            return layout.open(path, split=split)
    inside = [f.name for f in sorted(path.iterdir()) if any(layout.matches(f) for layout in known.values())] if path.is_dir() else []
    hint = f"; but one recognises {', '.join(inside[:8])} in it" if inside else ""
    raise Unrecognised(f"no recordings at {path}: none of the layouts {', '.join(known)} recognises it{hint}")


def nearest(name: str, known) -> str:
    """'did you mean ...? known: ...' for an unknown ``name``."""
    from difflib import get_close_matches

    known = [str(k) for k in known]
    close = get_close_matches(str(name), known, n=1, cutoff=0.5)
    shown = ", ".join(known[:30]) + (f" and {len(known) - 30} more" if len(known) > 30 else "")
    return (f"did you mean {close[0]!r}? " if close else "") + f"known: {shown}"
