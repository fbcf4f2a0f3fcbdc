"""The picture files of a raw recording: numbered PNG or JPEG files, .npy depth, or colour as one video."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np

from ..files import check_file, read_bytes
from ..pictures import read_depth, read_png, write_png

__all__ = ["Held", "PictureFiles", "Spooled", "Video", "read_depth_png", "write_color", "write_depth"]

_VIDEOS = {".mp4", ".mkv", ".avi", ".mov", ".webm"}
_COLORS, _DEPTHS = {".png", ".jpg", ".jpeg"}, {".png", ".npy"}


class Held:
    """Pictures that are in memory: ``colors`` (T, H, W, 3) uint8, ``depths`` (T, H, W) uint16, the ``empty`` scene or None."""

    def __init__(self, colors, depths, empty=None):
        self.colors, self.depths, self.empty = colors, depths, empty

    def color(self, frame):
        return self.colors[frame]

    def depth(self, frame):
        return self.depths[frame]

    def background(self):
        return self.empty


class Spooled:
    """Pictures of one camera in a temporary file without a name: a recording need not fit into memory. All have one size."""

    def __init__(self):
        self._files = (tempfile.TemporaryFile(), tempfile.TemporaryFile())  # noqa: SIM115 - open as long as this lives
        self._shapes: tuple | None = None
        self._order: list[int] = []

    def append(self, color: np.ndarray, depth: np.ndarray) -> None:
        """``color`` (H, W, 3) uint8 RGB, ``depth`` (H, W) uint16 of the next frame."""
        self._shapes = self._shapes or (color.shape, depth.shape)
        if (color.shape, depth.shape) != self._shapes:
            raise ValueError(f"pictures must all have one size, got {self._shapes} and {(color.shape, depth.shape)}")
        for file, picture in zip(self._files, (color, depth), strict=True):
            file.write(np.ascontiguousarray(picture).data)

    def taken(self, order) -> Spooled:
        """This one, with the frames numbered as ``order`` (T,) of the frames that were appended says."""
        self._order = [int(t) for t in order]
        for file in self._files:
            file.flush()
        return self

    def color(self, frame):
        return self._read(0, frame, np.uint8)

    def depth(self, frame):
        return self._read(1, frame, np.uint16)

    def background(self):
        return None

    def _read(self, which, frame, kind):
        assert self._shapes is not None  # a number of a frame was given, so there is one
        shape, number = self._shapes[which], self._order[frame]
        count = int(np.prod(shape))
        start = number * count * np.dtype(kind).itemsize
        return np.memmap(self._files[which], kind, "r", start, shape).copy()


class PictureFiles:
    """The pictures of one camera in files below ``folder``; ``color``, ``depth``, ``depth_size`` are as in ``recording.json``.

    Raises ValueError naming the files where none is there, numbers are missing between the first and the last, or colour and depth have
    other numbers of frames.
    """

    def __init__(self, folder: Path, camera: str, color: str, depth: str, size: tuple[int, int], background=None, depth_size=None):
        self._size, self._camera, self._depth_size = size, camera, depth_size or size
        self._video = None
        if "{}" not in color:
            self._video = Video(folder / color)
        self._colors = [] if self._video else _numbered(folder, color, _COLORS)
        self._depths = _numbered(folder, depth, _DEPTHS)
        self._background = background and [folder / one for one in background]
        count = len(self._video or self._colors)
        if count != len(self._depths):
            raise ValueError(f"camera {camera} must have as many depth pictures as colour pictures, got {len(self._depths)} and {count}")

    def __len__(self):
        return len(self._depths)

    def color(self, frame):
        if self._video:
            return self._sized(self._video.color(frame), f"{self._video.file} frame {frame}")
        return self._sized(_read_color(self._colors[frame]), self._colors[frame])

    def depth(self, frame):
        return self._spread(_read_depth(self._depths[frame]), self._depths[frame])

    def background(self):
        if not self._background:
            return None
        color, depth = self._background
        return self._sized(_read_color(color), color), self._spread(_read_depth(depth), depth)

    def _spread(self, depth, where):
        """Depth in colour's pixels: of the nearest of its own, as a mean of two depths is nowhere."""
        depth = self._sized(depth, where, self._depth_size)
        if self._depth_size == self._size:
            return depth
        rows, columns = ((np.arange(n) + 0.5) * m / n for n, m in zip(self._size[::-1], depth.shape, strict=True))
        return depth[rows.astype(int)[:, None], columns.astype(int)]

    def _sized(self, picture, where, size=None):
        size = size or self._size
        if picture.shape[1::-1] != size:
            rule = f"pictures of camera {self._camera} must be {size[0]} x {size[1]} pixels"
            raise ValueError(f"{where}: {rule}, got {picture.shape[1]} x {picture.shape[0]}")
        return picture


