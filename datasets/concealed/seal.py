"""Commit and reveal: hashes that are published before anything is answered, and a ledger of what was done with a sealed set.

A label's hash is SHA-256(salt, label): without the salt nobody can try labels until one fits, and with it nobody can exchange the label.
"""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

__all__ = ["Ledger", "digest", "folder_digest", "read_json", "salt_of", "sealed", "seed_of", "write_json"]

GENESIS = "0" * 64


def canonical(value) -> bytes:
    """JSON with sorted keys and no spaces: equal values have equal bytes. Raises ValueError for NaN and infinities."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def digest(value) -> str:
    """SHA-256 of what JSON can hold, in hexadecimal."""
    return hashlib.sha256(canonical(value)).hexdigest()


def file_digest(file: Path) -> str:
    """SHA-256 of a file's bytes."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def folder_digest(folder: str | Path) -> str:
    """SHA-256 of the names and the contents of all files below ``folder``. Raises ValueError where there are none."""
    files = {f.relative_to(folder).as_posix(): file_digest(f) for f in sorted(Path(folder).rglob("*")) if f.is_file()}
    if not files:
        raise ValueError(f"{folder}: no files here")
    return digest(files)


def seed_of(commit: str, beacon: str) -> str:
    """The seed that nobody could choose: SHA-256 of the commit of the tool, frozen before, and of a public random string, known only after.

    Raises ValueError for a commit that is no commit, or has changes that are not in it (provenance marks them with "+").
    """
    if len(commit) != 40 or set(commit) - set("0123456789abcdef"):
        raise ValueError(f"a seed is derived from a full commit without changes beside it, got {commit!r}; commit first, or choose a seed")
    return hashlib.sha256(f"{commit}\n{beacon}".encode()).hexdigest()


def salt_of(seed: str, name: str) -> str:
    """The salt of the case ``name``, which only the seed tells: HMAC-SHA-256."""
    return hmac.new(seed.encode(), f"salt {name}".encode(), hashlib.sha256).hexdigest()


def sealed(label: Mapping, salt: str) -> str:
    """The hash of a label that may be published."""
    return hashlib.sha256(salt.encode() + b"\n" + canonical(label)).hexdigest()


def read_json(file: str | Path):
    """What a JSON file holds. Raises ValueError naming the file where it is missing or damaged."""
    try:
        return json.loads(Path(file).read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{file}: {error.strerror}") from None
    except ValueError as error:
        raise ValueError(f"{file}: is no JSON ({error})") from None


def write_json(file: str | Path, value) -> None:
    """Write ``value`` in one rename; folders are made."""
    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.partial")
    temporary.write_text(json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    temporary.replace(file)


@dataclass(frozen=True)
class Ledger:
    """A file of JSON lines to which is only added. Every line holds the hash of the line before it, so that none can be changed or left out
    without all later hashes changing; whoever knows the last one (``head``) can tell.
    """

    file: Path

    def read(self) -> list[dict]:
        """All entries, oldest first. Raises ValueError naming the line at which the chain is broken."""
        if not Path(self.file).exists():
            return []
        entries, before = [], GENESIS
        for number, line in enumerate(Path(self.file).read_text(encoding="utf-8").splitlines(), 1):
            try:
                entry = json.loads(line)
                told = entry.pop("hash")
            except (ValueError, KeyError, AttributeError):
                raise ValueError(f"{self.file}: line {number} is no entry of a ledger") from None
            if entry.get("before") != before or digest(entry) != told:
                raise ValueError(f"{self.file}: line {number} was changed, or a line before it is missing: the chain of hashes is broken")
            entries.append(entry | {"hash": told})
            before = told
        return entries

    @property
    def head(self) -> str:
        """The hash of the last entry: what is to be published beside what it says."""
        return ([{"hash": GENESIS}] + self.read())[-1]["hash"]

    def append(self, event: str, **about) -> dict:
        """Add an entry and return it. Raises ValueError where the chain is broken already."""
        entry = {"event": event, "time": datetime.now(UTC).isoformat(timespec="seconds"), **about, "before": self.head}
        entry |= {"hash": digest(entry)}
        Path(self.file).parent.mkdir(parents=True, exist_ok=True)
        with Path(self.file).open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry, ensure_ascii=False, allow_nan=False) + "\n")
        return entry
