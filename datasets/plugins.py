"""Finding what can be plugged in: methods, metrics, data sets (layouts) and terms, ours and those that other packages bring.

Ours are files in the folders of their kind. Those of an installed package are its entry points in the kind's group (``twinbench.methods``,
``.metrics``, ``.datasets``, ``.terms``). An entry point names one object, a tuple of them, or a module; a module, ours too, lists them
under one of the kind's names: METHODS, METRICS, LAYOUTS or TERMS, also in the singular for one of them. What an entry point is called does
not matter: everything has a ``name`` of its own.

Whatever is wrong with a plug-in, it alone is left out: one line in the log says which one and why, and so does asking for it by name.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoints, distributions
from inspect import isclass, ismodule
from pathlib import Path
from typing import Any

from ..spelling import nearest

__all__ = ["Broken", "Discovery", "Kind", "Origin", "discover", "offered", "one_line", "said", "unknown", "warn"]

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,63}")  # columns, file names and options are made of it
LONGEST = 400  # characters of a message
_PACKAGE, _ROOT = str(__package__).rpartition(".")[0], Path(__file__).parents[1]
_left_out: list[Broken] = []


@dataclass(frozen=True)
class Origin:
    """Where a plug-in comes from: ``place`` is a file of this package, or an entry point of an installed ``distribution``."""

    place: str
    distribution: str = ""
    version: str = ""

    def __str__(self):
        return f"{self.distribution} {self.version}, entry point {self.place}" if self.distribution else self.place

    @property
    def package(self) -> str:
        """Name and version of the package that brings it; "" of ours."""
        return f"{self.distribution} {self.version}".strip()


@dataclass(frozen=True)
class Kind:
    """What can be plugged in.

    noun      what it is called
    group     the group of entry points
    rooms     folders of this package that it stands in
    listed    names under which a module lists what it has
    base      what all of them are: subclasses, or where they are ``made``, instances (of a class that is listed, one is made)
    accept    ``accept(thing, origin, known)``: what is kept of it, beside those known by name; raises ValueError
    gathered  whether a module that lists nothing has all subclasses of ``base`` that are defined there
    """

    noun: str
    group: str
    rooms: tuple[str, ...]
    listed: tuple[str, ...]
    base: type
    accept: Callable[[Any, Origin, Mapping[str, Any]], Any]
    made: bool = False
    gathered: bool = False


@dataclass(frozen=True)
class Broken:
    """A plug-in that is left out: of which kind, under which names one may ask for it, where it comes from, and why."""

    noun: str
    names: tuple[str, ...]
    origin: Origin
    why: str

    def __str__(self):
        return f"{self.noun} {self.names[-1]!r} ({self.origin}) is left out: {self.why}"


@dataclass(frozen=True)
class Discovery:
    """Everything of a kind by name, and where each comes from."""

    things: Mapping[str, Any]
    origins: Mapping[str, Origin]


@cache
def discover(kind: Kind) -> Discovery:
    """All of a kind: ours, then those of other packages in the order of the packages' names; looked up once a process.

    Of two with one name the first is kept.
    """
    things, origins, offers = {}, {}, []
    for names, origin, load in (*_own(kind), *_installed(kind)):
        listed = []
        with _leaving_out(kind, list(names), origin):
            listed = _listed(kind, load(), needed=bool(origin.distribution))
        for offer in listed:
            if any(offer is other for other in offers):  # listed twice
                continue
            with _leaving_out(kind, asked := list(names), origin):
                thing = _thing(kind, offer)
                name = _name(thing)
                asked.append(name)
                if name in things:
                    raise ValueError(f"there is another {kind.noun} of that name ({origins[name]})")
                things[name] = kind.accept(thing, origin, dict(things))
                origins[name] = origin
                offers.append(offer)
    return Discovery(things, origins)


def _own(kind: Kind) -> Iterator[tuple]:
    """Files of this package that mention what they would list: the others need no import."""
    words = [word.encode() for word in (*kind.listed, *([kind.base.__name__] if kind.gathered else []))]
    for room in kind.rooms:
        folder = _ROOT / room
        for file in sorted(file for pattern in ("[!_.]*.py", "[!_.]*/__init__.py") for file in folder.glob(pattern) if file.is_file()):
            parts = file.relative_to(_ROOT).with_suffix("").parts
            module = ".".join((_PACKAGE, *(parts[:-1] if parts[-1] == "__init__" else parts)))
            origin = Origin(file.relative_to(_ROOT).as_posix())
            try:
                mentions = any(word in file.read_bytes() for word in words)
            except OSError:
                mentions = True  # importing it says what is wrong
            if mentions:
                yield (module.rpartition(".")[2],), origin, lambda module=module: import_module(module)


def _installed(kind: Kind) -> Iterator[tuple]:
    """Entry points of the kind's group."""
    for origin, entry_points in _packages():
        for entry in sorted(entry_points.select(group=kind.group)):
            place = f"{kind.group}: {entry.name}"
            yield (entry.name,), Origin(one_line(place), origin.distribution, origin.version), entry.load


