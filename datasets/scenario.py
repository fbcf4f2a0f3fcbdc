"""The nouns of the data room: what a recording is, and what a method may see of it.

World axes and signs are the recording's own; gravity and the ground plane are therefore data, not conventions.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from .findings import Findings, refuse
from .rules import camera_rules, observed_rules, plane_rules, scenario_rules, split_rules
from .spacing import spacing

__all__ = ["ANOTHER_INTERACTION", "Camera", "Images", "Observed", "Plane", "Scenario", "Split", "TransferPair"]

SEEN = ("points", "visible", "motion_valid", "colors")  # what has frames and is observed
PER_FRAME = (*SEEN, "controllers", "actuation", "tracks")
ANOTHER_INTERACTION = "a transfer recording must be another interaction"  # than what is fitted, see ``Observed.interaction``
FILLED: Any = None  # the default of a field that gets a value when the recording is made, as its docstring says


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. ``intrinsics`` (3, 3) in pixels; ``camera_to_world`` (4, 4), OpenCV axes (x right, y down, z forward), metres."""

    intrinsics: np.ndarray
    camera_to_world: np.ndarray
    width: int
    height: int

    def __post_init__(self):
        rules = camera_rules(self.intrinsics, self.camera_to_world, self.width, self.height)
        _own(self, zip(("intrinsics", "camera_to_world"), refuse(rules), strict=True))

    def project(self, points):
        """Pixel coordinates (..., 2) as (column, row), and depth [m] along the optical axis, of world ``points`` (..., 3)."""
        rotation, centre = self.camera_to_world[:3, :3], self.camera_to_world[:3, 3]
        local = (np.asarray(points, float) - centre) @ rotation
        homogeneous = local @ self.intrinsics.T
        return homogeneous[..., :2] / homogeneous[..., 2:], local[..., 2]


@dataclass(frozen=True)
class Plane:
    """The half space ``normal . x >= offset`` that bodies stay in; ``normal`` (3,) is a unit vector, ``offset`` in metres."""

    normal: np.ndarray
    offset: float = 0.0

    def __post_init__(self):
        _own(self, [("normal", refuse(plane_rules(self.normal, self.offset)))])

    def height(self, points):
        """Signed distance [m] of ``points`` (..., 3) above the plane."""
        return np.asarray(points) @ self.normal - self.offset


@dataclass(frozen=True)
class Split:
    """Frames [0, train_end) may be fitted; frames [train_end, frame_count) are only ever scored."""

    train_end: int
    frame_count: int

    def __post_init__(self):
        refuse(split_rules(self.train_end, self.frame_count))

    @property
    def train(self) -> range:
        return range(0, self.train_end)

    @property
    def test(self) -> range:
        return range(self.train_end, self.frame_count)


@runtime_checkable
class Images(Protocol):
    """Lazily read images. ``frame_count`` frames are within reach; asking beyond raises IndexError."""

    @property
    def frame_count(self) -> int: ...

    def color(self, camera: int, frame: int) -> np.ndarray: ...  # (H, W, 3) uint8 RGB

    def depth(self, camera: int, frame: int) -> np.ndarray: ...  # (H, W) float32 metres, 0 where invalid

    def mask(self, camera: int, frame: int) -> np.ndarray: ...  # (H, W) bool, the object

    def human_mask(self, camera: int, frame: int) -> np.ndarray: ...  # (H, W) bool, hands and arms

    def until(self, frame_count: int) -> Images: ...  # the same images, only the first ``frame_count`` frames within reach


