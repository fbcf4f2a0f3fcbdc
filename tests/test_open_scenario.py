"""Which recording a path names, and what is said where it names none or several."""

import numpy as np
import pytest
from twinbench.benchmark.opening import open_scenario
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


def test_a_damaged_recording_is_said_to_be_damaged(folder):
    (folder / "cases" / "lift" / "split.json").write_text("{")
    with pytest.raises(ValueError, match=r"split\.json"):
        open_scenario(str(folder / "cases" / "lift"))
