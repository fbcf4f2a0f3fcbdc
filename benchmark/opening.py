"""Opens recordings for a run, and remembers what a folder offers so that a repeated run need not read it.

A folder is known by its listing (names, sizes and times of change of all files): touching a file costs a second look, never a wrong
answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache as once
from functools import partial
from pathlib import Path

from ..datasets import collection as collections
from ..datasets.collection import Collection, TransferPair, open_collection
from .cache import Cache, digest
from .checksum import code

__all__ = ["Opened", "listing", "open_recordings"]


@dataclass(frozen=True)
class Opened:
    """A collection, ``key`` of its files' listing (None where it has no files), and the reader's ``note`` on what it used of them."""

    collection: Collection
    key: str | None = None
    note: str = ""
    split: str = "published"


def listing(folder: Path) -> str:
    """Hexadecimal SHA-256 of the names, sizes and times of change of all files at or below ``folder``."""
    folder = Path(folder).resolve()
    files = sorted(folder.rglob("*")) if folder.is_dir() else [folder]
    seen = [(str(file), (stat := file.stat()).st_size, stat.st_mtime_ns, stat.st_ctime_ns) for file in files if file.is_file()]
    return digest(str(folder), seen)


def open_recordings(path: str, *, split: str, cache: Cache) -> Opened:
    """The recordings at ``path`` (or "sample"). A folder that was opened before is described from ``cache`` and read when first needed.

    Raises ValueError where nothing is there, or no reader recognises it.
    """
    folder = Path(collections.__file__).parent / "sample" if path == "sample" else Path(path)
    if not folder.exists():
        raise ValueError(f"no recordings at {folder}: no such file or folder")
    read = once(lambda: open_collection(path, split=split))
    key = digest(listing(folder), split, code("datasets"))
    known = cache.read("collections", key)
    if known is None:
        known = _description(read())
        cache.write("collections", key, known)
    remembered = Collection(
        name=known["name"],
        scenarios={name: partial(lambda name: read().load(name), name) for name in known["scenarios"]},
        in_domain=tuple(known["in_domain"]),
        pairs=tuple(TransferPair(tuple(sources), target) for sources, target in known["pairs"]),
        published={tuple(figure): value for *figure, value in known["published"]},
        citation=known["citation"],
    )
    return Opened(remembered, key, known["note"], split)


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
