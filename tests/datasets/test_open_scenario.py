"""Which recording a path names, and what is said where it names none or several."""

import os
from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.opening import listing, open_scenario
from twinbench.datasets.collection import Collection
from twinbench.datasets.phystwin import write_case
from twinbench.datasets.scenario import Scenario, Split


@pytest.fixture
def folder(tmp_path):
    root = tmp_path / "by" / "itself"  # beside no recordings of other tests
    points = np.random.default_rng(0).uniform(0, 0.1, (4, 5, 3))
    there = np.ones((4, 5), bool)
    given = dict(points=points, visible=there, motion_valid=there, controllers=points[:, :1], split=Split(3, 4))
    for name in ("lift", "push"):
        write_case(root / "cases" / name, Scenario(name=name, **given))
    write_case(root / "alone" / "only", Scenario(name="only", **given))
    return root


def test_a_recording_is_named_by_its_folder_or_by_its_name_in_one(folder):
    assert open_scenario(str(folder / "cases" / "lift")).name == "lift"
    assert open_scenario(str(folder / "alone")).name == "only"  # the only one there
    assert open_scenario("sample/plush_drag").name == "plush_drag"


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("cases", "holds 2 recordings (lift, push); name one: {folder}/cases/NAME"),
        ("cases/lifd", "holds 2 recordings (lift, push), and none named 'lifd'"),
        ("nowhere", "no recording at {folder}/nowhere: no recordings at {folder}: none of the layouts"),
        ("nowhere/at/all", "no recording at {folder}/nowhere/at/all: "),
    ],
)
def test_what_names_no_recording_is_told(folder, path, said):
    with pytest.raises(ValueError) as caught:
        open_scenario(str(folder / path))
    assert said.format(folder=folder) in str(caught.value)


def test_a_path_that_leads_nowhere_at_all():
    with pytest.raises(ValueError, match="no recording at /no/such/folder: no such file or folder"):
        open_scenario("/no/such/folder")


def test_a_link_back_up_is_not_walked(folder, tmp_path):
    (tmp_path / "elsewhere").write_text("x")
    before = listing(folder / "cases")
    for name, to in (("up", tmp_path), ("itself", folder / "cases"), ("root", "/")):
        (folder / "cases" / name).symlink_to(to)
    (folder / "cases" / "loop").symlink_to("loop")
    os.mkfifo(folder / "cases" / "pipe")
    assert listing(folder / "cases") == before
    assert open_scenario(str(folder / "cases" / "lift")).name == "lift"


def test_a_folder_of_too_many_files_is_refused(folder, monkeypatch):
    monkeypatch.setattr("twinbench.benchmark.opening.MOST_FILES", 5)
    with pytest.raises(ValueError, match="cases: recordings must have at most 5 files in all, got more"):
        listing(folder / "cases")


def test_what_cannot_belong_together_is_refused_wherever_it_comes_from(folder):
    """A layout of somebody else's need not know the rules: the collection does."""
    one = open_scenario(str(folder / "alone"))
    others = Collection("others", {"far": lambda: replace(one, controllers=one.controllers + 74, tracks=None)})
    with pytest.raises(ValueError, match=r"controllers must be within reach of the body, .* got 12.* \(scenario far of others\)"):
        others.load("far")


def test_a_damaged_recording_is_said_to_be_damaged(folder):
    (folder / "cases" / "lift" / "split.json").write_text("{")
    with pytest.raises(ValueError, match=r"split\.json"):
        open_scenario(str(folder / "cases" / "lift"))
