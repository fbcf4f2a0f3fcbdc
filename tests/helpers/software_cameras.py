"""RealSense cameras without hardware: librealsense's software devices, fed by a thread as a camera's driver feeds it."""

import threading
import time

import numpy as np

H, W, UNIT = 48, 64, 0.00025


class SoftwareCamera:
    """A device of 64 x 48 pixels at 30 frames a second; frame t has colour t and depth 4000 + t.

    It leaves out the frames ``lost``, and of the frames ``without_depth`` the depth alone.
    """

    def __init__(self, serial, *, lost=(), without_depth=(), triggered=False, streams=("depth", "color")):
        import pyrealsense2 as rs

        self.device, self.lost, self.without_depth, self.running, self.profiles = rs.software_device(), lost, without_depth, False, {}
        self.device.register_info(rs.camera_info.serial_number, serial)
        self.sensor = self.device.add_sensor("camera")
        k = rs.intrinsics()
        k.width, k.height, k.fx, k.fy, k.ppx, k.ppy, k.model = W, H, 50, 50, 31.5, 23.5, rs.distortion.none
        for number, (kind, form, size) in enumerate([(rs.stream.depth, rs.format.z16, 2), (rs.stream.color, rs.format.rgb8, 3)]):
            if kind.name not in streams:
                continue
            stream = rs.video_stream()
            stream.type, stream.index, stream.uid, stream.width, stream.height = kind, 0, number + 1, W, H
            stream.fps, stream.bpp, stream.fmt, stream.intrinsics = 30, size, form, k
            self.profiles[kind] = self.sensor.add_video_stream(stream)
        self.sensor.add_read_only_option(rs.option.depth_units, UNIT)
        if triggered:
            self.sensor.add_option(rs.option.inter_cam_sync_mode, _range(rs, 0, 2), True)

    def feed(self):
        """Deliver frames from when the sensor is opened until ``running`` is False."""
        import pyrealsense2 as rs

        while self.running and not self.sensor.get_active_streams():
            time.sleep(0.05)
        time.sleep(0.2)  # a sensor is started after it is opened
        for t in range(10_000):
            if not self.running:
                return
            for kind, profile in self.profiles.items():
                if t in self.lost or (kind == rs.stream.depth and t in self.without_depth):
                    continue
                frame, size = rs.software_video_frame(), 2 if kind == rs.stream.depth else 3
                frame.pixels = np.full((H, W), 4000 + t, np.uint16) if size == 2 else np.full((H, W, 3), t % 256, np.uint8)
                frame.stride, frame.bpp, frame.profile = W * size, size, profile.as_video_stream_profile()
                frame.timestamp, frame.domain, frame.frame_number = 1000 * t / 30, rs.timestamp_domain.hardware_clock, t + 1
                if size == 2:
                    frame.depth_units = UNIT
                self.sensor.on_video_frame(frame)
            time.sleep(1 / 30)

    def __enter__(self):
        self.running = True
        self.thread = threading.Thread(target=self.feed, daemon=True)
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.running = False
        self.thread.join()


def _range(rs, low, high):
    found = rs.option_range()
    found.min, found.max, found.step, found.default = low, high, 1, 0
    return found
