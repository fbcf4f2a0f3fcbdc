"""Which releases of a trunk tell how far its twin is off, and which are asked."""

import pytest
from releases import folder, released, table
from twinbench.benchmark.real_loads import SECONDS, releases, swings


def test_half_of_the_second_session_is_asked_and_all_of_the_other_loads(tmp_path):
    # 3.33 s at 100 Hz; what is shorter is left out
    first, second = ([released(swinging=400, seed=10 * part + k) for k in range(3)] for part in (1, 2))
    table(tmp_path / "observations_decay_200g.csv", [*first, released(swinging=200)])
    table(tmp_path / "observations_decay_200g_2.csv", second)
    table(tmp_path / "observations_decay_300g.csv", [released(swinging=400, seed=5)])
    found = releases(tmp_path)
    assert [one.name for one in found.sound] == [*(f"decay_200g/{k}" for k in range(3)), "decay_200g_2/0", "decay_200g_2/1"]
    assert [one.name for one in found.equal] == ["decay_200g_2/2"]
    assert {load: [one.name for one in group] for load, group in found.others.items()} == {"300g": ["decay_300g/0"]}
    assert {one.frame_count for one in (*found.sound, *found.equal)} == {round(100 * SECONDS)}
    assert all(one.split.train_end == one.frame_count for one in found.sound)


def test_one_session_tells_of_no_equal_ones(tmp_path):
    with pytest.raises(ValueError, match=r"one load must have releases of 3.33 s from two sessions, got none"):
        releases(folder(tmp_path, second=False))


def test_how_fast_releases_swing_is_told_by_load_and_session(tmp_path):
    first, second = ([released(swinging=400, seed=10 * part + k) for k in range(10)] for part in (1, 2))
    table(tmp_path / "observations_decay_200g.csv", first)
    table(tmp_path / "observations_decay_200g_2.csv", second)
    table(tmp_path / "observations_decay_300g.csv", [released(swinging=400, seed=5)])
    rows = swings(releases(tmp_path))
    assert [(row["load"], row["beside"], row["releases"]) for row in rows] == [
        ("equal", "both sessions", 5),
        ("300g", "both sessions", 1),
        ("equal", "first session", 10),
        ("300g", "first session", 1),
    ]
    # all swing at 1 Hz: rates differ by what 0.01 mm of jitter does
    assert all(abs(row["log_rate"]) < 1e-3 and abs(row["heavier"]) < 2e-3 for row in rows)