class Video:
    """Colour as one video file. Frames are decoded in order: asking for an earlier one starts again."""

    def __init__(self, file: Path):
        import cv2

        check_file(file)
        if file.suffix.lower() not in _VIDEOS:
            raise ValueError(f"{file}: colour must be numbered files, with {{}} for the number, or a video ({', '.join(sorted(_VIDEOS))})")
        self.file, self._next = file, 0
        self._capture = cv2.VideoCapture(str(file))
        if not self._capture.isOpened():
            raise ValueError(f"{file}: not a video that can be decoded")
        count = 0
        while self._capture.grab():  # what the header says is often not so
            count += 1
        if not count:
            raise ValueError(f"{file}: not a video that can be decoded: no frame in it")
        self._count = count
        self._capture.set(cv2.CAP_PROP_POS_FRAMES, 0)

    def __len__(self):
        return self._count

    def color(self, frame: int) -> np.ndarray:
        import cv2

        if not 0 <= frame < self._count:
            raise ValueError(f"{self.file}: there are frames 0 to {self._count - 1}, got {frame}")
        if frame < self._next:
            self._capture, self._next = cv2.VideoCapture(str(self.file)), 0
        while self._next < frame and self._capture.grab():
            self._next += 1
        good, picture = self._capture.read()
        self._next += 1
        if not good:
            raise ValueError(f"{self.file}: frame {frame} cannot be decoded")
        return np.ascontiguousarray(picture[..., ::-1])


def _numbered(folder, pattern, suffixes):
    """Files by rising number."""
    if Path(pattern).suffix.lower() not in suffixes or "{}" not in pattern:
        raise ValueError(f"pictures must be numbered files ({', '.join(sorted(suffixes))}) with {{}} for the number, got {pattern!r}")
    place = folder / pattern
    if "{}" not in place.name:
        raise ValueError(f"the number {{}} must stand in the name of the file, got {pattern!r}")
    before, after = place.name.split("{}")
    found = {}
    for file in place.parent.iterdir() if place.parent.is_dir() else ():
        match = re.fullmatch(re.escape(before) + r"([0-9]{1,9})" + re.escape(after), file.name)
        if match and found.setdefault(int(match[1]), file) is not file:
            raise ValueError(f"{file}: frame {int(match[1])} must be there once, and is also {found[int(match[1])].name}")
    if not found:
        raise ValueError(f"{place}: no such pictures")
    numbers = sorted(found)
    missing = sorted(set(range(numbers[0], numbers[-1] + 1)) - set(numbers))
    if missing:
        said = ", ".join(map(str, missing[:5])) + (", ..." if len(missing) > 5 else "")
        raise ValueError(f"{place}: every frame from {numbers[0]} to {numbers[-1]} must be there, missing: {said}")
    return [found[n] for n in numbers]


def _read_color(file):
    if file.suffix.lower() == ".png":
        return read_png(file, color=True)
    import cv2

    picture = cv2.imdecode(np.frombuffer(read_bytes(file), np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError(f"{file}: not a complete picture")
    return np.ascontiguousarray(picture[..., ::-1])


def _read_depth(file):
    return read_depth(file) if file.suffix.lower() == ".npy" else read_depth_png(file)


def read_depth_png(file: Path) -> np.ndarray:
    """(H, W) uint16 counts. Raises ValueError naming the file where it is damaged or not of 16 bits."""
    import cv2

    data = read_bytes(file)
    if data[:8] != b"\x89PNG\r\n\x1a\n" or data[-8:-4] != b"IEND":
        raise ValueError(f"{file}: not a complete PNG picture")
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.ndim != 2 or picture.dtype != np.uint16:
        got = "nothing" if picture is None else f"{picture.shape} {picture.dtype}"
        raise ValueError(f"{file}: depth must be one channel of 16 bits, got {got}")
    return picture


def write_color(file: Path, picture: np.ndarray) -> None:
    """Write (H, W, 3) uint8 RGB as PNG."""
    write_png(file, picture[..., ::-1])


def write_depth(file: Path, counts: np.ndarray) -> None:
    """Write (H, W) integer counts as 16-bit PNG. Raises ValueError where a count does not fit."""
    import cv2

    if counts.ndim != 2 or counts.dtype.kind not in "iu" or counts.min(initial=0) < 0 or counts.max(initial=0) > 65535:
        raise ValueError(f"{file}: depth must be integer counts in [0, 65535], got {shown_range(counts)}")
    file.parent.mkdir(parents=True, exist_ok=True)
    _, data = cv2.imencode(".png", np.ascontiguousarray(counts, np.uint16))
    file.write_bytes(data.tobytes())


def shown_range(counts):
    return f"{counts.dtype} {counts.shape} in [{counts.min(initial=0)}, {counts.max(initial=0)}]"
