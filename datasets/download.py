"""Fetching the published PhysTwin archives: says how much first, resumes, checks, unpacks safely, and leaves nothing half-written."""

from __future__ import annotations

import http.client
import json
import os
import shutil
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..spelling import nearest
from .temporary import replacing
from .unzip import unzip

__all__ = ["ARCHIVES", "BASE_URL", "Archive", "Plan", "download", "plan"]

BASE_URL = "https://huggingface.co/datasets/Jianghanxiao/PhysTwin/resolve/main"
ARCHIVES = {
    "data": "the 22 recordings",
    "experiments_optimization": "zero-order parameters of the published twins",
    "experiments": "first-order checkpoints and roll-outs of the published twins",
    "gaussian_output": "static Gaussians of the published twins",
    "additional_data": "further garments, not part of the paper's numbers",
}
_CHUNK = 1 << 20  # bytes
_TIMEOUT = 60  # s without a byte
_ATTEMPTS = 5  # per archive; each goes on where the last one stopped
_PATIENCE = 1.0  # s, the first wait after an attempt that brought nothing


@dataclass(frozen=True)
class Archive:
    """One archive: ``size`` bytes on the server, or None where it does not say; ``present`` bytes are here; ``done`` once unpacked."""

    name: str
    url: str
    size: int | None
    present: int
    done: bool

    @property
    def missing(self) -> int:
        """Bytes still to fetch."""
        return 0 if self.done else max(0, (self.size or 0) - self.present)


@dataclass(frozen=True)
class Plan:
    """What a download would fetch."""

    archives: tuple[Archive, ...]
    out: Path

    @property
    def missing(self) -> int:
        """Bytes still to fetch."""
        return sum(a.missing for a in self.archives)

    def __str__(self):
        lines = [f"  {a.name:25} {self._state(a):40} {ARCHIVES.get(a.name, '')}" for a in self.archives]
        return "\n".join([f"to fetch: {_size(self.missing)} into {self.out}", *lines])

    @staticmethod
    def _state(archive):
        if archive.done:
            return "already here"
        size = "size not known" if archive.size is None else _size(archive.size)
        return f"{size}, {_size(archive.present)} already here" if archive.present else size


def plan(archives: Sequence[str], out: str | Path, *, base_url: str = BASE_URL) -> Plan:
    """Ask the server for the sizes of ``archives`` and look for what is already in ``out``; fetches and writes nothing.

    Raises ValueError for an unknown archive, ConnectionError where the server cannot be reached or does not have it.
    """
    archives = [archives] if isinstance(archives, str) else list(dict.fromkeys(archives))
    for name in archives:
        if name not in ARCHIVES:
            raise ValueError(f"unknown archive {name!r}; {nearest(name, ARCHIVES)}")
    if not archives:
        raise ValueError(f"no archive named; known: {', '.join(ARCHIVES)}")
    out = Path(out).resolve()
    return Plan(tuple(_look(name, f"{base_url.rstrip('/')}/{name}.zip", out) for name in archives), out)


def download(
    archives: Sequence[str],
    out: str | Path,
    *,
    base_url: str = BASE_URL,
    progress: Callable[[str, int, int | None], None] | None = None,
    yes: bool = False,
) -> Plan:
    """Fetch ``archives`` and unpack them into ``out``. Returns the plan that was carried out.

    ``progress(name, bytes here, bytes in all or None)`` is called as bytes arrive. Without ``yes`` a person at the terminal is asked first.
    What was fetched stays in ``out`` as ``<name>.zip.part`` when a download stops, and the next call goes on from there.
    Raises ValueError for an unknown archive, one that is damaged or unsafe to unpack, or where nobody agreed;
    ConnectionError where the network fails; OSError where the disk is too small.
    """
    todo = plan(archives, out, base_url=base_url)
    if not yes and todo.missing:
        _ask(todo)
    todo.out.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(todo.out).free
    if free < todo.missing:
        raise OSError(f"{todo.out}: {_size(todo.missing)} to fetch, but only {_size(free)} free on that disk")
    for archive in todo.archives:
        if not archive.done:
            file = _fetch(archive, todo.out, progress)
            _write_receipt(todo.out, archive, file.stat().st_size, unzip(file, todo.out))
            file.unlink()
    return todo


