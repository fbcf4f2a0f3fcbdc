"""Unpacking an archive from elsewhere: nothing outside of the folder, no links, every checksum verified, all or nothing."""

from __future__ import annotations

import os
import re
import shutil
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

__all__ = ["unzip"]


def unzip(archive: str | Path, out: str | Path) -> list[str]:
    """Unpack ``archive`` into ``out`` and return the names of the files and folders at its top.

    Files go to a temporary folder first and are renamed once all of them are whole.

    Raises ValueError naming the archive where it is damaged or has a name that leads out of ``out``, a link or an encrypted member;
    OSError where the disk is too small.
    """
    archive, out = Path(archive), Path(out)
    temporary = out / f".{archive.name}.partial"
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        with zipfile.ZipFile(archive) as members:
            wanted = [m for m in members.infolist() if _is_safe(archive, m)]
            _check_names(archive, wanted)
            out.mkdir(parents=True, exist_ok=True)
            _check_space(out, sum(m.file_size for m in wanted))
            for member in wanted:
                _write(members, member, temporary)
        _merge(temporary, out)
        return sorted({PurePosixPath(m.filename).parts[0] for m in wanted})
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError) as error:
        raise ValueError(f"{archive}: damaged, delete it and fetch it again ({error})") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _is_safe(archive, member):
    """True for a file, False for a folder; ValueError for what must not be unpacked."""
    name, kind = member.filename, stat.S_IFMT(member.external_attr >> 16)
    path = PurePosixPath(name)
    if (
        path.is_absolute()
        or ".." in path.parts
        or "\\" in member.orig_filename
        or re.match("[A-Za-z]:", name)
        or "\0" in member.orig_filename
    ):
        raise ValueError(f"{archive}: refused, its member {member.orig_filename!r} leads out of the folder")
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise ValueError(f"{archive}: refused, its member {name!r} is a link or a device")
    if member.flag_bits & 1:
        raise ValueError(f"{archive}: refused, its member {name!r} is encrypted")
    return not member.is_dir() and bool(path.parts)


def _check_names(archive, members):
    """No name twice, and no file where another member needs a folder."""
    names = [PurePosixPath(m.filename) for m in members]
    files = set(names)
    if len(files) < len(names):
        raise ValueError(f"{archive}: refused, it holds a file of one name twice")
    for name in names:
        if not files.isdisjoint(name.parents):
            raise ValueError(f"{archive}: refused, {str(name)!r} lies in a folder that is also a file")


def _check_space(out, needed):
    free = shutil.disk_usage(out).free
    if free < needed:
        raise OSError(f"{out}: unpacking needs {needed / 1e9:.2f} GB, but only {free / 1e9:.2f} GB are free on that disk")


def _write(members, member, folder):
    file = folder.joinpath(*PurePosixPath(member.filename).parts)
    file.parent.mkdir(parents=True, exist_ok=True)
    with members.open(member) as source, file.open("xb") as target:
        shutil.copyfileobj(source, target, 1 << 20)  # reading to the end verifies the checksum


def _merge(source, out):
    """Move what is in ``source`` into ``out``: whole folders where there is none of that name, else file by file."""
    for item in sorted(source.iterdir()) if source.exists() else ():
        target = out / item.name
        if item.is_dir() and target.is_dir():
            _merge(item, target)
        else:
            os.replace(item, target)
