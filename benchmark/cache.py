"""A content-addressed store for what is expensive: fitted twins and appearances (folders), scored rows and what was read (JSON).

Every entry appears under its final name in one rename, with a digest over its kind, its key and all that it holds: a run that is killed
leaves nothing half-written, and an entry that was damaged or edited later, copied from another key or kind, or written by another version
is recognised, not used and computed again. The digest holds no secret: who can write to the cache and computes it anew can store what they
like, so share a cache only with whom you would let run your benchmark. Entries are numbers and text; nothing in them is ever executed.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..datasets.temporary import locked, replacing, scratch, size, sweep

__all__ = ["FOLDERS", "KINDS", "Cache", "Entry", "default_cache", "digest", "replacing"]

FORMAT = 2  # of entries, and of what their values mean; another one's are not found
FOLDERS = ("fits", "appearances")
KINDS = (*FOLDERS, "rows", "collections", "checksums")
LARGEST = 1 << 28  # bytes of JSON that are read of an entry
_KEY = re.compile(r"[0-9a-f]{64}")


def default_cache() -> Path:
    """``$TWINBENCH_CACHE``, else ``.cache/twinbench`` in the working directory."""
    return Path(os.environ.get("TWINBENCH_CACHE") or Path(".cache") / "twinbench")


def digest(*parts) -> str:
    """Hexadecimal SHA-256 of JSON-able ``parts``: the name of an entry."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Entry:
    """One entry as it lies there. ``made`` is what it was made from (see ``origin``), None where nothing says so or it is damaged.

    stored    seconds since 1970 when it was
    sound     whether what describes it is as it was written; of a folder, the files in it are not looked at for this
    """

    kind: str
    key: str
    path: Path
    bytes: int
    stored: float
    made: dict | None
    sound: bool


class Cache:
    """Entries below ``root``, by kind (one of ``KINDS``) and key."""

    def __init__(self, root: Path):
        self.root = Path(root)
        if self.root.exists() and not self.root.is_dir():
            raise ValueError(f"{self.root}: the cache must be a folder, got a file; TWINBENCH_CACHE names another")

    def read(self, kind: str, key: str) -> dict | None:
        """The JSON entry, or None where there is none or it is damaged."""
        found = _open(self._file(kind, key), kind, key)
        return found and found["value"]

    def write(self, kind: str, key: str, value: dict, made: dict | None = None) -> None:
        """Store JSON-able ``value``, with what it was ``made`` from.

        Raises OSError where the disk refuses, and leaves nothing behind then.
        """
        file = self._file(kind, key)
        with replacing(file, through=self._temporary) as temporary:
            temporary.write_text(_sealed(kind, key, value, made), encoding="utf-8")
            if file.is_dir():
                self._discard(file)

    def read_folder(self, kind: str, key: str) -> tuple[Path, dict] | None:
        """The folder entry and its description, or None where there is none or any file of it is damaged."""
        folder = self.root / kind / key
        found = None if folder.is_symlink() else _open(folder / "entry.json", kind, key)
        try:
            if found and found["value"]["files"] == _hash_files(folder / "content"):
                return folder / "content", found["value"]["about"]
        except (OSError, ValueError, KeyError):
            pass
        return None

    def write_folder(self, kind: str, key: str, fill: Callable[[Path], None], about: dict, made: dict | None = None) -> None:
        """Store the folder that ``fill(folder)`` writes, described by JSON-able ``about``, with what it was ``made`` from.

        Replaces a damaged entry; of two runs that store the same, the first wins. Raises OSError where the disk refuses, and leaves nothing
        behind then.
        """
        final = self.root / kind / key
        with scratch(self._temporary, final) as temporary:
            new = temporary / "entry"
            (new / "content").mkdir(parents=True)
            fill(new / "content")
            value = {"about": about, "files": _hash_files(new / "content")}
            (new / "entry.json").write_text(_sealed(kind, key, value, made), encoding="utf-8")
            final.parent.mkdir(parents=True, exist_ok=True)
            with locked(final.parent):  # what is looked at is what is replaced: a reader may hold a sound entry that has just come
                if self.read_folder(kind, key) is None and not _renamed(new, final) and self.read_folder(kind, key) is None:
                    final.rename(temporary / "damaged")
                    new.rename(final)

    def sweep(self, *, dry: bool = False) -> list[tuple[Path, int]]:
        """Remove what killed runs left behind, unless ``dry``; what that is, and the bytes in each."""
        return sweep(self._temporary, dry=dry)

    def entries(self, *kinds: str) -> Iterator[Entry]:
        """What lies there, of these kinds or of all, the sound and the damaged."""
        for kind in kinds or KINDS:
            places = self.root.glob(f"{kind}/*" if kind in FOLDERS else f"{kind}/??/*.json")
            for path in sorted(place for place in places if _KEY.fullmatch(place.stem)):
                described = path / "entry.json" if kind in FOLDERS else path
                found = None if path.is_symlink() else _open(described, kind, path.stem)
                try:
                    stored = path.lstat().st_mtime
                except OSError:  # gone meanwhile
                    continue
                yield Entry(kind, path.stem, path, size(path), stored, found and found["made"], found is not None)

    def sound(self, entry: Entry) -> bool:
        """Whether an entry can be used, all files of it looked at."""
        return (self.read_folder if entry.kind in FOLDERS else self.read)(entry.kind, entry.key) is not None

    def drop(self, entry: Entry) -> None:
        """Remove an entry: at once for whoever looks for it, whatever becomes of this process."""
        self._discard(entry.path)

    def _discard(self, path: Path) -> None:
        with scratch(self._temporary, path) as temporary, suppress(FileNotFoundError):
            path.rename(temporary / "dropped")

    @property
    def _temporary(self) -> Path:
        return self.root / "tmp"

    def _file(self, kind: str, key: str) -> Path:
        return self.root / kind / key[:2] / f"{key}.json"


def _renamed(new: Path, final: Path) -> bool:
    """Whether the folder ``new`` is ``final`` now; not where something is there: on disks without locks, another node may be first."""
    try:
        new.rename(final)
    except OSError:
        if os.path.lexists(final):
            return False
        raise
    return True


def _sealed(kind: str, key: str, value: dict, made: dict | None) -> str:
    return json.dumps({"digest": digest(FORMAT, kind, key, made, value), "made": made, "value": value})


def _open(file: Path, kind: str, key: str) -> dict | None:
    """What was stored under this kind and key, ``made`` and ``value``; None where it is anything else."""
    try:
        about = file.lstat()
        if not stat.S_ISREG(about.st_mode) or about.st_size > LARGEST:
            return None
        entry = json.loads(file.read_text(encoding="utf-8"))
        made, value = entry["made"], entry["value"]
        right = entry["digest"] == digest(FORMAT, kind, key, made, value) and isinstance(value, dict)
        right = right and (made is None or (digest(made["inputs"]) == key and isinstance(made["subject"], dict)))
        return {"made": made, "value": value} if right else None
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None


def _hash_files(folder: Path) -> dict[str, str]:
    """SHA-256 by path of all files below ``folder``, "" of all folders. Raises ValueError where anything else is among them, as a link."""
    found, pending = {}, [folder]
    for item in pending:
        kind, name = item.lstat().st_mode, item.relative_to(folder).as_posix()
        if stat.S_ISDIR(kind):
            found[name] = ""
            pending += sorted(item.iterdir())
        elif stat.S_ISREG(kind):
            found[name] = hashlib.sha256(item.read_bytes()).hexdigest()
        else:
            raise ValueError(f"{item} is neither a file nor a folder")
    return found
