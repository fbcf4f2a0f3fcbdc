"""What every layout must do, run over every layout that is found, on small recordings; and that the checks notice what is wrong."""

import pickle
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from twinbench.benchmark.conformance.checking import Skipped, outcomes
from twinbench.benchmark.conformance.layouts import CHECKS, Subject
from twinbench.benchmark.opening import folder_of
from twinbench.datasets.collection import Collection, layouts
from twinbench.datasets.scenario import Scenario, Split


def rope(seed, frames=20, count=7):
    """(T, V, 3) m: a rope that swings between two ends."""
    x = np.linspace(0, 0.6, count)
    swing = 0.02 * np.sin(np.linspace(0, 2, frames) + seed)[:, None] * np.sin(np.pi * x / 0.6)
    return np.stack([np.broadcast_to(x, swing.shape), swing, 0.5 + 0 * swing], -1)


def branched(seed, frames=20):
    """(T, V, 3) m: a cable of 12 markers, from two joints of which branches of 2 and 3 markers hang."""
    main = rope(seed, frames, 12)
    down = np.array([0, -0.08, 0])
    branches = [main[:, [joint]] + np.arange(1, count + 1)[:, None] * down for joint, count in ((4, 2), (7, 3))]
    return np.concatenate([main, *branches], 1)


def deform(root):
    for side, seeds in (("train", (1, 2)), ("eval", (3,))):
        (root / "DLO2" / side).mkdir(parents=True)
        for seed in seeds:
            (root / "DLO2" / side / f"{seed}.pkl").write_bytes(pickle.dumps(rope(seed).transpose(0, 2, 1).tolist()))
    return root / "DLO2"


def deft(root):
    for side, seeds in (("train", (1, 2)), ("eval", (3,))):
        (root / "BDLO3" / side).mkdir(parents=True)
        for seed in seeds:
            block = tuple(branched(seed).transpose(2, 0, 1).reshape(3, -1).tolist())
            (root / "BDLO3" / side / f"take_block{seed}_frames{1000 * seed}to{1000 * seed + 19}.pkl").write_bytes(pickle.dumps([block]))
    return root / "BDLO3"


def softbeam(root):
    ezc3d = pytest.importorskip("ezc3d")
    from twinbench.datasets.softbeam import NOMINAL

    for name in ("beam_load_a", "beam_load_b"):
        markers = np.broadcast_to(NOMINAL, (100, 6, 3)).copy()
        markers[40:, :3, 2] -= 0.01 * np.sin(np.arange(60) / 5)[:, None]  # held, then let go
        file = ezc3d.c3d()
        file["parameters"]["POINT"]["UNITS"]["value"] = ["m"]
        file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
        file["parameters"]["POINT"]["LABELS"]["value"] = tuple(f"{end} - {k}" for end in ("Tip", "Base") for k in (1, 2, 3))
        file["data"]["points"] = np.concatenate([markers, np.ones_like(markers[..., :1])], -1).transpose(2, 1, 0)
        file.write(str(root / f"{name}.c3d"))
    return root


def diffcloud(root):
    from clips import write

    write(root, "fold"), write(root, "lift", times=2)
    return root


def trunk(root):
    from releases import folder

    return folder(root)


FOLDERS = {"deform": deform, "deft": deft, "diffcloud": diffcloud, "softbeam": softbeam, "trunk": trunk}
FOLDERS["phystwin"] = lambda root: folder_of("sample")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    made = {}

    def folder(name):
        if name not in made:
            made[name] = FOLDERS[name](tmp_path_factory.mktemp(name))
        return made[name]

    return folder


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", layouts())
def test_layout(name, check, folders):
    try:
        check(Subject(layouts()[name], folders(name)))
    except Skipped as reason:
        assert (name == "phystwin") != (check.__name__ == "images_are_read_when_asked_for")  # of ours, only that has images
        pytest.skip(str(reason))


class Right:
    """Folders of numbers, a recording each."""

    name = "numbers"

    def matches(self, path):
        return Path(path).name == "numbers"

    def read(self, file, name):
        try:
            points = np.load(file, allow_pickle=False)
        except (ValueError, EOFError) as error:
            raise ValueError(f"{file}: {error}") from error
        shape = points.shape[:2]
        split = Split(7, len(points))
        seen = dict(visible=np.ones(shape, bool), motion_valid=np.ones(shape, bool))
        return Scenario(name=name, points=points, controllers=np.zeros((len(points), 0, 3)), split=split, **seen)

    def open(self, path, *, split="published"):
        files = {file.stem: file for file in sorted(Path(path).glob("*.npy"))}
        return Collection("numbers", {name: partial(self.read, file, name) for name, file in files.items()}, tuple(files))


class Raises(Right):
    def matches(self, path):
        return any("numbers" in file.name for file in Path(path).parent.iterdir())


class Greedy(Right):
    def matches(self, path):
        return True


class Blind(Right):
    def matches(self, path):
        return False


class Renamed(Right):
    def read(self, file, name):
        return super().read(file, "one")


class Millimetres(Right):
    def read(self, file, name):
        made = super().read(file, name)
        return Scenario(**{**vars(made), "points": made.points * 1000})


class Drifting(Right):
    def read(self, file, name):
        made = super().read(file, name)
        return Scenario(**{**vars(made), "points": made.points + np.random.default_rng().random()})


class Mute(Right):
    def read(self, file, name):
        try:
            return super().read(file, name)
        except (ValueError, OSError):
            raise ValueError("something is wrong") from None


class Crashing(Right):
    def read(self, file, name):
        try:
            return super().read(file, name)
        except (ValueError, OSError):
            raise KeyError("points") from None


class Unsplit(Right):
    def open(self, path):
        return super().open(path)


class Unscored(Right):
    def open(self, path, *, split="published"):
        return Collection("numbers", super().open(path).scenarios)


@pytest.mark.parametrize(
    ("kind", "noticed"),
    [
        (Raises, "matches never raises and recognises nothing in what is no recording"),
        (Greedy, "matches never raises and recognises nothing in what is no recording"),
        (Blind, "matches is quick and recognises the recordings"),
        (Renamed, "recordings are scenarios that read the same twice"),
        (Drifting, "recordings are scenarios that read the same twice"),
        (Millimetres, "recordings are in metres and can be scored"),
        (Unscored, "recordings are in metres and can be scored"),
        (Mute, "a damaged file is named"),
        (Crashing, "a damaged file is named"),
        (Unsplit, "it opens a collection with either split"),
        (Right, None),
    ],
)
def test_what_a_layout_does_wrong_is_noticed(kind, noticed, tmp_path):
    (tmp_path / "numbers").mkdir()
    np.save(tmp_path / "numbers" / "a.npy", rope(1))
    np.save(tmp_path / "numbers" / "b.npy", rope(2))
    kind.__doc__ = Right.__doc__
    failed = [outcome.check for outcome in outcomes(CHECKS, Subject(kind(), tmp_path / "numbers")) if outcome.status == "failed"]
    assert noticed in failed if noticed else not failed
