"""Spoilt recordings by the hundred, the same for the same seed: one or two mutations of a small valid case each.

``spoil(folder, random)`` changes the case in ``folder`` and says what it did.
"""

import json
import math
import os
import pickle
import re
import shutil
import signal
import socket
import struct
import warnings
import zlib
from contextlib import contextmanager
from pathlib import Path

import numpy as np

ARRAYS = (
    "object_points",
    "object_visibilities",
    "object_motions_valid",
    "controller_points",
    "surface_points",
    "interior_points",
    "object_colors",
)
DEEP = 100_000  # levels: far beyond what Python recurses to


RULE = (
    r" must | missing|cannot be read \(|not a (JSON|PNG|\.npy|complete|readable)|no human mask|unknown key|refused, it|may only be null|"
    r"none of the layouts"
)
# what Python says of itself, and not of the data
RAW = r"object of type|NoneType|not subscriptable|unsupported operand|list index|could not convert|invalid literal|has no attribute"


def said_well(message, folder):
    """Whether a refusal names the file, the rule and what is wrong with it, in one line."""
    at = re.match(rf"(no recording at \S+: )?(no recordings at )?{re.escape(str(folder))}(/[\w./-]+)?: (?P<said>.+)", message)
    return bool(at) and bool(re.search(RULE, f" {at['said']}")) and not re.search(RAW, message) and "\n" not in message


