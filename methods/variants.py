"""A method of which something is changed: numbers and switches of its config, the stages it has, how many cameras it is fitted with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np

from ..datasets.scenario import Observed, Scenario
from ..spelling import nearest
from .appearance.config import quirks_named
from .base import Method
from .modules import modules_of
from .registry import get_method, methods

__all__ = ["FewerCameras", "Variant", "changed", "quirks", "seen_by"]

SLACK, PIXELS = 0.01, 2  # m, and widths of a pixel: a point that lies no farther behind what a camera measured is what it saw


@dataclass(frozen=True)
class Variant:
    """``method`` with something changed, to be used like a method that was found: called, it makes one.

    name      what its rows are called
    config    fields of the method's ``presets``, in every preset; "quirks.still_controllers" is a field of the field ``quirks``
    stages    those that it has, of a method with ``stages``
    cameras   so many, the first ones, are all that a fit has observations of, see :func:`seen_by`
    clips     recordings of the object that a twin is fitted on: the train frames of the one it is scored on, then those of others
    look      what its roll-outs are shown with, as ``Method.appearance`` says it; None is as the method says

    Raises ValueError where method or look are unknown, and when it is called, where the method has no such config.
    """

    name: str
    method: str
    config: Mapping[str, object] = field(default_factory=dict)
    stages: tuple[str, ...] | None = None
    cameras: int | None = None
    clips: int | None = None
    look: str | None = None

    def __post_init__(self):
        if self.method not in methods():
            raise ValueError(f"{self.name}: unknown method {self.method!r}; {nearest(self.method, methods())}")
        for option in ("cameras", "clips"):
            if (count := getattr(self, option)) is not None and count < 1:
                raise ValueError(f"{self.name}: {option} must be >= 1, got {count}")
        try:
            quirks_named(self.appearance)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from error

    def __call__(self) -> Method:
        method: Any = get_method(self.method)
        if self.config:
            method.presets = {preset: changed(config, self.config) for preset, config in method.presets.items()}
        if self.stages is not None:
            method.stages = self.stages
        method.appearance = self.appearance
        if self.key != self.method:
            method.builds_on = None  # what it builds on is changed alike, so it makes that itself
        return method if self.cameras is None else FewerCameras(method, self.cameras)

    @property
    def key(self):
        """What a twin is known by: variants that make the same method share their twins, with the method itself where nothing differs."""
        changes = [sorted(self.config.items()), self.stages, self.cameras]
        return [self.method, *changes] if any(changes) else self.method

    @property
    def appearance(self) -> str:
        """What its roll-outs are shown with; its twins are the same whatever that is."""
        return methods()[self.method].appearance if self.look is None else self.look

    @property
    def modules(self) -> tuple[str, ...]:
        """The modules whose code makes the twin: the method's, and where something differs this one."""
        found = methods()
        own, base = found[self.method], getattr(found[self.method], "builds_on", None)
        return (*modules_of(own), *(modules_of(found[base]) if base else ()), *([__name__] if self.key != self.method else []))

    @property
    def reads_images(self) -> tuple[str, ...]:
        """The kinds of images that a fit looks at."""
        own = methods()[self.method].reads_images
        return own if self.cameras is None else _with(own)


def changed(config: Any, changes: Mapping[str, object]):
    """A copy of a frozen dataclass with fields changed, "a.b" being field ``b`` of field ``a``.

    Raises ValueError with the nearest known name for an unknown field.
    """
    for path, value in changes.items():
        name, _, rest = path.partition(".")
        known = [f.name for f in fields(config)] if is_dataclass(config) else []
        if name not in known:
            raise ValueError(f"{type(config).__name__} has no {name!r}; {nearest(name, known)}")
        made: Any = config  # of a dataclass, as its fields say
        config = replace(made, **{name: changed(getattr(config, name), {rest: value}) if rest else value})
    return config


def quirks(method: str) -> tuple[str, ...]:
    """Names of the switches of a method's ``quirks``; none where it has none."""
    presets = getattr(get_method(method), "presets", {})
    return tuple(f.name for f in fields(next(iter(presets.values())).quirks)) if presets else ()


_KINDS = ("mask", "depth")  # which say what a camera saw


def _with(kinds: tuple[str, ...]) -> tuple[str, ...]:
    return (*kinds, *(kind for kind in _KINDS if kind not in kinds))


class FewerCameras(Method):
    """A method that is fitted with what the first ``count`` cameras saw."""

    def __init__(self, method: Method, count: int):
        self.method, self.count = method, count
        self.name, self.builds_on, self.skip_transfer = method.name, method.builds_on, method.skip_transfer
        self.reads_images, self.appearance = _with(method.reads_images), method.appearance

    @property
    def twin_class(self):
        return self.method.twin_class

    def fit(self, observed: Sequence[Observed], **options):
        return self.method.fit([seen_by(one, self.count) for one in observed], **options)

    def skip(self, scenario: Scenario) -> str | None:
        if reason := _too_few(scenario, self.count):
            return reason
        return self.method.skip(replace(scenario, cameras=scenario.cameras[: self.count]))

    def skip_jointly(self, scenarios: Sequence[Scenario]) -> str | None:
        return self.method.skip_jointly(scenarios)


def _too_few(observed: Observed, count: int) -> str | None:
    if len(observed.cameras) < count:
        return f"the recording has {len(observed.cameras)} calibrated cameras"
    if observed.images is None:
        return "the recording has no images, so nobody knows which camera saw what"
    try:
        for kind in _KINDS:
            getattr(observed.images, kind)(0, 0)
    except (OSError, ValueError) as error:
        return f"nobody knows which camera saw what: {error}"
    return None


def seen_by(observed: Observed, count: int) -> Observed:
    """What is left of a recording with its first ``count`` cameras: their images, and the points that any of them saw.

    A camera saw a visible point that falls on its mask of the object and lies no farther than ``SLACK`` or ``PIXELS`` behind the depth
    measured there. The body's shape in frame 0 is kept whole, as a shape prior would give it. Raises ValueError where the recording has not
    so many cameras, or no depth or masks.
    """
    if reason := _too_few(observed, count):
        raise ValueError(f"{reason} (recording {observed.name})")
    seen = np.zeros_like(observed.visible)
    for index, camera in enumerate(observed.cameras[:count]):
        for frame in range(observed.observed_frames):
            depth, mask = (np.asarray(getattr(observed.images, kind)(index, frame)) for kind in ("depth", "mask"))
            rows = np.flatnonzero(observed.visible[frame])
            seen[frame, rows] |= _in_view(camera, depth, mask.astype(bool), observed.points[frame, rows])
    visible = observed.visible & seen
    valid = observed.motion_valid & visible
    valid[:-1] &= visible[1:]
    return replace(observed, cameras=observed.cameras[:count], visible=visible, motion_valid=valid)


def _in_view(camera, depth, mask, points) -> np.ndarray:
    """(N,) bool: whether the camera saw ``points`` (N, 3) m on a surface of the object."""
    pixels, away = camera.project(points)
    height, width = mask.shape
    front = away > 0
    column, row = np.rint(np.where(front[:, None], pixels, -1)).clip(-1, max(height, width)).astype(int).T
    inside = front & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = (np.where(inside, index, 0) for index in (column, row))
    measured = depth[row, column]
    slack = np.maximum(SLACK, PIXELS * away / camera.intrinsics[0, 0])
    return inside & mask[row, column] & (measured > 0) & (away - measured <= slack)
