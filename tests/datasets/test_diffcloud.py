"""diffcloud: synthetic clouds of a known cloth in the published layout, and the published recordings themselves."""

import re

import numpy as np
import pytest
from clips import FRAMES, hanging, path_of, write
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.datasets.collection import open_collection
from twinbench.datasets.diffcloud import ORIGINS, read_cloud
from twinbench.metrics.base import get_metric, score


@pytest.mark.parametrize("kind", ORIGINS)
def test_a_clip_is_read_in_the_robots_metres(tmp_path, kind):
    write(tmp_path, kind)
    one = open_collection(tmp_path).load(f"{kind}_red")
    clouds = hanging(kind)
    assert one.frame_count == FRAMES and one.split.train_end == FRAMES - FRAMES // 3
    for t, cloud in enumerate(clouds):
        seen = one.points[t][one.visible[t]]
        assert len(seen) == len(cloud)  # once each
        np.testing.assert_allclose(np.sort(seen, axis=0), np.sort(cloud, axis=0), atol=1e-12)
    np.testing.assert_array_equal(one.controllers[:, 0], path_of(kind))
    np.testing.assert_array_equal(one.gravity, [0, 0, -9.81])
    assert not (one.timed or one.correspond or one.motion_valid.any()) and one.object == "red" and one.tracks is None


def test_the_cloth_of_frame_0_is_a_flat_square_that_rises_to_the_gripper(tmp_path):
    # 0.278 m of side, 0.393 m across, ahead of where the gripper goes; lengths grow by rise^2 / (2 ramp) at most where it rises
    write(tmp_path)
    one = open_collection(tmp_path).load("fold_red")
    body, start = one.structure[one.known], path_of("fold")[0]
    assert one.known.sum() == one.counts[1]
    np.testing.assert_allclose(body[np.argmax(body[:, 2])], start, atol=1e-9)
    assert np.ptp(body[:, 0]) == pytest.approx(0.278 * np.sqrt(2), rel=1e-6) and np.ptp(body[:, 1]) == pytest.approx(0.393, abs=1e-3)
    assert body[:, 2].min() == pytest.approx(0.055) == one.ground.offset
    assert np.median(body[:, 2]) == pytest.approx(0.055)
    hidden = one.points[0][~one.visible[0]]
    assert not len(hidden) or hidden[:, 2].min() >= 0.055 - 1e-12


def test_a_clip_that_is_stored_twice_counts_once(tmp_path):
    """Published lifts hold 25 frames twice over: their last third would be frames that were fitted."""
    write(tmp_path, "lift", times=2)
    one = open_collection(tmp_path).load("lift_red")
    assert one.frame_count == FRAMES
    other = write(tmp_path, "lift", "blue", clouds=[*hanging("lift"), *hanging("lift", seed=1)])
    with pytest.raises(ValueError, match=rf"{re.escape(str(other))}: must hold a cloud for each of 9 waypoints .* got 18"):
        open_collection(tmp_path).load("lift_blue")


def test_clips_of_one_cloth_are_transfer_pairs(tmp_path):
    write(tmp_path, "fold"), write(tmp_path, "lift"), write(tmp_path, "lift", "blue")
    found = open_collection(tmp_path)
    assert found.in_domain == ("fold_red", "lift_blue", "lift_red")
    assert [(p.sources, p.target) for p in found.pairs] == [(("fold_red",), "lift_red"), (("lift_red",), "fold_red")]


def test_chamfer_can_be_scored_and_tracks_cannot(tmp_path):
    from twinbench import Budget, get_method

    write(tmp_path)
    one = open_collection(tmp_path).load("fold_red")
    trajectory = get_method("rigid").fit([one.observed()], budget=Budget("quick")).rollout(one.controllers)
    assert 0 < score(get_metric("chamfer"), trajectory, one, one.split.test).mean < 1
    for name, why in (("track_error", "no annotated tracks"), ("coordinate_error", "clouds, whose points do not correspond")):
        metric = get_metric(name)
        assert score(metric, trajectory, one, one.split.test).unscorable == len(one.split.test)
        assert why in metric.reason(trajectory, one, 1)
    for name in ("phystwin", "gs-dynamics"):
        assert "points do not correspond" in get_method(name).skip(one)
    assert get_method("continuum").skip(one) is None


