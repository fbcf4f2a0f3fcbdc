"""A collection is what a folder of recordings offers to the benchmark: scenarios by name, in-domain tasks and transfer pairs.

A data set is one file in this folder that holds a ``LAYOUT``: an object with a ``name``, ``matches(path)`` and ``open(path, **options)``;
or what the entry points ``twinbench.datasets`` of an installed package name, see ``plugins.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from ..spelling import nearest
from .findings import collected, refuse
from .plausible import plausible
from .plugins import Kind, Origin, discover, said, warn
from .scenario import Scenario, TransferPair

__all__ = ["Collection", "Layout", "Unrecognised", "layouts", "open_collection", "recognises"]


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
        with _as_input(f"scenario {name} of {self.name}"):
            scenario = self.scenarios[name]()
        if not isinstance(scenario, Scenario):
            raise ValueError(f"scenario {name} of {self.name} must be read as a Scenario, got {type(scenario).__name__}")
        where = f" (scenario {name} of {self.name})"
        found, _ = collected(plausible(vars(scenario)))
        refuse(found, where=where)
        for doubt in (finding for finding in found if finding.field == "gravity"):  # with a wrong one every result is wrong
            warn(f"{doubt.said}{where}")
        return scenario


@contextmanager
def _as_input(what: str) -> Iterator[None]:
    """Whatever else a reader raises, such as a KeyError, is a ValueError that says what could not be read."""
    try:
        yield
    except (ValueError, OSError, ImportError):  # which say it themselves
        raise
    except Exception as error:
        raise ValueError(f"{what} cannot be read: {said(error)}") from error


@runtime_checkable
class Layout(Protocol):
    """How the recordings of one source lie on disk."""

    name: str

    def matches(self, path: Path) -> bool:
        """Whether ``path`` looks like this layout. Cheap, never raises."""
        ...

    def open(self, path: Path, *, split: str = "published") -> Collection:
        """The collection at ``path``. ``split`` is "published" or "clean" (no session on both sides)."""
        ...


def _accept(layout: Layout, origin: Origin, known) -> Layout:
    for call in ("matches", "open"):
        if not callable(getattr(layout, call)):
            raise ValueError(f"{call} must be a function, got {getattr(layout, call)!r}")
    return layout


KIND = Kind("layout", "twinbench.datasets", ("datasets",), ("LAYOUT", "LAYOUTS"), Layout, _accept, made=True)


def layouts() -> dict[str, Layout]:
    """Every layout by name: ours, then those of other packages."""
    return dict(discover(KIND).things)


def recognises(layout: Layout, path: Path) -> bool:
    """Whether ``layout`` matches ``path``; one that raises does not, and that is said once."""
    try:
        return bool(layout.matches(path))
    except Exception as error:
        warn(f"layout {layout.name!r} is passed over for {path}: matches() must not raise, but did: {said(error)}")
        return False


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
        if recognises(layout, path):
            with _as_input(f"{path}, which layout {layout.name!r} recognises,"):
                found = layout.open(path, split=split)
            if not isinstance(found, Collection):
                raise ValueError(f"{path}: layout {layout.name!r} must open it as a Collection, got {type(found).__name__}")
            return found
    inside = [f.name for f in sorted(path.iterdir()) if any(recognises(layout, f) for layout in known.values())] if path.is_dir() else []
    hint = f"; but one recognises {', '.join(inside[:8])} in it" if inside else ""
    raise Unrecognised(f"no recordings at {path}: none of the layouts {', '.join(known)} recognises it{hint}")
