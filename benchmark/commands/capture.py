"""``twinbench capture``: record with RealSense cameras."""

from __future__ import annotations

import sys
import threading
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import Names
from ..text import shown

__all__ = ["Capture"]


@dataclass(frozen=True)
class Capture:
    """Record RealSense cameras together: OUT is what twinbench calibrate and build take, OUT.realsense has librealsense's own files.

    Without OUT nothing is recorded: look at what the cameras see. The Enter key or the button of the preview's page ends a take.
    """

    out: Annotated[Positional[Path | None], arg(metavar="OUT")] = None
    """Folder of the recording. Default: none, only a preview."""
    cameras: Names = ()
    """Serial numbers; with hardware sync the first triggers the others. Default: all that are plugged in."""
    width: int = 848
    """Pixels across."""
    height: int = 480
    """Pixels down."""
    fps: int = 30
    """Frames a second."""
    sync: str = "software"
    """software: stamps in the computer's clock; hardware: a trigger cable; none."""
    seconds: float | None = None
    """How long to record. Default: until Enter or the button."""
    preview: int | None = None
    """Port of a page on this computer that shows the cameras; 0: any. Default: no page, or any where there is no OUT."""

    def __call__(self) -> int:
        from ...datasets.capture.live import LiveOptions, find_devices
        from ...datasets.capture.preview import Preview
        from ...datasets.capture.taking import files_of, take
        from ..progress import say

        options = LiveOptions(self.width, self.height, self.fps, self.sync)
        devices = find_devices(self.cameras)
        port = 0 if self.preview is None and self.out is None else self.preview
        told: dict[str, int] = {}
        entered = _enter() if self.seconds is None else threading.Event()

        def watch(cameras):
            if page:
                page.show(cameras)
            for camera in cameras:
                if camera.dropped > told.get(camera.name, 0):
                    told[camera.name] = camera.dropped
                    say(f"camera {camera.name}: {camera.dropped} frames dropped, {camera.frames} came")

        with nullcontext() if port is None else Preview(port) as page:
            if page:
                say(f"preview: {page.url}")
            taken = take(
                devices,
                self.out,
                options,
                seconds=self.seconds,
                stopped=lambda: entered.is_set() or bool(page and page.stopped),
                watch=watch,
            )
        for name, count in taken.frames.items():
            print(f"{shown(name)}: {count} frames, {taken.dropped[name]} dropped")
        if taken.timing is not None:
            spread = 1000 * taken.timing.spread
            print(f"{shown(str(self.out))}: {len(taken.timing.times)} frames of all cameras, {spread:.1f} ms apart (median)")
            print(f"{shown(str(files_of(Path(str(self.out)))))}: librealsense's files; not needed any more")
        return 0


def _enter() -> threading.Event:
    """Set once somebody pressed Enter; the end of standard input is no such thing."""
    pressed = threading.Event()
    threading.Thread(target=lambda: sys.stdin.readline() and pressed.set(), daemon=True).start()
    return pressed
