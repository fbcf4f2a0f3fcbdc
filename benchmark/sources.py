"""The source code that something is made of: the modules that it imports, those that these import, and what they say.

Imports are read from the source, so that nothing need be imported to be known, those inside functions too. What is found by its name at run
time (methods, metrics, layouts) is no import: who asks for it names its modules. Followed are imports within twinbench, from a plug-in into
itself and into twinbench, and from a file of one's own into the files beside it; of an installed plug-in the version counts as well. Other
packages are not followed: a new torch fits nothing again.

What a file says is its syntax tree without docstrings: comments and white space change nothing. Files that are no Python count byte by
byte, where they lie beside a module that names them.
"""

from __future__ import annotations

import sys
import uuid
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.metadata import PackageNotFoundError, entry_points, packages_distributions, version
from importlib.util import find_spec
from pathlib import Path

from ..methods.modules import modules_of
from .scan import Import, Scan

__all__ = ["SOURCES", "Sources"]

PACKAGE = str(__package__).partition(".")[0]
# modules that look through a folder of the package at run time and use all that is there
ALL_OF = {"physics/catalogue.py": ("physics/terms", "twinbench.terms")}  # and the entry points of that group


@dataclass(frozen=True)
class Home:
    """Where the top-level package or module ``top`` lies: in ``folder``, or where it is twinbench, as ``folder``.

    ``distribution`` is the name and version of what installed it, if anything did.
    """

    top: str
    folder: Path
    distribution: tuple[str, str] | None = None

    def place(self, parts: Iterable[str]) -> Path:
        """The path of a module, without a suffix."""
        top, *rest = parts
        return self.folder.joinpath(*([] if top == PACKAGE else [top]), *rest)

    def label(self, file: Path) -> str:
        """What a file of it is called, wherever it is installed."""
        return file.relative_to(self.folder).as_posix()

    def module(self, folder: Path) -> str:
        """The name of the package in a folder."""
        return ".".join((*([PACKAGE] if self.top == PACKAGE else []), *folder.relative_to(self.folder).parts))

    def packages(self, file: Path) -> Iterator[Path]:
        """The ``__init__.py`` of the packages that a file lies in, which importing it runs."""
        for folder in file.parents:
            if folder == self.folder and self.top != PACKAGE:
                return
            if (found := folder / "__init__.py") != file and found.is_file():
                yield found
            if folder == self.folder:
                return


@dataclass(frozen=True)
class Reached:
    """A file that something is made of: as a ``whole``, or only what importing it runs."""

    home: Home
    file: Path
    whole: bool = True