def offered(group: str) -> bool:
    """Whether any installed package brings something of this group. Nothing is imported."""
    return any(entry_points.select(group=group) for _, entry_points in _packages())


@cache
def _packages() -> tuple[tuple[Origin, EntryPoints], ...]:
    """Installed distributions that bring something, by name; the first of a name on the path. Those that bring nothing are not parsed."""
    found = {}
    for distribution in distributions():
        try:
            if f"{_PACKAGE}." not in (distribution.read_text("entry_points.txt") or ""):
                continue
        except (OSError, ValueError):  # nobody knows whether it speaks of us
            continue
        place = one_line(getattr(distribution, "_path", distribution))
        try:
            name, version = distribution.metadata["Name"], distribution.metadata["Version"]
            if not (name and version):
                raise ValueError("METADATA must have a Name and a Version")
            origin = Origin(place, one_line(name), one_line(version))
            found.setdefault(re.sub(r"[-_.]+", "-", name).lower(), (origin, distribution.entry_points))
        except Exception as error:
            warn(f"the plug-ins of {place} are left out: {said(error)}")
    return tuple(found[name] for name in sorted(found))


def _listed(kind: Kind, offered, *, needed: bool) -> list:
    """What an entry point or a file offers, one by one. Raises ValueError where it is ``needed`` and nothing is there."""
    if not ismodule(offered):
        return list(offered) if isinstance(offered, tuple | list) else [offered]
    found = [_listed(kind, vars(offered)[name], needed=False) for name in kind.listed if name in vars(offered)]
    if not found and kind.gathered:
        own = (value for value in vars(offered).values() if isclass(value) and issubclass(value, kind.base) and value is not kind.base)
        found = [[value for value in own if f"{value.__module__}.".startswith(f"{offered.__name__}.")]]
    if needed and not any(found):
        raise ValueError(f"module {offered.__name__} holds no {' or '.join(kind.listed)}")
    return [one for several in found for one in several]


def _thing(kind: Kind, offer):
    """The class or instance that is offered. Raises ValueError where it is neither."""
    thing = offer() if kind.made and isclass(offer) else offer
    if not (isinstance(thing, kind.base) if kind.made else isclass(thing) and issubclass(thing, kind.base)):
        wanted = f"{'an instance' if kind.made else 'a subclass'} of {kind.base.__module__}.{kind.base.__qualname__}"
        raise ValueError(f"a {kind.noun} must be {wanted}, got {offer!r}")
    return thing


def _name(thing) -> str:
    name = getattr(thing, "name", None)
    if not (isinstance(name, str) and NAME.fullmatch(name)):
        raise ValueError(f"its name must be up to 64 of the characters A-Z a-z 0-9 _ . + -, got {name!r} (of {thing!r})")
    return name


@contextmanager
def _leaving_out(kind: Kind, names: list[str], origin: Origin) -> Iterator[None]:
    """Whatever is raised, SystemExit too for it is somebody else's code, leaves out what goes by ``names``, and no more."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        broken = Broken(kind.noun, tuple(one_line(name) for name in names), origin, said(error))
        _left_out.append(broken)
        warn(str(broken))


def unknown(noun: str, name: str, choices: Iterable[str]) -> ValueError:
    """The error of asking for a ``noun`` that is not among ``choices``: why it was left out, or else the nearest of them."""
    for broken in _left_out:
        if broken.noun == noun and name in broken.names:
            return ValueError(str(broken))
    return ValueError(f"unknown {noun} {name!r}; {nearest(name, choices)}")


@cache
def warn(text: str) -> None:
    """Say ``text`` once, in the log "twinbench", which goes to standard error where nobody has set up logging."""
    logging.getLogger(_PACKAGE).warning("%s: %s", _PACKAGE, one_line(text))


def said(error: BaseException) -> str:
    """What an exception of somebody else's code says, in one line: its type too, but of a ValueError, whose message is a sentence."""
    try:
        message = str(error)
    except Exception:
        message = ""
    named = type(error).__name__
    return one_line(message if message and type(error) is ValueError else f"{named}: {message}" if message else named)


def one_line(text) -> str:
    """``text`` in one line of printable characters, for terminals."""
    try:
        line = " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())
    except Exception:
        line = f"<{type(text).__name__}>"
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 4]} ..."