def _ask(todo):
    print(todo)
    if not sys.stdin or not sys.stdin.isatty():
        raise ValueError(f"nobody to ask whether to fetch {_size(todo.missing)}; pass yes=True (--yes)")
    if input("fetch? [y/N] ").strip().lower() not in ("y", "yes"):
        raise ValueError("not agreed to, nothing was fetched")


def _look(name, url, out):
    """What the server and the folder say of one archive."""
    receipt, whole, part = _receipt(out, name), out / f"{name}.zip", out / f"{name}.zip.part"
    with _open(url, method="HEAD") as reply:
        size = _length(reply)
    sizes = [f.stat().st_size for f in (whole, part) if f.exists()]
    here = size if size is not None and size in sizes else part.stat().st_size if part.exists() else 0
    done = receipt is not None and (size is None or receipt["size"] == size)
    return Archive(name, url, size, here if size is None or here <= size else 0, done)


def _fetch(archive, out, progress):
    """The complete ``<name>.zip``, which grew as ``<name>.zip.part``."""
    whole, part = out / f"{archive.name}.zip", out / f"{archive.name}.zip.part"
    if whole.exists() and whole.stat().st_size == archive.size:
        return whole
    for attempt in range(_ATTEMPTS):
        before = part.stat().st_size if part.exists() else 0
        try:
            _receive(archive, part, progress)
        except (urllib.error.URLError, http.client.HTTPException, TimeoutError, ConnectionError) as error:
            problem = error
        except OSError as error:
            raise OSError(error.errno, f"{part}: cannot be written ({error.strerror}); what was fetched stays there") from None
        else:
            problem = None
        here = part.stat().st_size if part.exists() else 0
        if here == archive.size or (archive.size is None and problem is None):
            os.replace(part, whole)
            return whole
        if here <= before:  # no headway: wait longer and longer
            time.sleep(min(2**attempt, 10) * _PATIENCE)
    raise ConnectionError(
        f"{archive.url}: stopped at {here} of {archive.size} bytes ({problem or 'the server closed the connection'}); "
        "call again to go on from there"
    )


def _receive(archive, part, progress):
    """Append to ``part`` what is missing; from the start where the server cannot go on from the middle."""
    here = part.stat().st_size if part.exists() else 0
    if archive.size is None or here > archive.size:
        part.unlink(missing_ok=True)
        here = 0
    if here == archive.size and here:
        return
    with _open(archive.url, start=here) as reply:
        goes_on = reply.status == 206 and str(reply.headers.get("Content-Range", "")).startswith(f"bytes {here}-")
        if reply.status == 206 and not goes_on:
            raise ConnectionError(f"{archive.url}: asked for bytes from {here}, got {reply.headers.get('Content-Range')}")
        here = here if goes_on else 0
        with part.open("ab" if goes_on else "wb") as file:
            while chunk := reply.read1(_CHUNK):
                file.write(chunk)
                here += len(chunk)
                if archive.size is not None and here > archive.size:
                    raise ConnectionError(f"{archive.url}: more than the {archive.size} bytes that the server spoke of")
                if progress:
                    progress(archive.name, here, archive.size)


def _open(url, *, method="GET", start=0):
    headers = {"User-Agent": "twinbench", "Accept-Encoding": "identity"} | ({"Range": f"bytes={start}-"} if start else {})
    try:
        return urllib.request.urlopen(urllib.request.Request(url, headers=headers, method=method), timeout=_TIMEOUT)
    except urllib.error.HTTPError as error:
        error.close()
        raise ConnectionError(f"{url}: the server answered {error.code} {error.reason}") from None
    except urllib.error.URLError as error:
        raise ConnectionError(f"{url}: cannot be reached ({error.reason}); is there a network?") from None
    except (TimeoutError, http.client.HTTPException) as error:
        raise ConnectionError(f"{url}: no answer ({error or type(error).__name__})") from None


def _length(reply):
    length = reply.headers.get("Content-Length", "")
    return int(length) if length.isdecimal() else None


def _receipt(out, name):
    """What is remembered of an archive that was fetched and unpacked, and is still here."""
    try:
        receipt = json.loads((out / ".downloaded" / f"{name}.json").read_text(encoding="utf-8"))
        return receipt if all((out / item).exists() for item in receipt["holds"]) and "size" in receipt else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write_receipt(out, archive, size, holds):
    file = out / ".downloaded" / f"{archive.name}.json"
    with replacing(file) as temporary:
        temporary.write_text(json.dumps({"url": archive.url, "size": size, "holds": holds}), encoding="utf-8")


def _size(count):
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.2f} GB"
