"""Reading .npz and .npy files that other people made: numbers only, no pickles, and no more of a file than its reader asks for."""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy

from .files import open_regular
from .findings import shown

__all__ = ["MAX_BYTES", "read_arrays"]

MAX_BYTES = 2**30  # of one array once it is unpacked: 400 frames of 200,000 particles in single precision
MAX_HEADER = 10_000  # bytes that describe an array; numpy's own limit
MAX_DIRECTORY = 2**16  # bytes that list the arrays, some 50 each
_END, _LOCATOR = struct.Struct("<4s4H2LH"), 20  # how a zip archive ends, and bytes of what stands before that in a large one
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, UnicodeError)

Shape = Sequence[int | str]


def read_arrays(file: str | Path, wanted: Mapping[str, Shape] | None = None, *, limit: int = MAX_BYTES) -> dict[str, np.ndarray]:
    """The arrays ``wanted`` of ``file`` by name, in native byte order. ``wanted`` gives each one's shape; a word is any length. Without it,
    all arrays, of any shapes; that of an .npy has the file's name.

    What an array claims to be is looked at before it is unpacked: each may take ``limit`` bytes at most. An array of Python objects would
    be a pickle, and is refused. Raises ValueError naming the file and what is wrong where it is no zip archive, holds anything else, twice
    or not at all, is damaged, or an array has another shape.
    """
    file = Path(file)
    with open_regular(file) as stream:
        try:
            if wanted is None and stream.read(2) != b"PK":
                stream.seek(0)
                return {file.stem: _array(file, stream, file.stem, None, limit)}
            _check_directory(file, stream)
            with zipfile.ZipFile(stream) as archive:
                members = _members(file, archive, wanted)
                shapes = wanted or dict.fromkeys(members)
                return {name: _read(file, archive, member, name, shapes[name], limit) for name, member in members.items()}
        except _DAMAGED as failure:
            raise ValueError(f"{file}: not a complete .npz file, which is a zip archive ({shown(str(failure))})") from None


def _check_directory(file: Path, stream: IO[bytes]) -> None:
    """Refuse an archive that ends otherwise than numpy ends it, or lists so much that the list itself would fill the memory."""
    start = max(0, stream.seek(0, os.SEEK_END) - _LOCATOR - _END.size)
    stream.seek(start)
    tail = stream.read()
    stream.seek(0)
    if len(tail) < _END.size or not tail[-_END.size :].startswith(b"PK\x05\x06"):
        raise ValueError(f"{file}: not a complete .npz file, which is a zip archive without a comment")
    *_, size, _, comment = _END.unpack(tail[-_END.size :])
    if tail.startswith(b"PK\x06\x07") or comment or size > MAX_DIRECTORY:
        raise ValueError(f"{file}: must list at most {MAX_DIRECTORY} bytes of members without a comment, got more")


def _members(file: Path, archive: zipfile.ZipFile, wanted: Mapping[str, Shape] | None) -> dict[str, zipfile.ZipInfo]:
    """By name of the array, in the order of ``wanted``."""
    found: dict[str, zipfile.ZipInfo] = {}
    for member in archive.infolist():
        name = member.filename.removesuffix(".npy")
        if (wanted is not None and name not in wanted) or member.filename == name:
            raise ValueError(f"{file}: must hold {', '.join(wanted or ['arrays'])} and nothing else, got {shown(member.filename)}")
        if name in found:
            raise ValueError(f"{file}: {name} must be given once, got it twice")
        found[name] = member
    if missing := [name for name in wanted or () if name not in found]:
        raise ValueError(f"{file}: {', '.join(missing)} missing")
    return {name: found[name] for name in wanted or found}


def _read(file: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str, shape: Shape | None, limit: int) -> np.ndarray:
    if member.compress_type not in _PACKED or member.flag_bits & 1:
        raise ValueError(f"{file}: {name} must be stored or deflated, as numpy writes it, got compression {member.compress_type}")
    with archive.open(member) as stream:
        return _array(file, stream, name, shape, limit)


def _array(file: Path, stream: IO[bytes], name: str, shape: Shape | None, limit: int) -> np.ndarray:
    found, fortran, dtype = _header(file, stream, name)
    if dtype.hasobject:
        raise ValueError(f"{file}: {name} must hold numbers, got Python objects: these would be a pickle, which is never opened")
    if dtype.kind not in "biuf":
        raise ValueError(f"{file}: {name} must hold numbers, got dtype {shown(str(dtype))}")
    if shape is not None and (len(found) != len(shape) or any(isinstance(n, int) and n != m for n, m in zip(shape, found, strict=True))):
        rule = f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
        raise ValueError(f"{file}: {name} must have shape {rule}, got {found}")
    size = dtype.itemsize
    for length in found:
        size *= length
    if size > limit:
        raise ValueError(f"{file}: {name} must take at most {limit} bytes, got {size}")
    data = stream.read(size)
    if len(data) != size or stream.read(1):  # reading to the end verifies the checksum
        got = "fewer" if len(data) < size else "more"
        raise ValueError(f"{file}: {name} must take {size} bytes, as its shape and type say, got {got}")
    array = np.frombuffer(data, dtype).reshape(found, order="F" if fortran else "C")
    return np.asarray(array, dtype.newbyteorder("="), order="C")


def _header(file: Path, stream: IO[bytes], name: str) -> tuple[tuple[int, ...], bool, np.dtype]:
    try:
        version = npy.read_magic(stream)
        if version not in _HEADERS:
            raise ValueError(f"version {version} of the format, which numpy writes for names of fields only")
        shape, fortran, dtype = _HEADERS[version](stream, max_header_size=MAX_HEADER)
    except (zipfile.BadZipFile, zlib.error, EOFError):  # the archive is damaged
        raise
    except Exception as failure:  # a damaged header can fail in any way
        raise ValueError(f"{file}: {name} is not an array that numpy wrote ({shown(str(failure))})") from None
    if any(length < 0 for length in shape):
        raise ValueError(f"{file}: {name} must have lengths >= 0, got {shown(shape)}")
    return shape, fortran, dtype
