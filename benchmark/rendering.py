"""What cameras would see of a roll-out: one appearance per recording and set of quirks, and roll-outs that can be looked at."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from ..datasets.scenario import Camera, Images, Scenario
from ..methods.appearance.config import Quirks, quirks_named
from ..methods.base import Trajectory
from ..methods.modules import modules_of
from ..metrics.base import Unscorable
from .cache import Cache
from .origin import Origin
from .sources import SOURCES

__all__ = ["Appearances", "Recent", "Shown", "appearance_class"]

SEED = 0  # the appearance is the recording's, not a twin's: all seeds of a run share it


def appearance_class() -> type:
    """The appearance that twins are shown with."""
    from ..methods.appearance import Appearance

    return Appearance


class Appearances:
    """The appearance of each recording in frame 0, fitted once by the views of that frame for each set of quirks, and kept in the cache.

    As in PhysTwin's evaluation (arXiv 2503.17973, section 5) roll-outs of all methods that are shown alike move the same appearance of the
    recording they are scored on, a transfer's the target's. ``folder`` is where the recordings are, ``kind()`` is its class: ``fit``,
    ``load``, ``save`` and ``animate`` as in ``methods/appearance``; or what stands in for it, with a ``key`` of the files that it reads.
    """

    def __init__(self, cache: Cache, *, preset: str, device: str, folder: str = "", kind: Callable[[], type] = appearance_class):
        self._cache, self._preset, self._device, self._folder, self._kind = cache, preset, device, folder, kind
        self._last: dict[str, tuple[str, object]] = {}

    def of(self, scenario: Scenario, checksums: Mapping[str, str], look: str, progress: Callable[[str, float], None]) -> Any:
        """The appearance of ``scenario`` with the quirks that ``look`` names; ``checksums`` are those of its arrays and of its images, by
        their names.

        Raises Unscorable where it can have none, and whatever else stops a fit.
        """
        quirks = quirks_named(look)
        origin = self._origin(scenario, checksums, look, quirks)
        if self._last.get(look, ("",))[0] != origin.key:
            try:
                self._last[look] = (origin.key, self._read(origin.key) or self._fit(scenario, origin, quirks, progress))
            except ValueError as error:
                self._last[look] = (origin.key, Unscorable(f"the recording has no appearance: {error}"))
        found = self._last[look][1]
        if isinstance(found, Unscorable):
            raise Unscorable(str(found))
        return found

    def _origin(self, scenario: Scenario, checksums: Mapping[str, str], look: str, quirks: Quirks) -> Origin:
        modules = modules_of(self._kind())
        inputs = {"code": SOURCES.files(*modules), "data": list(checksums.values()), "method": asdict(quirks)}
        inputs |= {"look": look, "seed": SEED, "preset": self._preset, "device": self._device, "kind": getattr(self._kind(), "key", None)}
        subject = {"recordings": [scenario.name], "folder": self._folder, "data": list(checksums), "modules": list(modules)}
        return Origin(inputs, subject)

    def _fit(self, scenario: Scenario, origin: Origin, quirks: Quirks, progress):
        options = {"preset": self._preset, "seed": SEED, "device": self._device, "progress": progress, "quirks": quirks}
        fitted = self._kind().fit(scenario.initial(), **options)
        self._cache.write_folder("appearances", origin.key, fitted.save, {}, origin.made)
        return self._read(origin.key) or fitted

    def _read(self, key: str):
        """The appearance as the cache holds it, so that a resumed run and an uninterrupted one draw the same."""
        stored = self._cache.read_folder("appearances", key)
        return self._kind().load(stored[0]) if stored else None


@dataclass(frozen=True)
class Shown(Trajectory):
    """A roll-out that can be looked at. ``animate()`` gives what draws it, and is called when the first image is asked for.

    Whatever goes wrong then is a reason why there are no images; where it may be gone another time, it is in ``faults``.
    """

    animate: Callable[[], Any] = field(repr=False)
    faults: list[str] = field(default_factory=list)
    _kept: dict = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, trajectory: Trajectory, appearance: Callable[[], Any]) -> Shown:
        """``trajectory`` moving what ``appearance()`` gives, as far as it is finite."""
        lost = np.flatnonzero(~np.isfinite(trajectory.positions).all(axis=(1, 2)))
        good = np.array(trajectory.positions[: lost[0] if len(lost) else None])
        return cls(trajectory.positions, trajectory.counts, lambda: appearance().animate(Trajectory(good, trajectory.counts)))

    @cached_property
    def _animated(self):
        return self.animate()

    def image(self, camera: Camera, frame: int) -> np.ndarray:
        """(H, W, 4) floats in [0, 1]: colour over black and opacity. The images of one frame are kept. Raises Unscorable."""
        key = frame, camera.intrinsics.tobytes(), camera.camera_to_world.tobytes(), camera.width, camera.height
        if self.faults:
            raise Unscorable(self.faults[0])
        if key not in self._kept:
            if any(kept != frame for kept, *_ in self._kept):
                self._kept.clear()
            try:
                self._kept[key] = self._animated.image(camera, frame)
            except Unscorable:
                raise
            except Exception as error:  # memory, a full disk, a missing package: the other columns must still come
                self.faults.append(f"the appearance cannot be drawn: {type(error).__name__}: {error}")
                raise Unscorable(self.faults[0]) from error
        return self._kept[key]


class Recent:
    """Images that keep the last one of each kind, so that metrics which look at one frame in turn read it once."""

    def __init__(self, images: Images):
        self._images = images
        self.color, self.mask, self.human_mask = (lru_cache(maxsize=1)(read) for read in (images.color, images.mask, images.human_mask))

    def __getattr__(self, name: str):
        return getattr(self._images, name)
