"""Commit and reveal: hashes that are published before anything is answered, and the files of a sealed set, read as if from a stranger.

A label's hash is SHA-256(salt, label): without the salt nobody can try labels until one fits, and with it nobody can exchange the label.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import stat
from collections.abc import Mapping
from pathlib import Path

__all__ = [
    "HASH",
    "NAME",
    "content",
    "digest",
    "file_digest",
    "folder_digest",
    "named",
    "parsed",
    "read_json",
    "salt_of",
    "sealed",
    "seed_of",
    "write_json",
]

NAME = re.compile("[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")  # of cases and entrants: one part of a path everywhere, and plain in any table
HASH = re.compile("[0-9a-f]{64}")
LARGEST = 64 << 20  # bytes of a file that is read at once: the labels of 260 cases are 1 MB
DEEPEST = 32  # levels of JSON: a diagnosis has 7


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
    """SHA-256 of the names and the contents of all files below ``folder``.

    Raises ValueError where there are none, or where there is what has no content of its own: a link, a device, an empty folder.
    """
    folder, files = Path(folder), {}
    for path in (folder, *sorted(folder.rglob("*"))):
        if path.is_symlink() or not (path.is_file() or path.is_dir() or not path.exists()):
            raise ValueError(f"{path}: is a link or a device; a case has plain files and folders only")
        if path.is_file():
            files[path.relative_to(folder).as_posix()] = file_digest(path)
        elif not path.exists() or not any(path.iterdir()):
            raise ValueError(f"{path}: no files here")
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


def named(kind: str, name: str) -> str:
    """``name``, where it can be the name of a ``kind``. Raises ValueError where it could lead elsewhere, or look like another."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        rule = "be 1 to 64 of A-Z a-z 0-9 _ . - and not begin with a dot or a dash"
        raise ValueError(f"the name of {kind} must {rule}, got {_short(name)}")
    return name


def content(file: str | Path, most: int = LARGEST) -> bytes:
    """The bytes of a plain file of at most ``most`` bytes. Raises ValueError naming the file."""
    try:
        about = Path(file).stat()
        if not stat.S_ISREG(about.st_mode):
            raise ValueError(f"{file}: is no plain file")
        if about.st_size > most:
            raise ValueError(f"{file}: must have at most {most} bytes, got {about.st_size}")
        return Path(file).read_bytes()
    except OSError as error:
        raise ValueError(f"{file}: {error.strerror}") from None


def parsed(text: bytes):
    """What strict JSON says: UTF-8, finite numbers, no name twice in an object, at most ``DEEPEST`` levels. Raises ValueError."""
    try:
        value = json.loads(text.decode("utf-8"), parse_constant=_no_number, object_pairs_hook=_once)
    except RecursionError:
        raise ValueError(f"more than {DEEPEST} levels") from None
    level = [value]
    for _ in range(DEEPEST):
        level = [one for held in level if isinstance(held, (dict, list)) for one in (held.values() if isinstance(held, dict) else held)]
    if level:
        raise ValueError(f"more than {DEEPEST} levels")
    canonical(value)  # 1e999 is infinite, and half of a surrogate pair is no text
    return value


def _no_number(text):
    raise ValueError(f"{text} is no number")


def _once(pairs):
    found = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"{_short(name)} stands in one object twice")
        found[name] = value
    return found


def _short(value, most=60):
    text = repr(value)
    return text if len(text) <= most else f"{text[:most]}..."


def read_json(file: str | Path, most: int = LARGEST):
    """What a JSON file holds, see ``parsed``. Raises ValueError naming the file where it is missing, damaged or too large."""
    text = content(file, most)
    try:
        return parsed(text)
    except ValueError as error:
        raise ValueError(f"{file}: is no JSON ({error})") from None


def write_json(file: str | Path, value) -> None:
    """Write ``value`` in one rename; folders are made."""
    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.partial")
    temporary.unlink(missing_ok=True)  # what a killed run left, and no link to elsewhere
    with temporary.open("x", encoding="utf-8") as stream:
        stream.write(json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    temporary.replace(file)
