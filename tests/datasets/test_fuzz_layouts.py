"""Spoilt files of the real recordings: every reader refuses them in one line that names the file, or opens them."""

import pickle
import shutil
import warnings
from collections import Counter

import numpy as np
import pytest
from fuzz import changed, said_well, spoil_file, within
from twinbench.benchmark.opening import open_scenario
from twinbench.datasets.check import check

LIMIT = 60  # s a case, of some tenths: a hang, not a slow machine
QUICK, COUNT = 12, 50
FRAMES = 60
FOLDERS = {"deform": "data_set/DLO1", "deft": "dataset/BDLO1", "softbeam": "softbeam"}


def few(source, folder):
    """The first two training recordings and one evaluation recording of a cable, shortened; or the beams."""
    if source.name == "softbeam":
        shutil.copytree(source, folder)
        return sorted(folder.glob("*.c3d"))
    for side, count in (("train", 2), ("eval", 1)):
        (folder / side).mkdir(parents=True)
        for file in sorted((source / side).glob("*.pkl"))[:count]:
            shutil.copy(file, folder / side)
    if source.name.startswith("DLO"):  # a frame each; those of DEFT have the length that their names say
        for file in folder.glob("*/*.pkl"):
            file.write_bytes(pickle.dumps(pickle.loads(file.read_bytes())[:FRAMES]))
    return sorted(folder.glob("*/*.pkl"))


def spoil(file, random):
    if file.suffix == ".c3d" and random.random() < 0.6:
        data = bytearray(file.read_bytes())
        for at in random.integers(1536, size=random.integers(1, 6)):  # header and parameters
            data[at] = random.integers(256)
        file.write_bytes(bytes(data))
        return f"{file.name} overwritten"
    if file.suffix == ".c3d" or random.random() < 0.3:
        return spoil_file(file, random)
    how, data = changed(pickle.loads(file.read_bytes()), random)
    file.write_bytes(pickle.dumps(data.tolist() if isinstance(data, np.ndarray) and random.random() < 0.5 else data))
    return f"{file.name} {how}"


@pytest.mark.long
@pytest.mark.parametrize("count", [QUICK, pytest.param(COUNT, marks=pytest.mark.slow)])
@pytest.mark.parametrize("layout", FOLDERS)
def test_spoilt_recordings_are_refused_in_one_line_or_opened(recordings, tmp_path, capfd, layout, count):
    source, random, outcomes, broken = recordings / FOLDERS[layout], np.random.default_rng(3), Counter(), []
    whole = tmp_path / "whole" / source.name
    names = [file.relative_to(whole) for file in few(source, whole)]
    assert not [f for f in check(whole) if f.severity == "error"]
    for number in range(count):
        folder = shutil.copytree(whole, tmp_path / str(number) / source.name)
        done = spoil(folder / names[random.integers(len(names))], random)
        refused = {}
        try:
            with within(LIMIT), warnings.catch_warnings():
                warnings.filterwarnings("error", category=DeprecationWarning)
                warnings.simplefilter("ignore", RuntimeWarning)  # of means over markers that were never seen
                errors = [f"{f.file}: {f.said}" for f in check(folder) if f.severity == "error"]
                for name in names:
                    try:
                        open_scenario(str(folder / name.with_suffix("")))
                    except ValueError as error:
                        refused[name] = str(error)
        except Exception as error:
            broken.append(f"case {number}: {done}: {error!r}")
            continue
        outcomes["refused" if errors else "opened"] += 1
        gone = {name: said for name, said in refused.items() if "and none named" in said}  # its file is not there any more
        if bool(errors) != bool(set(refused) - set(gone)):
            broken.append(f"case {number}: {done}: check says {errors[:1]}, opening {refused}")
        for said in (*errors, *(set(refused.values()) - set(gone.values()))):
            if not said_well(said, folder):
                broken.append(f"case {number}: {done}: badly said: {said}")
        shutil.rmtree(folder.parent)
    assert capfd.readouterr().out == ""
    assert not broken, "\n".join([f"{len(broken)} faults, {dict(outcomes)}", *broken])
    assert outcomes["refused"] >= count // 4, outcomes
