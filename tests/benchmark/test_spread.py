"""Runs on several graphics cards, with names of cards that are none: processes see one each, and rows are those of one process."""

import os
import time

import pytest
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.experiment import Experiment
from twinbench.benchmark.opening import open_recordings
from twinbench.benchmark.plan import plan
from twinbench.benchmark.processes import VISIBLE, cards, workers
from twinbench.benchmark.runner import Runner, Settings
from twinbench.benchmark.spread import spread
from twinbench.diagnosis.method import METHODS as DIAGNOSED
from twinbench.methods.registry import methods
from twinbench.metrics.base import metrics

TIMES = ("fit_seconds", "rollout_seconds", "peak_memory_mib", "peak_device_memory_mib", "date")


def settings(*names):
    return Settings({name: methods()[name] for name in names}, {name: metrics()[name] for name in ("track_error", "chamfer")})


def test_each_worker_sees_one_card():
    found, late = set(), time.monotonic() + 60
    with workers(3, ("5", "GPU-2f")) as pool:
        while len(found) < 2 and time.monotonic() < late:
            found |= set(pool.map(os.getenv, [VISIBLE] * 12))
    assert found == {"5", "GPU-2f"}


@pytest.mark.parametrize("named, count, expected", [("", 3, ("0", "1", "2")), ("4, GPU-2f", 2, ("4", "GPU-2f")), ("7,9", 1, ("7",))])
def test_cards_are_those_that_this_process_sees(monkeypatch, named, count, expected):
    import torch

    monkeypatch.setenv(VISIBLE, named)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: count)
    assert cards("cuda") == expected and cards("cpu") == ()


@pytest.mark.long
def test_rows_are_those_of_one_process(tmp_path):
    common = settings("static", "rigid")
    opened = open_recordings("sample", split="published", cache=Cache(tmp_path / "one"))
    fits = plan(opened.collection, methods=common.methods, seeds=(0, 1), scenarios=opened.collection.in_domain[:2])
    alone = Runner(opened, common, Cache(tmp_path / "one")).run(fits)
    told = []
    together = spread(opened, common, Cache(tmp_path / "two"), fits, ("0", "1"), progress=lambda label, done: told.append(done))
    assert [{k: v for k, v in row.items() if k not in TIMES} for row in together] == [
        {k: v for k, v in row.items() if k not in TIMES} for row in alone
    ]
    assert told == sorted(told) and told[-1] == 1


def test_an_experiment_uses_all_cards(tmp_path, monkeypatch):
    from twinbench.benchmark import experiment

    used = []

    def spied(*arguments, **options):
        used.append(arguments[4])
        return spread(*arguments, **options)

    monkeypatch.setattr(experiment, "cards", lambda device: ("0", "1"))
    monkeypatch.setattr(experiment, "spread", spied)
    one = Experiment({"static": methods()["static"]}, {"track_error": metrics()["track_error"]}, ("resimulation",))
    opened = open_recordings("sample", split="published", cache=Cache(tmp_path))
    work = one.plan([opened], scenarios=opened.collection.in_domain[:1])
    results = one.run(work, cache=Cache(tmp_path), budget="quick", device="cpu")
    assert used == [("0", "1")] and [row["status"] for row in results.rows] == ["ok"]


def test_what_builds_on_another_twin_waits_for_it(tmp_path):
    # one process makes the twin and then what builds on it, in whatever order they are named
    from twinbench.benchmark.spread import _together

    diagnosed = {method.name: method for method in DIAGNOSED}
    (name,) = [name for name, method in diagnosed.items() if method.builds_on == "phystwin"][:1]
    common = Settings({**methods(), **diagnosed}, {})
    opened = open_recordings("sample", split="published", cache=Cache(tmp_path))
    fits = plan(opened.collection, methods=(name, "phystwin", "static"), scenarios=opened.collection.in_domain[:1])
    groups = [[fits[k].method for k in group] for group in _together(fits, common)]
    alike = [group for group in groups if name in group]
    assert all(group == ["phystwin", name] for group in alike) and len(alike) == len([f for f in fits if f.method == name])
    assert all(group == ["static"] for group in groups if "static" in group)