@contextmanager
def within(seconds):
    """Raises TimeoutError in what takes longer, as what waits for a pipe does."""

    def stop(*_):
        raise TimeoutError(f"still at it after {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


# --- files ----------------------------------------------------------------------------------------------------------------


def _bound_socket(file):
    with socket.socket(socket.AF_UNIX) as made:  # its name may have some 100 characters only
        here = os.open(file.parent, os.O_RDONLY)
        try:
            made.bind(f"/proc/self/fd/{here}/{file.name}")
        finally:
            os.close(here)


FILE = {
    "removed": lambda file, random: None,
    "renamed": lambda file, random: file.with_suffix(".old").write_bytes(b""),
    "empty": lambda file, random: file.write_bytes(b""),
    "junk": lambda file, random: file.write_bytes(random.bytes(40)),
    "zeros": lambda file, random: file.write_bytes(bytes(400)),
    "a pipe": lambda file, random: os.mkfifo(file),
    "a socket": lambda file, random: _bound_socket(file),
    "a folder": lambda file, random: file.mkdir(),
    "a link to itself": lambda file, random: file.symlink_to(file.name),
    "a link to nothing": lambda file, random: file.symlink_to("nowhere"),
    "a link to its folder": lambda file, random: file.symlink_to("."),
    "a link to a device": lambda file, random: file.symlink_to("/dev/zero"),
    "unreadable": lambda file, random: (file.write_bytes(b"{}"), file.chmod(0)),
}


def content(file):
    """What a file holds that was not spoilt before into something that cannot be read, or never ends."""
    if not file.is_file():
        raise OSError(f"{file} is no file any more")
    return file.read_bytes()


def spoil_file(file, random):
    how = random.choice([*FILE, "cut", "flipped", "twice"])
    if how in ("cut", "flipped", "twice"):
        data = bytearray(content(file))
        if how == "cut":
            data = data[: random.integers(len(data))]
        elif how == "twice":
            data = data * 2
        else:
            data[random.integers(len(data))] ^= 1 << int(random.integers(8))
        file.write_bytes(bytes(data))
    else:
        file.unlink()
        FILE[how](file, random)
    return f"{file.name} {how}"


# --- arrays ---------------------------------------------------------------------------------------------------------------


def _with(value):
    def put(a, random):
        a = a.astype(float)
        a.reshape(-1)[random.integers(a.size or 1, size=3) % max(a.size, 1)] = value
        return a

    return put


ARRAY = {
    f"of type {t}": (lambda a, random, t=t: a.astype(t)) for t in ("f2", "f4", "g", "i4", "u1", "c16", "U8", "S8", "O", "?", ">f8", "M8[s]")
}
ARRAY |= {f"with {v}": _with(v) for v in (math.nan, math.inf, -math.inf, 1e30, 1e308, 0.5, -1.0)}
ARRAY |= {f"times {s:g}": (lambda a, random, s=s: a * s) for s in (1000.0, 1e-3, 1e30, 1e300, -1.0, 0.0)}
ARRAY |= {f"plus {s:g}": (lambda a, random, s=s: a + s) for s in (0.5, 100.0, 1e5)}
ARRAY |= {
    "flat": lambda a, random: a.reshape(-1),
    "its first": lambda a, random: a[0],
    "an axis more": lambda a, random: a[None],
    "turned": lambda a, random: a.T,
    "swapped axes": lambda a, random: a[..., ::-1],
    "backwards": lambda a, random: a[::-1],
    "one less": lambda a, random: a[1:],
    "one column less": lambda a, random: a[:, 1:],
    "no rows": lambda a, random: a[:0],
    "no columns": lambda a, random: a[:, :0],
    "repeated": lambda a, random: np.repeat(a, 2, 0),
    "all NaN": lambda a, random: a * np.nan,
    "noise": lambda a, random: random.normal(size=a.shape),
    "a number": lambda a, random: 3.0,
    "a string": lambda a, random: "points",
    "bytes": lambda a, random: b"points",
    "None": lambda a, random: None,
    "a list": lambda a, random: a.tolist(),
    "a ragged list": lambda a, random: [[1.0], [1.0, 2.0]],
    "a deep list": lambda a, random: _nested(80),
    "a large number": lambda a, random: 10**400,
    "a dict": lambda a, random: {"points": a},
    "0-dimensional": lambda a, random: np.array(1.0),
}


def _nested(levels):
    value = []
    for _ in range(levels):
        value = [value]
    return value


def changed(value, random):
    while True:
        how = random.choice(list(ARRAY))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return how, ARRAY[how](np.asarray(value), random)
        except (IndexError, TypeError, ValueError):  # an empty array has no first
            continue


def spoil_array(folder, random):
    what = random.choice([*ARRAYS, "tracks", "poses", "pose"])
    file = folder / {"tracks": "gt_track_3d.pkl", "poses": "calibrate.pkl", "pose": "calibrate.pkl"}.get(what, "final_data.pkl")
    data = pickle.loads(content(file))
    if what in data if isinstance(data, dict) else False:
        if random.random() < 0.05:
            del data[what]
            how = "removed"
        else:
            how, data[what] = changed(data[what], random)
    elif what == "pose":
        if random.random() < 0.3:
            how, data[0] = "inverted", np.linalg.inv(data[0])
        else:
            how, data[0] = changed(data[0], random)
    else:
        how, data = changed(data, random)
    file.write_bytes(pickle.dumps(data))
    return f"{what} {how}"


# --- JSON -----------------------------------------------------------------------------------------------------------------

SCENARIO = {
    "gravity": [0.0, 0.0, 9.8],
    "ground": {"normal": [0.0, 0.0, -1.0], "offset": 0.0},
    "object": "toy",
    "session": "one",
    "self_collision": False,
    "grips": [-1, 3],
}
VALUES = (
    None, True, "x", "", "\ud800", [], {}, [1], {"a": 1}, 0, 1, 2, -1, 0.5, 1e6, 1e-9, 10**9, 10**30, 10**400, -(10**400), math.nan,
    math.inf, -math.inf, [math.nan], [[1, 2, 3]] * 3, [0, 0, 1e6], [0.5, 0.5], [2, 2], _nested(40), "y" * 100_000,
)  # fmt: skip


def spoil_json(folder, random):
    file = folder / random.choice(["split.json", "metadata.json", "mask/mask_info_0.json", "scenario.json", "scenario.json"])
    given = SCENARIO if file.name == "scenario.json" else json.loads(content(file))
    key, how = str(random.choice(list(given))), random.choice(["missing", "value", "value", "value", "inside", "unknown", "text"])
    if how == "missing":
        given = {k: v for k, v in given.items() if k != key}
    elif how == "unknown":
        given = given | {random.choice(["gravitation", "x\n\x1b[31m", "fbs"]): 1}
    elif how == "inside" and isinstance(given[key], (list, dict)) and given[key]:
        inner = dict(enumerate(given[key])) if isinstance(given[key], list) else dict(given[key])
        inner[list(inner)[random.integers(len(inner))]] = VALUES[random.integers(len(VALUES))]
        given = given | {key: list(inner.values()) if isinstance(given[key], list) else inner}
    elif how != "text":
        given = given | {key: (how := VALUES[random.integers(len(VALUES))])}
    text = json.dumps(given)
    if how == "text":
        texts = {
            "deep": '{"fps": ' + "[" * DEEP,
            "deep and closed": '{"fps": ' + "[" * DEEP + "]" * DEEP + "}",
            "deep objects": '{"fps":' * DEEP,
            "twice": "{" + json.dumps(key) + ": 1, " + text[1:],
            "with a mark": "\ufeff" + text,
            "a list": f"[{text}]",
            "a number": "3",
            "trailing": text + "}",
            "1e999": f'{{{json.dumps(key)}: 1e999}}',
            "long digits": f'{{{json.dumps(key)}: {"9" * 5000}}}',
        }  # fmt: skip
        how = random.choice(list(texts))
        text = texts[how]
    file.write_text(text)
    return f"{file.name} {key} {str(how)[:40]!r}"


# --- images ---------------------------------------------------------------------------------------------------------------


def _chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height, *, bits=8, color=0, rows=None, palette=b"", interlaced=0):
    """A PNG as its header says, or as ``rows`` have it: PNG specification, sections 5 and 11."""
    channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[color]
    rows = bytes(height * (1 + (width * channels * bits + 7) // 8)) if rows is None else rows
    header = _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, interlaced))
    return (
        b"\x89PNG\r\n\x1a\n"
        + header
        + (_chunk(b"PLTE", palette) if palette else b"")
        + _chunk(b"IDAT", zlib.compress(rows))
        + _chunk(b"IEND", b"")
    )


