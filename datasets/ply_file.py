"""The vertices of a .ply file, read strictly and written: ASCII or little-endian, properties by name, nothing but vertices."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .temporary import replacing

__all__ = ["read_vertices", "write_vertices"]

LARGEST_HEADER = 1 << 16  # bytes; Gaussians with harmonics of degree 3 have 1.5 kB
_TYPES = {"char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4", "float": "<f4", "double": "<f8"}
_TYPES |= {f"{'u' * (kind[-2] == 'u')}int{8 * int(kind[-1])}": kind for kind in _TYPES.values() if "f" not in kind}
_TYPES |= {"float32": "<f4", "float64": "<f8"}
_FORMATS = ("ascii", "binary_little_endian")


def read_vertices(path: str | Path) -> dict[str, np.ndarray]:
    """The properties of the vertices in ``path`` by name, each (vertices,), finite.

    Raises ValueError naming the file where it cannot be read, is cut, is longer than its header says, or holds more than vertices.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    end = re.search(rb"^end_header\r?\n", data[:LARGEST_HEADER], re.M)
    if not re.match(rb"ply\r?\n", data) or end is None:
        raise ValueError(f"{path}: not a .ply file: it must begin with a header from ply to end_header of at most {LARGEST_HEADER} bytes")
    kind, count, layout = _header(data[: end.start()], path)
    body = memoryview(data)[end.end() :]
    values: Any = (_binary if kind == "binary_little_endian" else _ascii)(body, count, layout, path)
    names = layout.names or ()
    for name in names:
        bad = np.flatnonzero(~np.isfinite(values[name]))
        if len(bad):
            raise ValueError(f"{path}: {ascii(name)[1:-1]} must be finite, got {values[name][bad[0]]} at vertex {bad[0]}")
    return {name: np.ascontiguousarray(values[name]) for name in names}


def _header(text: bytes, path: Path) -> tuple[str, int, np.dtype]:
    """Format, number of vertices, and the properties' types."""
    kind, count, properties = "", -1, {}
    for line in text.decode("ascii", "replace").splitlines()[1:]:
        words = line.split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", name, "1.0"] if not kind and name in _FORMATS:
                kind = name
            case ["element", "vertex", number] if count < 0 and re.fullmatch(r"\d{1,18}", number):
                count = int(number)
            case ["property", scalar, name] if count >= 0 and scalar in _TYPES and name not in properties:
                properties[name] = _TYPES[scalar]
            case _:
                raise ValueError(
                    f"{path}: a header may hold one format ({' or '.join(_FORMATS)} 1.0) and one element vertex with properties "
                    f"of numbers, each name once, got the line {line[:80]!a}"
                )
    if not kind or count < 0 or not properties:
        raise ValueError(f"{path}: its header lacks {'a format' if not kind else 'vertices' if count < 0 else 'properties'}")
    return kind, count, np.dtype(list(properties.items()))


def _binary(body, count, layout, path):
    if len(body) != count * layout.itemsize:
        raise ValueError(f"{path}: {count} vertices of {layout.itemsize} bytes take {count * layout.itemsize} bytes, got {len(body)}")
    return np.frombuffer(body, layout)


def _ascii(body, count, layout, path):
    width = len(layout.names)
    if 2 * count * width > len(body) + 1:  # a digit and a space each
        raise ValueError(f"{path}: {count} vertices of {width} numbers do not fit into {len(body)} bytes")
    words = bytes(body).split()
    if len(words) != count * width:
        raise ValueError(f"{path}: {count} vertices of {width} numbers are {count * width} numbers, got {len(words)}")
    try:
        numbers = np.array([float(word) for word in words]).reshape(count, width)
    except ValueError as error:
        raise ValueError(f"{path}: its vertices must be numbers ({str(error)[:80]!a})") from None
    return {name: numbers[:, i] for i, name in enumerate(layout.names)}


def write_vertices(path: str | Path, properties: Mapping[str, np.ndarray]) -> None:
    """Write ``properties`` (vertices,) each as little-endian float32 in the given order; the file appears whole or not at all."""
    columns = {name: np.asarray(values, "<f4") for name, values in properties.items()}
    count = len(next(iter(columns.values())))
    table = np.empty(count, [(name, "<f4") for name in columns])
    for name, values in columns.items():
        if values.shape != (count,):
            raise ValueError(f"{path}: {name} must have shape ({count},), got {values.shape}")
        table[name] = values
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}", *(f"property float {name}" for name in columns)]
    with replacing(Path(path)) as temporary:
        temporary.write_bytes("\n".join([*lines, "end_header", ""]).encode("ascii") + table.tobytes())