class Sources:
    """Reads every file once: what a process runs is what it said when it was first asked, whoever edits it meanwhile.

    ``package`` is twinbench's folder.
    """

    def __init__(self, package: Path):
        self._own = Home(PACKAGE, package)
        self._scan, self._read = cache(Scan.of), cache(self._look)
        self.files = cache(self._files)

    def _files(self, *modules: str) -> dict[str, str]:
        """Digest by file of all that these modules are made of, and the versions of the plug-ins among them.

        What has no source that can be read is never the same twice.
        """
        found: dict[str, str] = {}
        starts = {module: self._start(module) for module in modules}
        pending, done = [start for start in starts.values() if start], set()
        while pending:
            if (one := pending.pop()) not in done:
                done.add(one)
                said, reached = self._read(one)
                found |= said
                pending += reached
        unknown = {module: f"unknown {uuid.uuid4().hex}" for module, start in starts.items() if start is None}
        return dict(sorted({**found, **unknown}.items()))

    def _look(self, one: Reached) -> tuple[dict[str, str], list[Reached]]:
        """What one file adds, and the files that it reaches."""
        home, scan = one.home, self._scan(one.file)
        said = {home.label(one.file): scan.digest} | {home.label(data): self._scan(data).digest for data in scan.data}
        said |= {f"package {name}": release for name, release in filter(None, [home.distribution])}
        reached = [Reached(home, package, False) for package in home.packages(one.file)]
        for imported in scan.imports:
            if one.whole or imported.at_once:
                reached += self._reached(one, imported)
        if home == self._own and (all_of := ALL_OF.get(home.label(one.file))):
            folder, group = all_of
            reached += [Reached(home, file) for file in sorted((home.folder / folder).glob("*.py"))]
            reached += filter(None, (self._start(entry.module) for entry in sorted(entry_points(group=group))))
        return said, reached

    def present(self, *modules: str) -> dict[str, str] | None:
        """The same of what an entry names; None where nobody can know: of scripts, and of plug-ins that are not installed here."""
        own = [module for module in modules if module.partition(".")[0] == PACKAGE]
        others = [module for module in modules if module not in own]
        if any(module in ("__main__", "__mp_main__") or self._start(module) is None for module in others):
            return None
        return self.files(*modules)

    def _start(self, module: str) -> Reached | None:
        """The file of a module that is named, wherever it was loaded from."""
        parts = module.split(".")
        if parts[0] == PACKAGE:
            home = self._own
        elif loaded := getattr(sys.modules.get(module), "__file__", None):
            file = Path(loaded).resolve()
            inside = file.parent if file.stem == "__init__" else file.with_name(file.name.partition(".")[0])
            if list(inside.parts[-len(parts) :]) != parts:  # a script, or loaded under a name of one's own
                return Reached(Home(inside.name, inside.parent), file)
            home = Home(parts[0], inside.parents[len(parts) - 1], _distribution(parts[0]))
        else:
            home = _installed(parts[0])
        file = home and _file(home.place(parts))
        return Reached(home, file) if home and file else None

    def _reached(self, by: Reached, imported: Import) -> Iterator[Reached]:
        """What an import reaches, where it is one that is followed."""
        if imported.level:
            home, folder = by.home, Path(*by.file.parts[: -imported.level])
            if not folder.is_relative_to(home.folder):
                return
            place = folder.joinpath(*imported.parts)
        else:
            home = self._followed(by.home, imported.parts[0])
            if home is None:
                return
            place = home.place(imported.parts)
        package = _file(place)
        for name in imported.names:
            if sub := _file(place / name):
                yield Reached(home, sub)
            elif package:
                yield Reached(home, package)
                yield from self._given(home, package, name)
        if package and not imported.names:
            yield Reached(home, package)

    def _given(self, home: Home, package: Path, name: str) -> Iterator[Reached]:
        """Where a name comes from that a package only gives when it is asked for it (PEP 562)."""
        bound = self._scan(package).bound
        if package.stem == "__init__" and name not in bound and "__getattr__" in bound:
            try:
                given = getattr(import_module(home.module(package.parent)), name)
            except Exception:  # whoever runs it will be told
                return
            yield from filter(None, map(self._start, modules_of(given)))

    def _followed(self, home: Home, top: str) -> Home | None:
        """The home of a top-level package or module, where what is at ``home`` is followed into it."""
        if top == PACKAGE:
            return self._own
        if top == home.top:
            return home
        if home == self._own:
            return None
        if home.distribution:
            return _installed(top) if _distribution(top) == home.distribution else None
        return Home(top, home.folder) if _file(home.folder / top) and not _distribution(top) else None


SOURCES = Sources(Path(__file__).resolve().parents[1])


@cache
def _installed(top: str) -> Home | None:
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return None
    places = [*((spec and spec.submodule_search_locations) or ()), *([spec.origin] if spec and spec.has_location else ())]
    return Home(top, Path(places[0]).resolve().parent, _distribution(top)) if places else None


@cache
def _distribution(top: str) -> tuple[str, str] | None:
    """Name and version of what installed a top-level package or module."""
    for name in _distributions().get(top, ()):
        with suppress(PackageNotFoundError):
            return name, version(name)
    return None


_distributions = cache(packages_distributions)


def _file(place: Path) -> Path | None:
    """The file of the module at a path without suffix."""
    for file in (place / "__init__.py", *(place.with_name(place.name + suffix) for suffix in (".py", *EXTENSION_SUFFIXES))):
        if file.is_file():
            return file
    return None