def test_clouds_are_not_diagnosed(tmp_path):
    from twinbench.diagnosis.diagnose import diagnose

    write(tmp_path)
    with pytest.raises(ValueError, match="fold_red: a diagnosis needs points that correspond from frame to frame, got clouds"):
        diagnose(open_collection(tmp_path).load("fold_red"))


DAMAGE = {
    "empty": (lambda file: file.write_bytes(b""), "not a readable .npy file"),
    "garbage": (lambda file: file.write_bytes(bytes(range(256))), "not a readable .npy file"),
    "cut": (lambda file: file.write_bytes(file.read_bytes()[:-50]), "not a readable .npy file"),
    "flat": (lambda file: np.save(file, np.zeros(30)), r"must hold numbers of shape \(>= 1, 3\)"),
    "nothing": (lambda file: np.save(file, np.zeros((0, 3))), r"must hold numbers of shape \(>= 1, 3\)"),
    "text": (lambda file: np.save(file, np.full((4, 3), "x")), r"must hold numbers"),
    "NaN": (lambda file: np.save(file, np.full((4, 3), np.nan)), "must be finite, got NaN or infinity in 4 rows"),
    "objects": (lambda file: np.save(file, np.full((4, 3), None), allow_pickle=True), "not a readable .npy file"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_clouds_are_named(tmp_path, kind):
    damage, message = DAMAGE[kind]
    file = write(tmp_path) / "003.npy"
    damage(file)
    with pytest.raises(ValueError, match=rf"{re.escape(str(file))}: {message}"):
        open_collection(tmp_path).load("fold_red")


def test_another_up_is_refused(tmp_path):
    folder = write(tmp_path, clouds=[cloud[:, [2, 1, 0]] for cloud in hanging("fold")])
    with pytest.raises(
        ValueError, match=rf"{re.escape(str(folder))}: the tops .* within 0.1 m of the lifted gripper along z, got a median"
    ):
        open_collection(tmp_path).load("fold_red")


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 20), st.integers(0, 2**32 - 1), st.sampled_from(["<f8", "<f4", "<i2"]), st.booleans())
def test_what_is_written_is_read(tmp_path_factory, count, seed, kind, columns):
    cloud = (100 * np.random.default_rng(seed).normal(size=(count, 3))).astype(kind)
    file = tmp_path_factory.mktemp("cloud") / "a.npy"
    np.save(file, np.asfortranarray(cloud) if columns else cloud)
    np.testing.assert_array_equal(read_cloud(file), cloud.astype(float))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_spoilt_header_is_refused_or_read(tmp_path_factory, seed):
    random = np.random.default_rng(seed)
    file = tmp_path_factory.mktemp("cloud") / "a.npy"
    np.save(file, np.zeros((5, 3)))
    data = bytearray(file.read_bytes())
    for at in random.integers(128, size=3):
        data[at] = random.integers(256)
    file.write_bytes(bytes(data))
    try:
        assert read_cloud(file).shape[1] == 3
    except ValueError as error:
        assert str(error).startswith(f"{file}: ") and "\n" not in str(error)


def test_published_recordings(recordings):
    found = open_collection(recordings / "diffcloud")
    assert found.in_domain == ("fold_navy", "fold_tan", "lift_navy", "lift_tan") and len(found.pairs) == 4
    for name in found.in_domain:
        one = found.load(name)
        assert one.frame_count == 25 and one.split.train_end == 17
        # the cloth hangs from the gripper: while that is lifted the nearest points are within 5 cm of it
        high = np.flatnonzero(one.controllers[:, 0, 2] > 0.25)
        near = [np.linalg.norm(one.points[t][one.visible[t]] - one.controllers[t, 0], axis=1).min() for t in high]
        assert np.median(near) < 0.05
        assert min(one.points[t][one.visible[t]][:, 2].min() for t in range(25)) > 0.0545  # the table, where clouds are cut off
