"""What depth cameras recorded, before anything is made of it: pictures, calibration and time stamps, camera by camera.

Every reader of raw recordings returns a ``RawRecording``, and everything behind it knows nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..findings import Findings, error, refuse, shown
from ..rules import MAX_PIXELS, intrinsics_rules, pose_rules
from ..scenario import Plane

__all__ = ["Frames", "RawCamera", "RawRecording"]

DEPTH_UNITS = (1e-6, 0.1)  # m for a count: cameras have 25 um to 10 mm


class Frames(Protocol):
    """The pictures of one camera, read when asked for. Raises ValueError naming file and frame where one cannot be read."""

    def color(self, frame: int) -> np.ndarray: ...  # (H, W, 3) uint8 RGB

    def depth(self, frame: int) -> np.ndarray: ...  # (H, W) integers, counts of the depth unit, 0 where nothing was measured

    def background(self) -> tuple[np.ndarray, np.ndarray] | None: ...  # colour and depth of the empty scene, if they were taken


@dataclass(frozen=True)
class RawCamera:
    """One camera: depth is aligned to colour, so that both have one set of intrinsics.

    intrinsics       (3, 3) pixels; pixel centres have integer coordinates
    camera_to_world  (4, 4), OpenCV axes, metres, or None: not calibrated
    stamps           (T,) seconds in the camera's own clock, rising
    arrivals         (T,) seconds in the clock of the computer that recorded, not falling: frames of a full queue come at one time;
                     None where nobody wrote them down
    depth_unit       metres for one count of depth
    """

    name: str
    intrinsics: np.ndarray
    camera_to_world: np.ndarray | None
    width: int
    height: int
    stamps: np.ndarray
    depth_unit: float
    frames: Frames = field(repr=False)
    arrivals: np.ndarray | None = None

    def __post_init__(self):
        found = refuse(self._rules())
        for name, value in found.items():
            if value is not None:
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    def _rules(self) -> Findings:
        who = f"of camera {self.name}"
        found = {"intrinsics": (yield from intrinsics_rules(f"intrinsics {who}", self.intrinsics))}
        pose = self.camera_to_world
        found["camera_to_world"] = None if pose is None else (yield from pose_rules(f"camera_to_world {who}", pose))
        if not all(isinstance(n, int) and 1 <= n <= MAX_PIXELS for n in (self.width, self.height)):
            yield error(f"size {who}", f"must be 1 to {MAX_PIXELS} pixels, got {shown(self.width)} x {shown(self.height)}")
        if not (isinstance(self.depth_unit, float) and DEPTH_UNITS[0] <= self.depth_unit <= DEPTH_UNITS[1]):
            rule = f"must be {DEPTH_UNITS[0]:g} to {DEPTH_UNITS[1]:g} metres for a count"
            yield error(f"depth_unit {who}", f"{rule}, got {shown(self.depth_unit)}")
        found["stamps"] = yield from _times(f"stamps {who}", self.stamps, apart=True)
        found["arrivals"] = None
        if self.arrivals is not None:
            found["arrivals"] = yield from _times(f"arrivals {who}", self.arrivals, apart=False)
            if len(found["arrivals"]) != len(found["stamps"]):
                yield error(f"arrivals {who}", f"must be one for each of {len(found['stamps'])} stamps, got {len(found['arrivals'])}")
        return found

    @property
    def frame_count(self) -> int:
        return len(self.stamps)

    def metres(self, frame: int) -> np.ndarray:
        """(H, W) float32 depth, 0 where nothing was measured."""
        return (self.frames.depth(frame) * self.depth_unit).astype(np.float32)


def _times(name, values, *, apart: bool) -> Findings:
    try:
        times = np.array(values, float)
    except (TypeError, ValueError):
        times = np.zeros((0, 0))
    if times.ndim != 1 or not len(times) or not np.isfinite(times).all():
        yield error(name, f"must be finite seconds, one for each frame, got {shown(values)}")
    elif (fall := np.flatnonzero(np.diff(times) <= 0 if apart else np.diff(times) < 0)).size:
        rule = "must rise" if apart else "must not fall"
        yield error(name, f"{rule}, got {times[fall[0]]:.6g} s and then {times[fall[0] + 1]:.6g} s at frame {fall[0] + 1}")
    return times


@dataclass(frozen=True)
class RawRecording:
    """What was recorded in one take: by cameras, or, where others have lifted the pictures already, as clouds of points.

    cameras      one or more, or none where there are ``clouds``
    clouds       per frame (K, 3) points of the object, world metres
    controllers  (T, C, 3) of clouds: where the hands or grippers were, world metres
    fps          of clouds: frames a second
    timed        of clouds: whether ``fps`` was recorded
    surface      (S, 3) of clouds: what is known of the body in frame 0 beside its cloud, metres
    gravity      (3,) m/s^2 and ``ground``, the table: of the calibration board's world, z into the table, where nobody says otherwise
    """

    name: str
    cameras: tuple[RawCamera, ...] = ()
    clouds: Sequence[np.ndarray] = ()
    controllers: np.ndarray | None = None
    fps: float | None = None
    timed: bool = True
    surface: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 9.8]))
    ground: Plane | None = field(default_factory=lambda: Plane(np.array([0.0, 0.0, -1.0])))

    def __post_init__(self):
        if bool(self.cameras) == bool(len(self.clouds)):
            what = f"{len(self.cameras)} cameras and {len(self.clouds)} clouds"
            raise ValueError(f"recording {self.name}: must have cameras or clouds, and not both, got {what}")
        if len({camera.name for camera in self.cameras}) < len(self.cameras):
            raise ValueError(f"recording {self.name}: cameras must have names of their own, got {[c.name for c in self.cameras]}")
        if len(self.clouds) and (self.controllers is None or len(self.controllers) != len(self.clouds)):
            got = "none" if self.controllers is None else len(self.controllers)
            raise ValueError(f"recording {self.name}: clouds need controllers in each of {len(self.clouds)} frames, got {got}")
