"""The authors' own twins as methods of a table: "fitted" by reading them, and rolled out by our engine or as they were stored."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..methods.base import Diverged, Method, Trajectory, Twin
from ..methods.phystwin.released import Files, read_trajectory, read_twin
from ..methods.phystwin.twin import PhysTwinTwin

__all__ = ["ENGINE", "STORED", "Engine", "Looks", "Reader", "Rolled", "Stored", "StoredTrajectory"]

ENGINE, STORED = "phystwin (released, our engine)", "phystwin (released, stored trajectory)"
NOT_STORED = "the authors publish a twin's roll-out on its own recording, and on no other"


def _content(files) -> str:
    """Hexadecimal SHA-256 of what is in ``files``, one after the other."""
    state = hashlib.sha256()
    for file in files:
        state.update(f"{Path(file).name}\n".encode())
        with Path(file).open("rb") as opened:
            state.update(hashlib.file_digest(opened, "sha256").digest())
    return state.hexdigest()


@dataclass(frozen=True)
class Rolled(Twin):
    """A twin and its roll-out ``positions`` (T, M, 3) [m] under its own recording's controllers, made once to be compared as well as
    scored; None where the simulation blew up."""

    twin: PhysTwinTwin
    positions: np.ndarray | None

    def rollout(self, controllers):
        if self.positions is not None and np.array_equal(controllers, self.twin.place.controllers):
            return Trajectory(self.positions, self.twin.place.counts)
        return self.twin.rollout(controllers)

    def retarget(self, target):
        return self.twin.retarget(target)

    def save(self, folder):
        self.twin.save(Path(folder) / "twin")
        if self.positions is not None:
            np.save(Path(folder) / "positions.npy", self.positions, allow_pickle=False)

    @classmethod
    def load(cls, folder):
        file = Path(folder) / "positions.npy"
        return cls(PhysTwinTwin.load(Path(folder) / "twin"), np.load(file, allow_pickle=False) if file.is_file() else None)


@dataclass(frozen=True)
class Stored(Twin):
    """A roll-out (T, M, 3) [m] that was computed elsewhere; ``counts`` of tracked, surface and interior particles."""

    positions: np.ndarray
    counts: tuple[int, int, int]

    def rollout(self, controllers):
        return Trajectory(self.positions, self.counts)

    def retarget(self, target):
        """Raises ValueError: there is no such thing."""
        raise ValueError(NOT_STORED)

    def save(self, folder):
        Path(folder).mkdir(parents=True, exist_ok=True)
        np.savez_compressed(Path(folder) / "twin.npz", positions=self.positions, counts=self.counts)

    @classmethod
    def load(cls, folder):
        with np.load(Path(folder) / "twin.npz", allow_pickle=False) as arrays:
            return cls(arrays["positions"], tuple(arrays["counts"].tolist()))


class _Released(Method):
    """A method that reads what ``found``, by the name of a recording, was released of it."""

    appearance = "as-published"

    def __init__(self, found: Mapping[str, Files]):
        self.found = found


class Engine(_Released):
    """The released twin, rolled out by our engine; placed in other recordings as published."""

    name = ENGINE
    twin_class = Rolled

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        twin = read_twin(self.found[observed[0].name], observed[0], device=device)
        try:
            return Rolled(twin, twin.rollout(observed[0].controllers).positions)
        except Diverged:  # whoever asks for the roll-out is told
            return Rolled(twin, None)


class StoredTrajectory(_Released):
    """The roll-out that the authors stored with their twin."""

    name = STORED
    twin_class = Stored
    skip_transfer = NOT_STORED

    def skip(self, scenario):
        file = self.found[scenario.name].trajectory
        return None if file.exists() else f"no trajectory was stored: {file} is not there"

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        return Stored(read_trajectory(self.found[observed[0].name].trajectory, observed[0]), observed[0].counts)


@dataclass(frozen=True)
class Reader:
    """Makes such a method when called. Its twins are known by what is in the files."""

    kind: type[_Released]
    found: Mapping[str, Files]
    key: list = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "key", [self.kind.name, {name: _content(files) for name, files in self.found.items()}])

    def __call__(self) -> Method:
        return self.kind(self.found)

    @property
    def appearance(self) -> str:
        """What its roll-outs are shown with."""
        return self.kind.appearance


@dataclass(frozen=True)
class Looks:
    """The appearances of recordings: the released Gaussians where there are any, else fitted as ever. As ``Appearances`` asks for them."""

    found: Mapping[str, Files]
    key: dict = field(init=False)

    def __post_init__(self):
        clouds = {name: cloud for name, files in self.found.items() if (cloud := files.point_cloud)}
        object.__setattr__(self, "key", {name: _content([cloud]) for name, cloud in clouds.items()})

    def __call__(self) -> Looks:
        return self

    def fit(self, observed, *, device="cpu", quirks, **options):
        """The appearance of frame 0. Raises ValueError where a file is no .ply of Gaussians, or a recording can have none."""
        from ..methods.appearance import Appearance
        from ..methods.appearance.published import read_gaussians

        if observed.name in self.key:
            cloud = self.found[observed.name].point_cloud
            assert cloud is not None  # or it would have no key
            return Appearance(read_gaussians(cloud), quirks, device)
        return Appearance.fit(observed, device=device, quirks=quirks, **options)

    def load(self, folder):
        """What was kept of it."""
        from ..methods.appearance import Appearance

        return Appearance.load(folder)
