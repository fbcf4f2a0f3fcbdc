"""What goes into the cache's keys: the content of recordings.

Hashing recordings needs reading them, which takes longer than a cached run may; so the hashes of a folder's recordings are remembered
as long as none of its files changes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass
from functools import partial

import numpy as np

from ..datasets.scenario import Images, Scenario
from .cache import Cache

__all__ = ["Checksums", "checksum", "image_checksum", "images_of", "interaction_of", "observed_checksum", "observed_of"]

USUAL = {"start_frames": (1,), "timed": (True,), "correspond": (True,), "actuation": (None,)}


def checksum(scenario: Scenario) -> str:
    """Hexadecimal SHA-256 of everything a scenario holds but its name and its images (which are read lazily).

    What is usual, as that one frame shows how it starts and that points correspond, has no part in it.
    """
    state = hashlib.sha256()
    usual = {"name"} | {
        name for name, value in USUAL.items() if type(getattr(scenario, name)) is type(value) and getattr(scenario, name) == value
    }
    _feed(state, {f.name: getattr(scenario, f.name) for f in fields(scenario) if f.name not in usual})
    return state.hexdigest()


def image_checksum(scenario: Scenario) -> str:
    """Hexadecimal SHA-256 of the images that are looked at: all of frame 0, and camera 0's colours and masks in every frame.

    An image that cannot be read counts by the error that says so; "" where the recording has none.
    """
    state, images = hashlib.sha256(), scenario.images
    if images is None:
        return ""
    kinds = {kind: getattr(images, kind) for kind in ("color", "mask", "human_mask", "depth")}
    wanted = [(kind, camera, 0) for kind in kinds for camera in range(len(scenario.cameras))]
    wanted += [(kind, 0, frame) for frame in range(1, scenario.frame_count) for kind in kinds if kind != "depth"]
    for kind, camera, frame in wanted:
        _feed_image(state, kinds[kind], camera, frame)
    return state.hexdigest()


def observed_checksum(scenario: Scenario, kinds: Iterable[str]) -> str:
    """Hexadecimal SHA-256 of all that a fit may see of these kinds of images: every camera's, in the train frames.

    An image that cannot be read counts by the error that says so; "" where the recording has none.
    """
    state, images = hashlib.sha256(), scenario.images
    if images is None:
        return ""
    for kind in sorted(kinds):
        for camera in range(len(scenario.cameras)):
            for frame in scenario.split.train:
                _feed_image(state, getattr(images, kind), camera, frame)
    return state.hexdigest()


def _feed_image(state, read, camera: int, frame: int) -> None:
    try:
        _feed(state, np.asarray(read(camera, frame)))
    except (OSError, ValueError, IndexError) as error:
        _feed(state, str(error))


def _feed(state, value) -> None:
    if isinstance(value, np.ndarray):
        state.update(f"{value.dtype.str}{value.shape}".encode())
        state.update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value) and not isinstance(value, Images):
        _feed(state, {f.name: getattr(value, f.name) for f in fields(value)})
    elif isinstance(value, dict):
        for key in sorted(value):
            state.update(f"<{key}>".encode())
            _feed(state, value[key])
    elif isinstance(value, tuple):
        _feed(state, {str(i): item for i, item in enumerate(value)})
    elif not isinstance(value, Images):
        state.update(f"{type(value).__name__} {value!r};".encode())


class Checksums:
    """Checksums of recordings by name, and by ``interaction_of``, ``images_of`` and ``observed_of`` that name of what they show.

    They are remembered in ``cache`` under ``key`` where there is one.
    """

    def __init__(self, cache: Cache, key: str | None = None):
        self._cache, self._key = cache, key
        self._known: dict[str, str] = (cache.read("checksums", key) if key else None) or {}

    def learn(self, names: Iterable[str], load: Callable[[str], Scenario], *, images: bool = False, fitted: Iterable[str] = ()) -> None:
        """Read with ``load`` those recordings of which a checksum is not known yet: of the arrays, with ``images`` of the images that are
        looked at, and of those kinds of images that a fit sees, ``fitted``.
        """
        fitted = tuple(fitted)
        wanted = {str: checksum, interaction_of: lambda scenario: scenario.interaction, **({images_of: image_checksum} if images else {})}
        if fitted:
            wanted[partial(observed_of, kinds=fitted)] = partial(observed_checksum, kinds=fitted)
        unknown = [name for name in dict.fromkeys(names) if any(of(name) not in self._known for of in wanted)]
        for name in unknown:
            scenario = load(name)
            for of, compute in wanted.items():
                self._known[of(name)] = compute(scenario)
        if unknown and self._key is not None:
            self._cache.write("checksums", self._key, self._known)

    def __getitem__(self, name: str) -> str:
        """The checksum of a recording, or of its ``interaction_of``, ``images_of`` or ``observed_of``, which was learnt."""
        return self._known[name]


def interaction_of(name: str) -> str:
    """The name by which the interaction in a recording is known."""
    return f"{name}\ninteraction"


def images_of(name: str) -> str:
    """The name by which the images of a recording are known."""
    return f"{name}\nimages"  # no recording's name holds a line break


def observed_of(name: str, kinds: Iterable[str]) -> str:
    """The name by which what a fit sees of these kinds of images is known."""
    return f"{name}\nobserved {' '.join(sorted(kinds))}"