def _depth(shape, kind="<u2", data=b""):
    stream = __import__("io").BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": kind, "fortran_order": False, "shape": shape})
    return stream.getvalue() + data


WIDTH, HEIGHT = 8, 6
PNG = {
    "of another size": png(5, 5),
    "of 16 bits": png(WIDTH, HEIGHT, bits=16),
    "of one bit": png(WIDTH, HEIGHT, bits=1),
    "with a palette": png(WIDTH, HEIGHT, color=3, palette=bytes(768)),
    "without its palette": png(WIDTH, HEIGHT, color=3),
    "with alpha": png(WIDTH, HEIGHT, color=6),
    "vast": png(100_000, 100_000, rows=b""),
    "of no pixels": png(0, 0, rows=b""),
    "of too few rows": png(WIDTH, HEIGHT, rows=bytes(9)),
    "of too many rows": png(WIDTH, HEIGHT, rows=bytes(999)),
    "of a bomb": png(WIDTH, HEIGHT, rows=bytes(10**7)),
    "of an unknown filter": png(WIDTH, HEIGHT, rows=b"\x09" * 54),
    "interlaced": png(WIDTH, HEIGHT, interlaced=1),
    "a JPEG": b"\xff\xd8\xff\xe0" + bytes(200),
}
NPY = {
    "of metres": _depth((6, 8), "<f8", bytes(384)),
    "of objects": _depth((6, 8), "|O", bytes(384)),
    "vast": _depth((10**9, 10**9)),
    "of another size": _depth((5, 5), "<u2", bytes(50)),
    "short": _depth((6, 8), "<u2", bytes(50)),
    "long": _depth((6, 8), "<u2", bytes(960)),
    "negative": _depth((-6, 8)),
    "flat": _depth((48,), "<u2", bytes(96)),
    "of no header": b"\x93NUMPY\x01\x00\xff\xff{",
    "of a strange version": b"\x93NUMPY\x09\x00" + bytes(100),
}


def spoil_image(folder, random):
    files = sorted([*folder.glob("*/*/*.png"), *folder.glob("*/*/*/*.png"), *folder.glob("depth/*/*.npy")])
    file = files[random.integers(len(files))]
    if random.random() < 0.4:
        return spoil_file(file, random)
    known = PNG if file.suffix == ".png" else NPY
    how = random.choice(list(known))
    file.write_bytes(known[how])
    return f"{file.relative_to(folder)} {how}"


def spoil_folder(folder, random):
    at = folder / random.choice(["color", "depth", "mask", "color/0", "mask/0", "mask/0/1"])
    how = random.choice(["removed", "a file", "a pipe", "a link to itself", "a link back up", "more in it"])
    if how == "more in it":
        for name in ("99", "x.png", "\u0663", "-1.png", "9999999999.png"):
            (at / name).mkdir()
        return f"{at.name} {how}"
    shutil.rmtree(at)
    if how == "a file":
        at.write_bytes(b"x")
    elif how == "a pipe":
        os.mkfifo(at)
    elif how != "removed":
        at.symlink_to(at.name if how == "a link to itself" else Path("..", ".."))
    return f"{at.name} {how}"


def spoil(folder: Path, random: np.random.Generator) -> str:
    """Change the case in ``folder`` in one way, or in two; returns what was done."""
    files = ["final_data.pkl", "split.json", "metadata.json", "calibrate.pkl", "gt_track_3d.pkl", "mask/mask_info_0.json"]
    kinds = {
        "array": lambda: spoil_array(folder, random),
        "json": lambda: spoil_json(folder, random),
        "image": lambda: spoil_image(folder, random),
        "file": lambda: spoil_file(folder / random.choice(files), random),
        "folder": lambda: spoil_folder(folder, random),
    }
    done = []
    for _ in range(1 + (random.random() < 0.15)):
        kind = random.choice(list(kinds), p=[0.36, 0.28, 0.16, 0.16, 0.04])
        try:
            done.append(kinds[kind]())
        except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, EOFError, pickle.UnpicklingError, StopIteration):
            if not done:
                raise
            break  # the first has left nothing to be changed
    return "; ".join(done)