@dataclass(frozen=True, kw_only=True)
class Observed:
    """What a method may see of a recording: observations of the first F frames, controllers of all T.

    It owns its arrays and holds no way back to the frames that were cut.

    points            (F, N, 3) tracked surface points, metres; a row is meaningless where ``visible`` is False
    visible           (F, N) bool
    motion_valid      (F, N) bool; entry t speaks of the motion t -> t+1
    controllers       (T, C, 3) hand points or driven markers, metres, known for the whole recording
    surface, interior (S, 3), (I, 3) further structure points of frame 0 that were not tracked
    colors            (F, N, 3) RGB in [0, 1], or None
    fps               frames per second
    timed             whether ``fps`` was recorded; False: it is what the frames were meant to be at, and a method may fit it
    correspond        whether point n is the same piece of the body in all frames; False: clouds, of which each frame has its own
    gravity           (3,) m/s^2
    ground            the table, or None where there is none
    actuation         (T, A) further inputs, such as angles of motors in the body, known for the whole recording, in its own units; or None
    grips             (C,) the tracked point that controller c *is* (a driven marker), or -1 (a hand near the body); -1 unless given
    self_collision    whether the object can touch itself (the published cloth configuration)
    object            names the physical thing; recordings of one object share it
    session           names the take a recording was cut from: clean splits keep a session on one side
    """

    name: str
    points: np.ndarray
    visible: np.ndarray
    motion_valid: np.ndarray
    controllers: np.ndarray
    surface: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    interior: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    colors: np.ndarray | None = None
    fps: float = 30.0
    timed: bool = True
    correspond: bool = True
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 9.8]))
    ground: Plane | None = None
    actuation: np.ndarray | None = None
    grips: np.ndarray = FILLED
    self_collision: bool = False
    object: str = ""
    session: str = ""
    cameras: tuple[Camera, ...] = ()
    images: Images | None = None

    def __post_init__(self):
        _own(self, refuse(self._rules(vars(self)), where=f" (scenario {self.name})").items())
        if self.grips is None:
            _own(self, [("grips", np.full(self.controllers.shape[1], -1))])

    @staticmethod
    def _rules(values) -> Findings:
        return observed_rules(values)

    @property
    def frame_count(self) -> int:
        """T, the length of the recording (and of ``controllers``)."""
        return len(self.controllers)

    @property
    def observed_frames(self) -> int:
        """F, the frames whose observations are here."""
        return len(self.points)

    @property
    def structure(self) -> np.ndarray:
        """(M, 3) frame-0 particles in the order tracked | surface | interior, metres."""
        return np.concatenate([self.points[0], self.surface, self.interior])

    @property
    def known(self) -> np.ndarray:
        """(M,) which of the structure was seen in frame 0 or is supplied; of clouds the supplied part alone, where there is one."""
        supplied = len(self.surface) + len(self.interior)
        seen = self.visible[0] if self.correspond or not supplied else np.zeros(len(self.visible[0]), bool)
        return np.concatenate([seen, np.ones(supplied, bool)])

    @property
    def interaction(self) -> str:
        """Hexadecimal SHA-256 of the points under their gravity: what is misreported of one interaction is another one."""
        return hashlib.sha256(f"{self.points.shape}".encode() + self.points.tobytes() + self.gravity.tobytes()).hexdigest()

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of tracked, surface and interior particles."""
        return self.points.shape[1], len(self.surface), len(self.interior)

    @property
    def spacing(self) -> float:
        """Median distance [m] from a particle to its nearest neighbour: what connection radii scale with."""
        return spacing(np.unique(self.structure, axis=0))

    def until(self, frames: int) -> Observed:
        """The same with the observations of its first ``frames`` frames alone."""
        seen: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(Observed)}
        return Observed(**{**seen, **self._first(frames, SEEN)})

    def shortened(self, frames: int) -> Self:
        """Its first ``frames`` frames alone: where hands and motors went afterwards is cut off as well."""
        return replace(self, **self._first(frames, PER_FRAME))

    def _first(self, frames, names) -> dict[str, Any]:
        cut = {name: getattr(self, name, None) for name in names}
        cut = {name: value[:frames].copy() for name, value in cut.items() if value is not None}
        return cut | {"images": None if self.images is None else self.images.until(frames)}


@dataclass(frozen=True, kw_only=True)
class Scenario(Observed):
    """One whole recording with its split. Frozen and validated when built; methods get ``observed()``, never this.

    split         which frames may be fitted
    tracks        (T, K, 3) ground-truth tracks, metres, NaN where not annotated, or None
    start_frames  how many first frames whoever places a twin in this recording may see, a protocol for all methods alike: 1, or 2 where
                  the body moves in frame 0 already and its velocity is told (as in DEFORM's evaluation)
    """

    split: Split
    tracks: np.ndarray | None = None
    start_frames: int = 1

    @staticmethod
    def _rules(values) -> Findings:
        return scenario_rules(values)

    def observed(self, frames: int | None = None) -> Observed:
        """What a method may see: the train frames' observations, or only the first ``frames`` of them.

        Ground-truth tracks are for scoring and are never in it.
        """
        frames = self.split.train_end if frames is None else frames
        if not 1 <= frames <= self.split.train_end:
            raise ValueError(f"frames must lie in [1, {self.split.train_end}], got {frames} (scenario {self.name})")
        return self.until(frames)

    def initial(self) -> Observed:
        """Frame 0, or as many as ``start_frames`` declares, and the controllers: what a twin fitted elsewhere gets to know of a target."""
        return self.observed(self.start_frames)

    @classmethod
    def of(cls, observed: Observed, share: float) -> Scenario:
        """What was observed as a recording of its own, of which the first ``share`` may be fitted; nothing of what follows is in it."""
        short = observed.shortened(observed.observed_frames)
        split = Split(max(1, int(share * short.frame_count)), short.frame_count)
        return cls(**{f.name: getattr(short, f.name) for f in fields(Observed)}, split=split)

    def shortened(self, frames: int, train_end: int | None = None) -> Self:
        """Its first ``frames`` frames alone, of which ``train_end`` may be fitted, or those that could be before."""
        train_end = min(self.split.train_end, frames) if train_end is None else train_end
        return replace(self, **self._first(frames, PER_FRAME), split=Split(train_end, frames))

    def with_split(self, train_end: int) -> Scenario:
        """The same recording with another train range."""
        return replace(self, split=Split(train_end, self.frame_count))


@dataclass(frozen=True)
class TransferPair:
    """A twin fitted on ``sources`` (names of recordings of one object) is scored on all frames of ``target``."""

    sources: tuple[str, ...]
    target: str

    def __post_init__(self):
        object.__setattr__(self, "sources", tuple(self.sources))
        if not self.sources:
            raise ValueError(f"a transfer pair needs at least one source (target {self.target})")
        if self.target in self.sources:
            raise ValueError(f"the target of a transfer pair must not be fitted, but {self.target} is among its sources")


def _own(instance, arrays):
    """Replace array fields by read-only copies of ``arrays``, (name, array) each."""
    for name, value in arrays:
        value = np.array(value, order="C")
        value.flags.writeable = False
        object.__setattr__(instance, name, value)
