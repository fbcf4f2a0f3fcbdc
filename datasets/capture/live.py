"""RealSense cameras while they run: what each has delivered and dropped, its latest pictures, and librealsense's own file of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .realsense import imported

__all__ = ["SYNC", "LiveCamera", "LiveOptions", "find_devices", "serial_of", "synchronise"]

SYNC = ("software", "hardware", "none")
MASTER, SLAVE = 1, 2  # librealsense's inter_cam_sync_mode of D400 cameras
QUEUE = 64  # frames of a camera that wait to be counted: two seconds of one stream


@dataclass(frozen=True)
class LiveOptions:
    """What cameras are asked for.

    width, height  pixels of colour and of depth
    fps            frames a second
    sync           software: stamps in the computer's clock, frames are matched afterwards; hardware: the first camera triggers the others
                   over their cable; none: every camera has a clock of its own
    """

    width: int = 848
    height: int = 480
    fps: int = 30
    sync: str = "software"

    def __post_init__(self):
        if self.sync not in SYNC:
            raise ValueError(f"sync must be {', '.join(SYNC[:-1])} or {SYNC[-1]}, got {self.sync!r}")


def find_devices(serials: Sequence[str] = ()) -> list:
    """librealsense's devices that are plugged in, in the order of ``serials``, or all of them by serial number.

    Raises ImportError where pyrealsense2 or libusb is missing, ValueError where no camera, or one of those asked for, is not there.
    """
    found = {serial_of(device): device for device in imported().context().query_devices()}
    if not found:
        raise ValueError("no RealSense camera is plugged in: check its cable, the USB 3 port and, on Linux, librealsense's udev rules")
    if missing := [serial for serial in serials if serial not in found]:
        raise ValueError(f"no camera {', '.join(missing)} is plugged in, only {', '.join(sorted(found))}")
    return [found[serial] for serial in serials or sorted(found)]


def serial_of(device) -> str:
    return device.get_info(imported().camera_info.serial_number)


def synchronise(devices: list, sync: str) -> None:
    """Set the clocks or triggers of ``devices``. Raises ValueError naming the camera that cannot be triggered."""
    rs = imported()
    for number, device in enumerate(devices):
        for option, value, needed in (
            (rs.option.global_time_enabled, 1 if sync == "software" else 0, False),
            (rs.option.inter_cam_sync_mode, (SLAVE if number else MASTER) if sync == "hardware" else 0, sync == "hardware"),
        ):
            able = [sensor for sensor in device.query_sensors() if sensor.supports(option)]
            if needed and not able:
                raise ValueError(f"camera {serial_of(device)}: cannot be triggered by a cable (no {option.name}): use sync software")
            for sensor in able:
                sensor.set_option(option, value)


class LiveCamera:
    """One camera that runs from ``start`` to ``stop``; it is recorded into ``file`` (``.db3``), or only looked at where there is none.

    frames, dropped  colour frames that came, and frames of colour or depth whose numbers were left out
    stamps, arrivals of the colour frames [s]: in the camera's clock, and in the computer's
    color, depth     the latest pictures, (H, W, 3) uint8 RGB and (H, W) uint16 counts of ``depth_unit`` metres, or None
    """

    def __init__(self, device, options: LiveOptions, file: Path | None = None):
        self._rs, self.name, self._options, self._file = imported(), serial_of(device), options, file
        self.frames, self.dropped, self.stamps, self.arrivals = 0, 0, [], []
        self.color, self.depth = None, None
        self._last, self._running = {}, False
        self._recorder = self._rs.recorder(str(file), device) if file else None
        self._sensors = [(sensor, self._profiles(sensor)) for sensor in (self._recorder or device).query_sensors()]
        self._sensors = [(sensor, profiles) for sensor, profiles in self._sensors if profiles]
        have = {profile.stream_type() for _, profiles in self._sensors for profile in profiles}
        if len(have) < 2:
            asked = f"colour and depth of {options.width} x {options.height} at {options.fps} a second"
            raise ValueError(f"camera {self.name}: must deliver {asked}, has {', '.join(sorted(k.name for k in have)) or 'neither'}")
        option = self._rs.option.depth_units
        units = [sensor.get_option(option) for sensor, _ in self._sensors if sensor.supports(option)]
        self.depth_unit = float(units[0]) if units else 0.001
        self._queue = self._rs.frame_queue(QUEUE, keep_frames=True)

    def _profiles(self, sensor):
        """What this sensor can deliver of what is asked for, one profile a stream."""
        rs, asked, found = self._rs, self._options, {}
        forms = {rs.stream.depth: rs.format.z16, rs.stream.color: rs.format.rgb8}
        for profile in sensor.get_stream_profiles():
            kind = profile.stream_type()
            if not profile.is_video_stream_profile() or forms.get(kind) != profile.format() or profile.fps() != asked.fps:
                continue
            video = profile.as_video_stream_profile()
            if (video.width(), video.height()) == (asked.width, asked.height):
                found[kind] = profile
        return list(found.values())

    def start(self) -> None:
        self._running = True
        self._thread = threading.Thread(target=self._count, name=f"camera {self.name}", daemon=True)
        self._thread.start()
        for sensor, profiles in self._sensors:
            sensor.open(profiles)
            sensor.start(self._queue)

    def stop(self) -> None:
        """Also closes the file."""
        self._running = False
        for sensor, _ in self._sensors:
            sensor.stop()
            sensor.close()
        self._thread.join(timeout=2)
        self._sensors, self._recorder = [], None  # librealsense completes a file when nobody holds its recorder

    def _count(self):
        rs = self._rs
        while self._running:
            good, frame = self._queue.try_wait_for_frame(200)
            if not good:
                continue
            kind, number = frame.get_profile().stream_type(), frame.get_frame_number()
            self.dropped += max(number - self._last.get(kind, number - 1) - 1, 0)
            self._last[kind] = number
            picture = np.array(frame.as_video_frame().get_data())
            if kind == rs.stream.depth:
                self.depth = picture
            else:
                self.color, self.frames = picture, self.frames + 1
                self.stamps.append(frame.get_timestamp() / 1000)
                self.arrivals.append(_arrival(rs, frame))


def _arrival(rs, frame):
    """Seconds of the computer's clock when the frame came: by the driver where it says so, else now."""
    if frame.supports_frame_metadata(rs.frame_metadata_value.time_of_arrival):
        return frame.get_frame_metadata(rs.frame_metadata_value.time_of_arrival) / 1000
    return time.time()
