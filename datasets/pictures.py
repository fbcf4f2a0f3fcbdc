"""Image files of a recording: PNG and depth arrays, verified before anything is decoded or allocated.

OpenCV returns what it could decode of a damaged PNG, with a line on standard error; here every byte is accounted for first.
"""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np

from .files import check_file, read_bytes
from .rules import MAX_PIXELS

__all__ = ["depth_size", "png_size", "read_depth", "read_png", "write_png"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type
_DEPTHS = {0: (1, 2, 4, 8), 2: (8,), 3: (1, 2, 4, 8), 4: (8,), 6: (8,)}  # by colour type; of 16 bits masks and colours would lose eight
_NEEDED = (b"IHDR", b"PLTE", b"IDAT", b"IEND")
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))  # x, y, dx, dy of Adam7


def png_size(file: Path) -> tuple[int, int]:
    """(width, height) of a PNG file whose chunks are all there and have the check sums that they say. Raises ValueError naming the file."""
    return struct.unpack(">II", _chunks(file)[0][1][:8])


def read_png(file: Path, *, color: bool = False) -> np.ndarray:
    """(H, W) uint8, or with ``color`` (H, W, 3) uint8 RGB. Raises ValueError naming the file where it is missing or anything is damaged."""
    cv2 = _cv2()
    chunks = _chunks(file)
    _inflate(file, chunks[0][1], b"".join(data for kind, data in chunks if kind == b"IDAT"))
    # only what the pixels need: of other chunks OpenCV complains on standard error, or turns the image
    plain = _SIGNATURE + b"".join(_packed(kind, data) for kind, data in chunks if kind in _NEEDED)
    try:
        image = cv2.imdecode(np.frombuffer(plain, np.uint8), cv2.IMREAD_COLOR if color else cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        image = None
    if image is None:
        raise ValueError(f"{file}: not a complete image")
    return np.ascontiguousarray(image[..., ::-1]) if color else image


def write_png(file: Path, image: np.ndarray) -> None:
    """Write (H, W) or, in the order blue, green, red, (H, W, 3) uint8."""
    cv2 = _cv2()
    file.parent.mkdir(parents=True, exist_ok=True)
    _, data = cv2.imencode(".png", np.ascontiguousarray(image), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    file.write_bytes(data.tobytes())


def _chunks(file):
    """(kind, data) of every chunk: PNG specification, section 5."""
    data = read_bytes(file)
    if data[:8] != _SIGNATURE:
        raise ValueError(f"{file}: not a PNG image")
    found, at = [], 8
    while not found or found[-1][0] != b"IEND":
        if len(data) < at + 12 or len(data) < at + 12 + (length := int.from_bytes(data[at : at + 4])):
            raise ValueError(f"{file}: the image must be complete, and is cut short at byte {len(data)}")
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if zlib.crc32(body, zlib.crc32(kind)) != int.from_bytes(data[at + 8 + length : at + 12 + length]):
            raise ValueError(f"{file}: the image is damaged, its chunk {kind!r} at byte {at} must have the check sum that it says")
        found.append((kind, body))
        at += 12 + length
    _check_header(file, *found[0])
    if found[0][1][9] == 3 and b"PLTE" not in dict(found):
        raise ValueError(f"{file}: the image must have the palette that its header promises, got none")
    return found


def _check_header(file, kind, header):
    if kind != b"IHDR" or len(header) != 13:
        raise ValueError(f"{file}: not a PNG image (its header is missing)")
    width, height, depth, color, compression, filtering, interlaced = struct.unpack(">IIBBBBB", header)
    if not (1 <= width <= MAX_PIXELS and 1 <= height <= MAX_PIXELS):
        raise ValueError(f"{file}: the image must be 1 to {MAX_PIXELS} pixels wide and high, got {width} x {height}")
    if depth not in _DEPTHS.get(color, ()) or compression or filtering or interlaced > 1:
        raise ValueError(f"{file}: the image must have at most 8 bits a channel and a known colour type, got {depth} bits of type {color}")


def _inflate(file, header, packed):
    """Whether the data are exactly the rows that the header promises, each with a known filter."""
    width, height, depth, color, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    sizes = [(width, height)]
    if interlaced:
        sizes = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in _PASSES]
    parts = [(h, 1 + (w * _CHANNELS[color] * depth + 7) // 8) for w, h in sizes if w > 0 and h > 0]
    size = sum(rows * length for rows, length in parts)
    stream = zlib.decompressobj()
    try:
        data = stream.decompress(packed, size + 1)
    except zlib.error as failure:
        raise ValueError(f"{file}: the image is damaged ({failure})") from None
    if len(data) != size or not stream.eof:
        got = "more" if len(data) > size else len(data)
        raise ValueError(f"{file}: the image is damaged, it must hold {size} bytes of pixels, got {got}")
    at = 0
    for rows, length in parts:
        if np.frombuffer(data, np.uint8, rows * length, at)[::length].max() > 4:
            raise ValueError(f"{file}: the image is damaged, its rows must be packed by a filter 0 to 4, got another")
        at += rows * length


def _packed(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))


def _cv2():
    try:
        import cv2
    except ImportError as error:
        raise ImportError("images need OpenCV: pip install opencv-python-headless") from error
    return cv2


def depth_size(file: Path) -> tuple[int, int]:
    """(width, height) from the header of a depth file, whose length must fit. Raises ValueError naming the file."""
    size = check_file(file)
    with file.open("rb") as stream:
        height, width = _depth_header(file, stream.read(1024), size)[0]
    return width, height


def read_depth(file: Path) -> np.ndarray:
    """(H, W) of integers, as the file has them. Raises ValueError naming the file."""
    data = read_bytes(file)
    shape, kind, fortran, start = _depth_header(file, data[:1024], len(data))
    return np.frombuffer(data, kind, shape[0] * shape[1], start).reshape(shape, order="F" if fortran else "C")


def _depth_header(file, head, size):
    """Shape, type, order and first byte of the array in a .npy file of ``size`` bytes that begins with ``head``."""
    stream = io.BytesIO(head)
    try:
        version = np.lib.format.read_magic(stream)
        shape, fortran, kind = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version](stream)
    except Exception as failure:  # a damaged header can fail in any way
        raise ValueError(f"{file}: not a .npy file ({type(failure).__name__}: {' '.join(str(failure).split())[:100]})") from None
    if len(shape) != 2 or kind.kind not in "iu" or not all(1 <= n <= MAX_PIXELS for n in shape):
        raise ValueError(f"{file}: must be (height, width) integer millimetres, got {shape} {kind}")
    if size != (needed := stream.tell() + shape[0] * shape[1] * kind.itemsize):
        raise ValueError(f"{file}: must be {needed} bytes long, as its header says, got {size}")
    return shape, kind, fortran, stream.tell()
