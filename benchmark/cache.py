"""A content-addressed store for what is expensive: fitted twins (folders) and scored rows (JSON).

Every entry appears under its final name in one rename, with the digest of its content: a run that is killed leaves nothing
half-written, and an entry that was damaged later is recognised, dropped and computed again.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["Cache", "default_cache", "digest", "replacing"]


def default_cache() -> Path:
    """``$TWINBENCH_CACHE``, else ``.cache/twinbench`` in the working directory."""
    return Path(os.environ.get("TWINBENCH_CACHE") or Path(".cache") / "twinbench")


def digest(*parts) -> str:
    """Hexadecimal SHA-256 of JSON-able ``parts``: the name of an entry."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside ``path`` that takes its place in one rename, or is removed if anything goes wrong.

    Raises OSError naming ``path`` where the disk refuses.
    """
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    with _naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """A full disk does not say which file it was."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, f"{path} cannot be written ({error.strerror or error}); nothing of it was kept") from error


class Cache:
    """Entries below ``root``, by kind ("rows", "fits", "data") and key."""

    def __init__(self, root: Path):
        self.root = Path(root)

    def read(self, kind: str, key: str) -> dict | None:
        """The JSON entry, or None where there is none or it is damaged."""
        try:
            entry = json.loads(self._file(kind, key).read_text(encoding="utf-8"))
            return entry["value"] if entry["digest"] == digest(entry["value"]) else None
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def write(self, kind: str, key: str, value: dict) -> None:
        """Store JSON-able ``value``. Raises OSError where the disk refuses, and leaves nothing behind then."""
        with replacing(self._file(kind, key)) as temporary:
            temporary.write_text(json.dumps({"digest": digest(value), "value": value}), encoding="utf-8")

    def read_folder(self, kind: str, key: str) -> tuple[Path, dict] | None:
        """The folder entry and its description, or None where there is none or any file of it is damaged."""
        folder = self.root / kind / key
        try:
            entry = json.loads((folder / "entry.json").read_text(encoding="utf-8"))
            if entry["digest"] == digest(entry["value"]) and entry["value"]["files"] == _hash_files(folder / "content"):
                return folder / "content", entry["value"]["about"]
        except (OSError, ValueError, TypeError, KeyError):
            pass
        return None

    def write_folder(self, kind: str, key: str, fill: Callable[[Path], None], about: dict) -> None:
        """Store the folder that ``fill(folder)`` writes, described by JSON-able ``about``. Replaces a damaged entry.

        Raises OSError where the disk refuses, and leaves nothing behind then.
        """
        self._sweep()
        temporary = self.root / "tmp" / uuid.uuid4().hex
        final = self.root / kind / key
        with _naming(final):
            try:
                (temporary / "content").mkdir(parents=True)
                fill(temporary / "content")
                value = {"about": about, "files": _hash_files(temporary / "content")}
                (temporary / "entry.json").write_text(json.dumps({"digest": digest(value), "value": value}), encoding="utf-8")
                final.parent.mkdir(parents=True, exist_ok=True)
                self._move(temporary, final)
            finally:
                shutil.rmtree(temporary, ignore_errors=True)

    def _move(self, temporary: Path, final: Path) -> None:
        if final.exists() and self.read_folder(final.parent.name, final.name) is None:
            final.rename(temporary / "damaged")
        try:
            temporary.rename(final)
        except OSError:
            if not final.exists():  # if it does, another run stored the same twin meanwhile
                raise
        shutil.rmtree(final / "damaged", ignore_errors=True)

    def _sweep(self, older_than: float = 86400.0) -> None:
        """Remove what killed runs left behind; a day is longer than any write of a live one."""
        for left in (self.root / "tmp").glob("*"):
            try:
                if time.time() - left.stat().st_mtime > older_than:
                    shutil.rmtree(left, ignore_errors=True)
            except OSError:
                continue

    def _file(self, kind: str, key: str) -> Path:
        return self.root / kind / key[:2] / f"{key}.json"


def _hash_files(folder: Path) -> dict[str, str]:
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    return {file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
