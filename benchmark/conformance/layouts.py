"""What every layout must do, on a folder of recordings that it opens."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...datasets.collection import Collection, Layout, layouts, recognises
from ...datasets.scenario import Scenario
from .checking import Skipped, require

__all__ = ["CHECKS", "Subject"]

QUICK = 1.0  # s: every layout is asked about every folder
TRIED = 3  # recordings that are read
FILES = 8  # that are damaged, one at a time
COPIED = 200e6  # bytes: larger folders are not copied in order to be damaged


@dataclass(frozen=True)
class Subject:
    """A layout, and the folder ``path`` of recordings for it, or None where there is none at hand."""

    layout: Layout
    path: Path | None = None

    def given(self) -> Path:
        """The folder."""
        if self.path is None:
            raise Skipped("there is no recording to open: name one with --data")
        return self.path

    def open(self, split="published") -> Collection:
        """What the layout makes of it."""
        return self.layout.open(self.given(), split=split)

    def read(self) -> Iterator[tuple[str, Scenario]]:
        """Some of its recordings."""
        collection = self.open()
        for name in list(collection.scenarios)[:TRIED]:
            yield name, collection.scenarios[name]()


@contextmanager
def _temporary() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder).resolve()


def it_says_what_it_is(subject):
    doc = type(subject.layout).__doc__
    require(isinstance(doc, str) and doc.strip(), "its class must have a docstring, which lists print")


def matches_never_raises_and_recognises_nothing_in_what_is_no_recording(subject):
    with _temporary() as folder:
        junk, empty = folder / "junk", folder / "empty"
        junk.mkdir()
        empty.mkdir()
        for name in ("notes.txt", "x.bin", "é ü\n.dat"):
            (junk / name).write_bytes(bytes(range(256)))
        (junk / "dangling").symlink_to("nowhere")
        (junk / "loop").symlink_to("loop")
        (junk / "folder.pkl").mkdir()
        paths = (junk, empty, folder / "missing", junk / "x.bin", junk / "dangling", junk / "loop", junk / "loop" / "x")
        for path in (*paths, Path("nul\0"), Path("x" * 5000)):
            try:
                found = subject.layout.matches(path)
            except Exception as error:
                said = f"matches must not raise, but did for {str(path)[-20:]!r}: {type(error).__name__}: {error}"
                raise AssertionError(said) from error
            require(not found, f"it recognises {path.name[:20]!r}, where no recording is")


def matches_is_quick_and_recognises_the_recordings(subject):
    path, spent = subject.given(), []
    for _ in range(3):
        begun = time.perf_counter()
        found = subject.layout.matches(path)
        spent.append(time.perf_counter() - begun)
        require(found, f"it does not recognise {path}")
    require(min(spent) < QUICK, f"matches took {min(spent):.1f} s, and every layout is asked about every folder")


def no_other_layout_takes_them(subject):
    path = subject.given()
    for name, layout in layouts().items():
        if name == subject.layout.name:
            return
        require(not recognises(layout, path), f"layout {name!r} comes first, and recognises {path} as well")


def it_opens_a_collection_with_either_split(subject):
    found = {split: subject.open(split) for split in ("published", "clean")}
    for split, collection in found.items():
        require(isinstance(collection, Collection), f"open must return a Collection, got {type(collection).__name__}")
        require(collection.scenarios, f"split {split!r}: it holds no recording")
        require(isinstance(collection.name, str) and collection.name, f"a collection must have a name, got {collection.name!r}")
        for name, read in collection.scenarios.items():
            require(isinstance(name, str) and name.isprintable() and name, f"names of recordings must be printable, got {name!r}")
            require(callable(read), f"scenarios must hold functions that read them, got {type(read).__name__} for {name}")
    for pair in found["clean"].pairs:
        allowed = [set(other.sources) for other in found["published"].pairs if other.target == pair.target]
        require(any(set(pair.sources) <= sources for sources in allowed), f"split 'clean' may only leave sources out, and adds {pair}")
    again = subject.open()
    require(
        (list(again.scenarios), again.pairs) == (list(found["published"].scenarios), found["published"].pairs), "opened twice, it differs"
    )


def recordings_are_scenarios_that_read_the_same_twice(subject):
    for (name, one), (_, two) in zip(subject.read(), subject.read(), strict=True):
        require(isinstance(one, Scenario), f"{name} must be read as a Scenario, got {type(one).__name__}")
        require(one.name == name, f"the scenario of {name!r} is called {one.name!r}")
        for field in ("points", "visible", "motion_valid", "controllers", "surface", "interior", "gravity", "grips"):
            np.testing.assert_array_equal(getattr(one, field), getattr(two, field), err_msg=f"{name}: {field}, read twice")
        require((one.split, one.fps) == (two.split, two.fps), f"{name}: split and fps, read twice, differ")


def recordings_are_in_metres_and_can_be_scored(subject):
    for name, one in subject.read():
        size = float(np.linalg.norm(np.ptp(one.structure, axis=0)))
        require(1e-3 < size < 100, f"{name}: the body is {size:.3g} m long: positions must be in metres")
        strength = float(np.linalg.norm(one.gravity))
        require(strength == 0 or 0.1 < strength < 100, f"{name}: gravity is {strength:.3g} m/s^2")
        require(one.visible.any(axis=1).sum() > 1, f"{name}: points are visible in fewer than 2 frames")
        require(len(one.split.train) > 1, f"{name}: fewer than 2 train frames")
    collection = subject.open()
    require(collection.in_domain or collection.pairs, "no recording is scored: in_domain and pairs are empty")


def images_are_read_when_asked_for(subject):
    pictured = [(name, one) for name, one in subject.read() if one.images is not None]
    if not pictured:
        raise Skipped("its recordings have no images")
    for name, one in pictured:
        camera = one.cameras[0]
        for kind, shape in (("color", (camera.height, camera.width, 3)), ("mask", (camera.height, camera.width))):
            found = np.shape(getattr(one.images, kind)(0, 0))
            require(found == shape, f"{name}: {kind} of camera 0 must have shape {shape}, got {found}")
        for images, frame in ((one.images, one.frame_count), (one.observed().images, one.split.train_end)):
            try:
                images.mask(0, frame)
            except IndexError:
                continue
            raise AssertionError(f"{name}: frame {frame} is out of reach, and must raise IndexError")


def a_damaged_file_is_named(subject):
    path = subject.given().resolve()
    files = [file for file in sorted(path.rglob("*")) if file.is_file()] if path.is_dir() else [path]
    if sum(file.stat().st_size for file in files) > COPIED:
        raise Skipped(f"its files are more than {COPIED / 1e6:.0f} MB")
    with _temporary() as folder:
        copy = folder / path.name
        shutil.copytree(path, copy) if path.is_dir() else shutil.copy(path, copy)
        met = 0
        for file in _some(files):
            broken = copy / file.relative_to(path) if path.is_dir() else copy
            kept = broken.read_bytes()
            for damage in (b"not what it was", kept[: len(kept) // 2], b""):
                broken.write_bytes(damage)
                met += _said_of(subject.layout, copy, broken)
            broken.write_bytes(kept)
    require(met, "none of its files can be damaged so that it says anything")


def _some(files: list[Path]) -> list[Path]:
    """One of each kind first, then others."""
    kinds = {file.suffix: file for file in reversed(files)}
    return [*kinds.values(), *(file for file in files if file not in kinds.values())][:FILES]


def _said_of(layout: Layout, folder: Path, broken: Path) -> bool:
    """Whether reading says that the file is broken. Raises AssertionError where what is said does not name it."""
    said = None
    try:
        if layout.matches(folder):
            for read in layout.open(folder, split="published").scenarios.values():
                read()
    except (ValueError, OSError) as error:
        said = f"{error} {getattr(error, 'filename', '')}"
    except Exception as error:
        raise AssertionError(f"{broken.name}, damaged, must raise ValueError, got {type(error).__name__}: {error}") from error
    # a file of a recording is named by its path, or by its name within the recording's folder
    require(said is None or broken.name in said, f"what is said of a damaged {broken.name} must name it, got {said!r}")
    return said is not None


CHECKS = (
    it_says_what_it_is,
    matches_never_raises_and_recognises_nothing_in_what_is_no_recording,
    matches_is_quick_and_recognises_the_recordings,
    no_other_layout_takes_them,
    it_opens_a_collection_with_either_split,
    recordings_are_scenarios_that_read_the_same_twice,
    recordings_are_in_metres_and_can_be_scored,
    images_are_read_when_asked_for,
    a_damaged_file_is_named,
)
