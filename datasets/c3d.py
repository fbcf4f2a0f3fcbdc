"""Marker positions from C3D files (motion capture): the header, the parameters of the group POINT, and the frames.

Source: The C3D File Format, user guide, sections 4 to 6 (c3d.org). Every length is compared with the file's before anything is read, as
libraries that trust them crash or hang on damaged files.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np

from .files import read_bytes

__all__ = ["read_points"]

BLOCK = 512  # bytes
LITTLE_ENDIAN = 84  # like all files since the 1990s
_TYPES = {-1: "S1", 1: "i1", 2: "<i2", 4: "<f4"}


def read_points(file: Path) -> tuple[np.ndarray, dict]:
    """Positions (T, V, 3) in the file's unit, NaN where not seen, and the parameters of POINT by name: strings or numbers, in a list each.

    Raises ValueError naming the file.
    """
    data = read_bytes(file)
    try:
        return _points(data), _parameters(data)
    except (ValueError, IndexError, KeyError, OverflowError, struct.error) as failure:
        raise ValueError(f"{file}: not a readable c3d file ({failure})") from None


def _points(data):
    if len(data) < 2 * BLOCK or data[1] != 0x50:
        raise ValueError("its header is missing")
    points, analog, first, last, _, scale, start = struct.unpack("<5HfH", data[2:18])
    frames, kind = last - first + 1, np.dtype("<f4" if scale < 0 else "<i2")  # the sign of the scale says how positions are stored
    width = 4 * points + analog
    needed = BLOCK * (start - 1) + kind.itemsize * frames * width
    if frames < 1 or start < 2 or len(data) < needed:
        raise ValueError(f"{frames} frames from block {start} on need {needed} bytes, it has {len(data)}")
    if not math.isfinite(scale) or scale == 0:
        raise ValueError(f"its scale must be a finite number other than 0, got {scale}")
    values = np.frombuffer(data, kind, frames * width, BLOCK * (start - 1)).reshape(frames, width)[:, : 4 * points]
    values = values.reshape(frames, points, 4).astype(float)
    positions = values[..., :3] * (1.0 if scale < 0 else scale)
    return np.where(values[..., 3:] < 0, np.nan, positions)  # the fourth word is negative where a marker was not seen


def _parameters(data):
    """The parameters of POINT: a linked list of groups (negative numbers) and of parameters (their group's number), in any order."""
    start = BLOCK * (data[0] - 1)
    if start < BLOCK or data[start + 3 : start + 4] != bytes([LITTLE_ENDIAN]):
        raise ValueError("its parameters are missing or of an unusual byte order")
    at, groups, found = start + 4, {}, {}
    while True:
        length, group = struct.unpack_from("<bb", data, at)
        name, at = _text(data[at + 2 : at + 2 + abs(length)]), at + 2 + abs(length)  # negative where it is locked
        if length == 0:
            break
        (step,) = struct.unpack_from("<h", data, at)
        if group < 0:
            groups[-group] = name
        elif group > 0:
            found[group, name] = _value(data, at + 2)
        if step <= 0:  # the last one
            break
        at += step
    return {name: value for (group, name), value in found.items() if groups.get(group) == "POINT"}


def _value(data, at):
    kind, rank = struct.unpack_from("<bB", data, at)
    shape = tuple(data[at + 2 : at + 2 + rank])
    if len(shape) != rank or kind not in _TYPES or math.prod(shape) > len(data):
        raise ValueError(f"its parameter at byte {at} is damaged")
    values = np.frombuffer(data, _TYPES[kind], math.prod(shape), at + 2 + rank)
    if kind != -1:
        return values.tolist()
    length = shape[0] if shape else 1
    return [_text(row.tobytes()) for row in values.reshape(-1, length)] if length and values.size else []


def _text(data):
    return data.decode("latin-1").strip(" \0")
