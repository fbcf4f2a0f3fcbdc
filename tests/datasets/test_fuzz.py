"""Hundreds of spoilt recordings: nothing raises but ValueError, nothing hangs, refusals say what is wrong, and check and run agree."""

import shutil
import warnings
from collections import Counter

import numpy as np
import pytest
from clean_case import clean
from fuzz import said_well, spoil, within
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.opening import open_recordings, open_scenario
from twinbench.datasets.check import check
from twinbench.metrics.base import get_metric, score

LIMIT = 20  # s a case, of some 0.1: a hang, not a slow machine


def attempted(do):
    """What ``do`` returns, and the words of its ValueError. Any other exception is a fault."""
    try:
        with within(LIMIT):
            return do(), None
    except ValueError as error:
        return None, str(error)


def run(folder, cache):
    """``run --methods static`` without its printing: the recording is opened, the twin fitted, every metric asked."""
    from twinbench.methods.base import Budget
    from twinbench.methods.registry import get_method

    collection = open_recordings(str(folder), split="published", cache=Cache(cache)).collection
    (name,) = collection.scenarios
    scenario = collection.load(name)
    twin = get_method("static").fit([scenario.observed()], budget=Budget("quick"))
    trajectory = twin.rollout(scenario.controllers)
    for metric in ("chamfer", "track_error", "coordinate_error"):
        score(get_metric(metric), trajectory, scenario, range(1, scenario.frame_count))
    return scenario


def images_read(scenario):
    """The refusals of all images, each of which names its file."""
    found = []
    if scenario.images is None:
        return found
    for kind in ("color", "depth", "mask", "human_mask"):
        for camera in range(len(scenario.cameras)):
            for frame in range(scenario.frame_count):
                image, refusal = attempted(lambda k=kind, c=camera, f=frame: getattr(scenario.images, k)(c, f))
                assert (image is None) != (refusal is None)
                found += [refusal] if refusal else []
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return clean(tmp_path_factory.mktemp("whole") / "case")


def outcome(folder, cache):
    """How a spoilt case ends, and what of all that is promised is not kept."""
    broken = []
    with within(LIMIT), warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy's, of overflows and empty means, are a fault of ours
        found = check(folder)
        scenario, refused = attempted(lambda: run(folder, cache))
        _, not_diagnosed = attempted(lambda: open_scenario(str(folder)))
        lost = images_read(scenario) if scenario else []
    errors = [f"{f.file}: {f.said}" for f in found if f.severity == "error"]
    if (refused is None) != (not errors) or refused != not_diagnosed or (refused and refused not in errors[0]):
        broken.append(f"check says {errors[:1]}, run {refused}, diagnose {not_diagnosed}")
    broken += [f"badly said: {message}" for message in (*errors, *lost) if not said_well(message, folder)]
    broken += [f"badly shown: {f}" for f in found if "\n" in str(f) or "\x1b" in str(f)]
    if not found and any("the image is damaged, i" not in message for message in lost):  # what is packed wrongly, only unpacking shows
        broken.append(f"check is silent, and there are no images: {lost[0]}")
    kind = "refused" if refused else "opened, images lost" if lost else "opened with warnings" if found else "opened"
    return kind, broken


def campaign(whole, tmp_path, capfd, seed, count):
    """How ``count`` spoilt cases ended; each must keep all that is promised, and nothing must be printed, by OpenCV neither."""
    random, outcomes, broken = np.random.default_rng(seed), Counter(), []
    for number in range(count):
        root = tmp_path / str(number)
        folder = shutil.copytree(whole, root / "case", symlinks=True)
        done = spoil(folder, random)
        try:
            kind, faults = outcome(folder, root / "cache")
        except Exception as error:  # a traceback, a hang or a warning
            kind, faults = type(error).__name__, [repr(error)]
        printed = capfd.readouterr()
        faults += [f"printed: {text}" for text in printed if text]
        broken += [f"seed {seed}, case {number}: {done}: {fault}" for fault in faults]
        outcomes[kind] += 1
        shutil.rmtree(root)
    assert not broken, "\n".join([f"{len(broken)} faults, {dict(outcomes)}", *broken])
    return outcomes


@pytest.mark.long
def test_spoilt_cases_are_refused_in_one_line_or_opened(whole, tmp_path, capfd):
    outcomes = campaign(whole, tmp_path, capfd, seed=1, count=60)
    assert outcomes["refused"] > 15 and outcomes.total() - outcomes["refused"] > 5, outcomes


@pytest.mark.slow
def test_700_spoilt_cases(whole, tmp_path, capfd):
    outcomes = campaign(whole, tmp_path, capfd, seed=2, count=700)
    with capfd.disabled():
        print(dict(outcomes))
    assert outcomes["refused"] > 200 and outcomes.total() == 700
