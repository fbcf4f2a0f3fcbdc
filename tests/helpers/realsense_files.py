"""Files as a RealSense camera records them, written by librealsense's camera without hardware."""

import time


def record(file, colors, depths, *, focal, unit, fps=30):
    """Write ``colors`` (T, H, W, 3) uint8 RGB and ``depths`` (T, H, W) uint16 as one device's recording; returns ``file``."""
    import pyrealsense2 as rs

    height, width = depths.shape[1:]
    k = rs.intrinsics()
    k.width, k.height, k.fx, k.fy, k.ppx, k.ppy = width, height, focal, focal, (width - 1) / 2, (height - 1) / 2
    k.model = rs.distortion.none
    device = rs.software_device()
    sensor = device.add_sensor("camera")
    profiles = {}
    for number, (kind, form, size) in enumerate([(rs.stream.depth, rs.format.z16, 2), (rs.stream.color, rs.format.rgb8, 3)]):
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.width, stream.height = kind, 0, number + 1, width, height
        stream.fps, stream.bpp, stream.fmt, stream.intrinsics = fps, size, form, k
        profiles[kind] = sensor.add_video_stream(stream)
    sensor.add_read_only_option(rs.option.depth_units, unit)
    recorder = rs.recorder(str(file), device)
    taking = recorder.query_sensors()[0]
    queue = rs.frame_queue(50, True)
    taking.open(list(profiles.values()))
    taking.start(queue)
    for t in range(len(depths)):
        for kind, data, size in ((rs.stream.depth, depths[t], 2), (rs.stream.color, colors[t], 3)):
            frame = rs.software_video_frame()
            frame.pixels, frame.stride, frame.bpp = data, width * size, size
            frame.timestamp, frame.domain, frame.frame_number = 1000 * t / fps, rs.timestamp_domain.hardware_clock, t + 1
            frame.profile = profiles[kind].as_video_stream_profile()
            if kind == rs.stream.depth:
                frame.depth_units = unit
            sensor.on_video_frame(frame)
        time.sleep(0.01)
    time.sleep(0.2)
    taking.stop()
    taking.close()
    del recorder, taking, sensor, device
    return file
