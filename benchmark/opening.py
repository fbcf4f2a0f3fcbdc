"""Opens recordings for a run, and remembers what a folder offers so that a repeated run need not read it.

A folder is known by its listing (names, sizes and times of change of all files): touching a file costs a second look, never a wrong
answer.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache as once
from functools import partial
from itertools import count, islice
from pathlib import Path

from ..datasets import collection as collections
from ..datasets.collection import Collection, TransferPair, Unrecognised, layouts, open_collection, recognises
from ..datasets.scenario import Scenario
from ..methods.modules import modules_of
from .cache import Cache, digest
from .origin import Origin
from .sources import SOURCES
from .text import check_name

__all__ = ["Opened", "description_origin", "folder_of", "listing", "open_all", "open_recordings", "open_scenario"]

MOST_FILES = 10**6  # the published recordings with all that is made from them are some 200,000
LEVELS = 4  # a recording's name may be so deep below its folder


@dataclass(frozen=True)
class Opened:
    """A collection, ``key`` of its files' listing (None where it has no files), and the reader's ``note`` on what it used of them.

    ``path`` is where another process finds it, "" where none can.
    """

    collection: Collection
    key: str | None = None
    note: str = ""
    split: str = "published"
    path: str = ""

    def called(self, name: str) -> Opened:
        """The same under another name."""
        return replace(self, collection=replace(self.collection, name=name))


def folder_of(path: str) -> Path:
    """The folder at ``path``, or that of the recordings that ship with twinbench by the name "sample"."""
    return Path(collections.__file__).parent / "sample" if str(path) == "sample" else Path(path)


def listing(folder: Path) -> str:
    """Hexadecimal SHA-256 of the names, sizes and times of change of all files at or below ``folder``, hidden ones left out.

    Raises ValueError where there are more than ``MOST_FILES``.
    """
    folder = Path(folder).resolve()
    found = list(islice(_files(folder), MOST_FILES + 1))
    if len(found) > MOST_FILES:
        raise ValueError(f"{folder}: recordings must have at most {MOST_FILES} files in all, got more: name a folder further down")
    seen = [(str(file), (stat := file.stat()).st_size, stat.st_mtime_ns, stat.st_ctime_ns) for file in sorted(found)]
    return digest(str(folder), seen)


def _files(folder: Path) -> Iterator[Path]:
    if folder.is_file():
        yield folder
    visited = {str(parent) for parent in folder.parents}  # whoever links back up does not mean all that is there
    for root, folders, names in os.walk(folder, followlinks=True):
        if (real := os.path.realpath(root)) in visited:
            folders.clear()
            continue
        visited.add(real)
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (file for name in names if not name.startswith(".") and (file := Path(root) / name).is_file())


def open_recordings(path: str, *, split: str, cache: Cache) -> Opened:
    """The recordings at ``path`` (or "sample"). A folder that was opened before is described from ``cache`` and read when first needed.

    Raises ValueError where nothing is there, no reader recognises it, or a name in it cannot be shown.
    """
    check_name(str(path), where="--data")
    folder = folder_of(path)
    if not folder.exists():
        raise ValueError(f"no recordings at {folder}: no such file or folder")
    read = once(lambda: open_collection(path, split=split))
    origin = description_origin(folder, split)
    known = cache.read("collections", origin.key)
    if known is None:
        known = _description(read())
        cache.write("collections", origin.key, known, origin.made)
    remembered = Collection(
        name=known["name"],
        scenarios={name: partial(lambda name: read().load(name), name) for name in known["scenarios"]},
        in_domain=tuple(known["in_domain"]),
        pairs=tuple(TransferPair(tuple(sources), target) for sources, target in known["pairs"]),
        published={tuple(figure): value for *figure, value in known["published"]},
        citation=known["citation"],
    )
    for name in (remembered.name, *remembered.scenarios):
        check_name(name, where=str(path))
    return Opened(remembered, origin.key, known["note"], split, str(path))


def description_origin(folder: Path, split: str) -> Origin:
    """What the description of a folder is made from: its listing, and the code of the layout that recognises it."""
    folder = Path(folder).resolve()
    layout = next((layout for layout in layouts().values() if recognises(layout, folder)), None)
    modules = modules_of(layout) if layout else (collections.__name__,)
    inputs = {"listing": listing(folder), "split": split, "code": SOURCES.files(*modules)}
    return Origin(inputs, {"folder": str(folder), "modules": list(modules)})


def open_all(paths: Iterable[str], *, split: str, cache: Cache) -> list[Opened]:
    """The recordings at each of ``paths``; a folder that is named twice is opened once. Collections of one name are told apart by where
    their paths differ.

    Raises ValueError as ``open_recordings`` does.
    """
    found: dict[Path, Opened] = {}
    for path in paths:
        if (folder := folder_of(path).resolve()) not in found:
            found[folder] = open_recordings(path, split=split, cache=cache)
    alike: dict[str, list[Path]] = {}
    for folder, opened in found.items():
        alike.setdefault(opened.collection.name, []).append(folder)
    for name, group in alike.items():
        for folder, place in zip(group, _places(group), strict=True) if len(group) > 1 else ():
            found[folder] = found[folder].called(f"{name} ({place})")
    return list(found.values())


def _places(folders: Sequence[Path]) -> list[str]:
    """The shortest parts of these paths that tell them apart, without the end that all share."""
    parts = [folder.parts for folder in folders]
    while len({path[-1:] for path in parts}) == 1:
        parts = [path[:-1] for path in parts]
    depth = next(depth for depth in count(1) if len({path[-depth:] for path in parts}) == len(parts))
    return ["/".join(path[-depth:]).lstrip("/") or "/" for path in parts]


def _description(collection: Collection) -> dict:
    return {
        "name": collection.name,
        "scenarios": list(collection.scenarios),
        "in_domain": list(collection.in_domain),
        "pairs": [[list(pair.sources), pair.target] for pair in collection.pairs],
        "published": [[*figure, value] for figure, value in collection.published.items()],
        "citation": collection.citation,
        "note": getattr(collection, "note", ""),
    }


def open_scenario(path: str) -> Scenario:
    """The recording at ``path``: a folder that holds one, or FOLDER/NAME for one of several.

    Raises ValueError naming the recordings that are there where ``path`` names none of them.
    """
    parts, wrong = Path(path).parts, None
    for split in range(len(parts), max(0, len(parts) - LEVELS), -1):
        start, name = str(Path(*parts[:split])), "/".join(parts[split:])
        folder = folder_of(start)
        if not folder.exists() or folder == Path(folder.anchor):
            continue
        try:
            collection = open_collection(start)
        except ValueError as error:
            if wrong is None or not isinstance(error, Unrecognised):
                wrong = ValueError(f"no recording at {path}: {error}") if name else error
            if not isinstance(error, Unrecognised):  # it should be here, and cannot be read
                break
            continue
        known = list(collection.scenarios)
        if name in known or (not name and len(known) == 1):
            return collection.load(name or known[0])
        shown = ", ".join(known[:5]) + (", ..." if len(known) > 5 else "")
        wrong = ValueError(
            f"{start} holds {len(known)} recordings ({shown})" + (f", and none named {name!r}" if name else f"; name one: {start}/NAME")
        )
        break
    raise wrong or ValueError(f"no recording at {path}: no such file or folder")
