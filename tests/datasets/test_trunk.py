"""The trunk: synthetic releases and commands in the published layout, and the published recordings themselves."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from releases import bent, folder, released, table
from twinbench.benchmark.release_twins import repeatability
from twinbench.datasets.collection import open_collection
from twinbench.datasets.trunk import ANGLES, BASE, COMMANDS, read_table, unseen


def test_a_release_begins_where_the_hand_has_let_go(tmp_path):
    # held until frame 30; the tip then sets off at 3 / s times 0.5 rad over 0.2 m or so, 3 to 4 mm in the next frame
    one = open_collection(folder(tmp_path)).load("decay_200g/1")
    assert one.frame_count == 150 and one.start_frames == 2
    np.testing.assert_allclose(one.tracks[0], released(seed=1)[180 - one.frame_count], atol=1e-6)
    np.testing.assert_array_equal(one.controllers, np.broadcast_to(BASE, (one.frame_count, 2, 3)))
    assert one.grips.tolist() == [0, 1] and one.points.shape[1] == 5 and one.fps == 100 and one.gravity.tolist() == [0, -9.81, 0]
    assert one.object == "trunk_200g" and one.visible.all() and one.actuation is None
    # what fills the trunk between the markers lies on its axis: within 2 mm of the inclined parts, which bend by 8 degrees at most
    nearest = np.linalg.norm(one.interior[:, None] - np.concatenate([BASE, one.tracks[0]])[None], axis=2).min(1)
    assert nearest.max() < 0.07 and np.abs(one.interior[:, 2] - 0.104).max() < 1e-3


def test_a_hand_that_takes_hold_again_ends_it(tmp_path):
    again = released(swinging=400)
    again = np.concatenate([again, again[::-1][:390]])  # taken back to where it was 0.1 s after its release
    table(tmp_path / "observations_decay_200g.csv", [again, again, again])
    one = open_collection(tmp_path).load("decay_200g/0")
    assert 400 < one.frame_count < 400 + 390
    assert np.linalg.norm(one.tracks[-1] - bent(np.zeros((1, 3)))[0], axis=-1).max() < 0.01


def test_what_is_repeated_or_swapped_is_not_seen():
    disks = released()
    disks[50, 2] = disks[49, 2]
    disks[60] = disks[60][[1, 0, 2]]
    expected = np.zeros((180, 3), bool)
    expected[50, 2] = expected[60] = True
    np.testing.assert_array_equal(unseen(disks), expected)


def test_files_of_a_load_are_fitted_and_scored(tmp_path):
    found = open_collection(folder(tmp_path))
    sources = ("decay_200g/0", "decay_200g/1", "decay_200g/2")
    assert [(p.sources, p.target) for p in found.pairs] == [(sources, "decay_200g_2/0"), (sources, "decay_200g_2/1")]
    (tmp_path / "one").mkdir()
    found = open_collection(folder(tmp_path / "one", second=False))
    assert [(p.sources, p.target) for p in found.pairs] == [(sources[:2], sources[2])]


def test_commands_and_angles_are_kept(tmp_path):
    folder(tmp_path)
    random = np.random.default_rng(0)
    commands, angles = random.normal(size=(180, 6)), random.normal(size=(180, 6))
    table(tmp_path / "observations_controlled_0g.csv", [released()], angles, ANGLES)
    head = ",".join(["ID", *COMMANDS])
    inputs, made = tmp_path / "control_inputs_controlled.csv", dict(delimiter=",", header=head, comments="")
    np.savetxt(inputs, np.column_stack([np.arange(180), commands]), **made)
    one = open_collection(tmp_path).load("controlled_0g")
    np.testing.assert_allclose(one.actuation, np.column_stack([commands, angles]), rtol=1e-6)
    assert one.observed(20).actuation.shape == (180, 12)  # inputs of the whole recording are known, as controllers are
    np.savetxt(inputs, np.zeros((9, 7)), **made)
    with pytest.raises(ValueError, match=r"control_inputs_controlled.csv: must have a command for each of 180 frames .* got 9"):
        open_collection(tmp_path).load("controlled_0g")


def test_repeatability_is_the_mean_distance_of_resting_places(tmp_path):
    """Three releases that rest at 0, 0 and 3 mm: two of three pairs are 3 mm apart."""
    still = [released(swinging=400) + [0, 0, z] for z in (0, 0, 0.003)]
    table(tmp_path / "observations_decay_200g.csv", still)
    found = open_collection(tmp_path)
    np.testing.assert_allclose(repeatability([found.load(f"decay_200g/{k}") for k in range(3)]), 2.0, atol=0.01)


DAMAGE = {
    "empty": (lambda f: f.write_bytes(b""), "must be a table of numbers"),
    "binary": (lambda f: f.write_bytes(bytes(range(256))), "must be a table of numbers"),
    "words": (lambda f: f.write_text(f.read_text() + "a" + ",b" * 9), "must be a table of numbers"),
    "column": (lambda f: f.write_text(f.read_text().replace("z3", "q")), "z3 missing"),
    "ragged": (lambda f: f.write_text(f.read_text() + "1,2,3\n"), "must be a table of numbers"),
    "NaN": (lambda f: f.write_text(f.read_text() + "1" + ",nan" * 9), "must be finite"),
    "no rows": (lambda f: f.write_text(f.read_text().split("\n")[0]), "must have rows of 10 numbers"),
    "short": (lambda f: table(f, [released(swinging=30)] * 3), "release 0 must have at least 50 sound frames"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_files_are_named(tmp_path, kind):
    damage, message = DAMAGE[kind]
    damage(folder(tmp_path) / "observations_decay_200g.csv")
    with pytest.raises(ValueError, match=rf"{re.escape(str(tmp_path))}/observations_decay_200g\.csv: .*{message}"):
        open_collection(tmp_path).load("decay_200g/0")


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 20), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_what_is_written_is_read(tmp_path_factory, rows, columns, seed):
    values = np.random.default_rng(seed).normal(size=(rows, columns)) * 10.0 ** np.random.default_rng(seed).integers(-9, 9)
    file, names = tmp_path_factory.mktemp("table") / "a.csv", [f"c{k}" for k in range(columns)]
    np.savetxt(file, values, delimiter=",", header=",".join(names), comments="", fmt="%.17g")
    found = read_table(file, names[:1])
    assert list(found) == names
    np.testing.assert_array_equal(np.stack(list(found.values()), 1), values)


def test_published_recordings(recordings):
    found = open_collection(recordings / "trunk")
    assert len(found.scenarios) == 13 + 8 + 21 + 3 and len(found.pairs) == 8 + 7
    releases = [found.load(name) for name in found.scenarios if name.startswith("decay_200g")]
    for one in releases:
        speed = np.linalg.norm(np.diff(one.points[:, 4], axis=0), axis=1)
        assert 1e-3 < speed[0] < 5e-3 and one.visible.mean() > 0.97
        assert np.linalg.norm(one.tracks[-1, 2] - [0.1, -0.322, 0.1], axis=0) < 0.03  # it hangs straight down in the end
    assert found.load("controlled_100g").actuation.shape == (9000, 12)
    # the tip comes to rest at places that are 6 to 9 mm from their mean, as the README of the recordings says of repeated commands
    assert 8 < repeatability(releases)[2] < 14
