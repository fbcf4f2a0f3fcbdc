"""Recordings of RealSense cameras: the ``.db3`` files that librealsense writes, and ``.bag`` where it still reads them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..files import check_file, read_json
from .pictures import Spooled
from .recording import RawCamera, RawRecording

__all__ = ["ARRIVALS", "SUFFIXES", "imported", "read_realsense"]

SUFFIXES = (".db3", ".bag")
ARRIVALS = ".arrivals.json"  # beside a file: stamps of its colour frames, and when they came [s]
WAIT = 2000  # ms for a frame of a file, which is there or never comes


def imported():
    """pyrealsense2. Raises ImportError that says what to install."""
    try:
        import pyrealsense2
    except ImportError as error:
        raise ImportError(f"RealSense needs 'pip install twinbench[capture]', and on Debian libusb-1.0-0 ({error})") from error
    return pyrealsense2


def read_realsense(files) -> RawRecording:
    """One file for each camera, which is named like it and has no pose yet. Depth is taken to colour's pixels where they differ.

    Pictures are kept in temporary files: 2 MB for a frame of 848 x 480. Raises ValueError naming the file, ImportError without
    pyrealsense2.
    """
    files = [Path(file) for file in files]
    for file in files:
        check_file(file)
        if file.suffix not in SUFFIXES:
            raise ValueError(f"{file}: a file must be a RealSense recording ({' or '.join(SUFFIXES)}); other recordings are folders")
    return RawRecording(files[0].stem, tuple(_camera(imported(), file) for file in files))


def _camera(rs, file):
    pipeline, config = rs.pipeline(), rs.config()
    try:
        rs.config.enable_device_from_file(config, str(file), repeat_playback=False)
        # before it starts: what is played by the clock until then is lost where this thread has to wait for its turn
        config.resolve(rs.pipeline_wrapper(pipeline)).get_device().as_playback().set_real_time(False)
        profile = pipeline.start(config)
    except RuntimeError as error:
        raise ValueError(f"{file}: cannot be opened as a RealSense recording ({error})") from None
    try:
        align = _alignment(rs, file, profile)
        stamps, spool, unit = [], Spooled(), math.nan
        while True:
            good, frames = pipeline.try_wait_for_frames(WAIT)
            if not good:
                break
            frames = align.process(frames) if align else frames
            depth, color = frames.get_depth_frame(), frames.get_color_frame()
            if depth and color and _of_one_time(depth, color):
                unit = float(depth.get_units())
                stamps.append(color.get_timestamp() / 1000)
                spool.append(_rgb(rs, file, color), np.array(depth.get_data(), np.uint16))
        intrinsics = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
    finally:
        pipeline.stop()
    if not stamps:
        raise ValueError(f"{file}: must hold frames of colour and depth together, got none")
    stamps, order = np.unique(stamps, return_index=True)  # rising; a frameset in which nothing of colour is new is left out
    k = np.array([[intrinsics.fx, 0, intrinsics.ppx], [0, intrinsics.fy, intrinsics.ppy], [0, 0, 1]])
    size = (intrinsics.width, intrinsics.height)
    return RawCamera(file.stem, k, None, *size, stamps, unit, spool.taken(order), _arrivals(file, stamps))


def _of_one_time(depth, color):
    """Whether both are of one frame: librealsense pairs a colour whose depth is missing with the depth that comes next.

    Half an interval apart is the limit. Stamps of different clocks cannot be compared, and are taken as they are.
    """
    if depth.get_frame_timestamp_domain() != color.get_frame_timestamp_domain():
        return True
    fps = min(frame.get_profile().fps() for frame in (depth, color))
    return abs(depth.get_timestamp() - color.get_timestamp()) <= 500 / fps


def _arrivals(file, stamps):
    """When frames with these ``stamps`` came, by the file of arrivals, or None: between two that were written down, as clocks run."""
    beside = file.with_suffix(ARRIVALS)
    if not beside.exists():
        return None
    about = read_json(beside)
    try:
        known, came = (np.array(about[key], float) for key in ("stamps", "arrivals"))
        if known.shape != came.shape or known.ndim != 1 or len(known) < 2 or not (np.diff(known) > 0).all() or not np.isfinite(came).all():
            raise ValueError
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{beside}: must hold stamps, rising, and as many arrivals, two or more [s]") from None
    return np.maximum.accumulate(np.interp(stamps, known, came))


def _alignment(rs, file, profile):
    """What brings depth to colour's pixels, or None where they have one size and intrinsics, as after recording aligned frames."""
    streams = {
        stream.stream_type(): stream.as_video_stream_profile() for stream in profile.get_streams() if stream.is_video_stream_profile()
    }
    if not {rs.stream.depth, rs.stream.color} <= set(streams):
        raise ValueError(f"{file}: must hold the streams depth and color, got {sorted(s.name for s in streams)}")
    depth, color = (streams[s].get_intrinsics() for s in (rs.stream.depth, rs.stream.color))
    same = all(getattr(depth, k) == getattr(color, k) for k in ("width", "height", "fx", "fy", "ppx", "ppy"))
    return None if same else rs.align(rs.stream.color)


def _rgb(rs, file, frame):
    kind, data = frame.get_profile().format(), np.array(frame.get_data())
    if kind == rs.format.rgb8:
        return data
    if kind == rs.format.bgr8:
        return np.ascontiguousarray(data[..., ::-1])
    raise ValueError(f"{file}: colour must be rgb8 or bgr8, got {kind.name}")
