"""A take: several RealSense cameras recorded together, by librealsense's own files and then in the neutral layout."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..temporary import replacing
from .layout import write_layout
from .live import LiveCamera, LiveOptions, synchronise
from .realsense import ARRIVALS, read_realsense
from .timing import Timing, measure_timing

__all__ = ["Taken", "files_of", "take"]

TICK = 0.2  # s between two looks at whether to stop


@dataclass(frozen=True)
class Taken:
    """frames, dropped: of each camera by name; ``files`` of librealsense; ``timing`` of the recording, None where nothing was recorded."""

    frames: dict[str, int]
    dropped: dict[str, int]
    files: tuple[Path, ...] = ()
    timing: Timing | None = None


def files_of(out: Path) -> Path:
    """The folder of librealsense's files of the take ``out``; it stays, whatever becomes of the rest."""
    return out.with_name(f"{out.name}.realsense")


def take(
    devices: list,
    out: str | Path | None,
    options: LiveOptions | None = None,
    *,
    seconds: float | None = None,
    stopped: Callable[[], bool] = lambda: False,
    watch: Callable[[list[LiveCamera]], None] = lambda cameras: None,
) -> Taken:
    """Record ``devices`` for ``seconds``, or until ``stopped()``, into ``out`` (neutral layout) and ``out.realsense`` (one ``.db3`` each).

    ``watch(cameras)`` is called now and then. Without ``out`` nothing is written. Raises ValueError where ``out`` exists, a camera cannot
    deliver what is asked for, or one delivers nothing: the error names it, and the files of the others are kept.
    """
    options = options or LiveOptions()
    folder = None if out is None else files_of(Path(out))
    if out is not None and folder is not None:
        for one in (Path(out), folder):
            if one.exists():
                raise ValueError(f"{one}: already exists; recordings are not replaced")
        folder.mkdir(parents=True)
    try:
        cameras = _run(devices, folder, options, seconds, stopped, watch)
    except Exception:
        if folder is not None and not any(folder.iterdir()):
            folder.rmdir()
        raise
    frames, dropped = ({c.name: getattr(c, what) for c in cameras} for what in ("frames", "dropped"))
    if silent := [name for name, count in frames.items() if not count]:
        raise ValueError(f"camera {', '.join(silent)}: delivered no frame of colour: is its cable a USB 3 cable?")
    if out is None or folder is None:
        return Taken(frames, dropped)
    files = tuple(folder / f"{camera.name}.db3" for camera in cameras)
    for file, camera in zip(files, cameras, strict=True):
        with replacing(file.with_suffix(ARRIVALS)) as temporary:
            temporary.write_text(json.dumps({"stamps": camera.stamps, "arrivals": camera.arrivals}), encoding="utf-8")
    recording = read_realsense(files)
    write_layout(out, recording)
    return Taken(frames, dropped, files, measure_timing(recording))


def _run(devices, folder, options, seconds, stopped, watch):
    synchronise(devices, options.sync)
    cameras, started = [], []
    try:
        for device in devices:
            cameras.append(LiveCamera(device, options))  # refuses what it cannot deliver before any file is there
        if folder is not None:
            names = [camera.name for camera in cameras]
            cameras = [LiveCamera(d, options, folder / f"{name}.db3") for d, name in zip(devices, names, strict=True)]
        for camera in reversed(cameras):  # the first triggers the others, which must be waiting
            camera.start()
            started.append(camera)
        until = float("inf") if seconds is None else time.monotonic() + seconds
        while time.monotonic() < until and not stopped():
            watch(cameras)
            time.sleep(min(TICK, max(until - time.monotonic(), 0)))
    finally:
        for camera in started:
            camera.stop()
    return cameras
