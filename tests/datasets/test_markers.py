"""What the marker readers share, on shapes whose answer is known in closed form."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.datasets.markers import JOIN, SPACING, Cable, Recording, collect, faulty, infer_paths, sessions

DOWN = (0.0, 0.0, -1.0)


def recording(markers, name="train/1"):
    return Recording(name, Path(name + ".pkl"), np.asarray(markers, float))


def rope(lengths, frames=20):
    """(T, V, 3) a rope whose markers stay ``lengths`` apart while it rolls up and unrolls: one turning angle for every joint."""
    angle = 0.3 * np.sin(np.linspace(0, 3, frames))[:, None] * np.arange(len(lengths))
    steps = np.asarray(lengths)[:, None] * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    return np.concatenate([np.zeros((frames, 1, 3)), np.cumsum(steps, 1)], 1)


def cable(lengths, paths=None, driven=(0,)):
    return Cable("rope", paths or (tuple(range(len(lengths) + 1)),), np.asarray(lengths, float), tuple(driven), DOWN)


@settings(deadline=None)
@given(st.lists(st.floats(0.02, 0.12), min_size=1, max_size=12))
def test_straight_rope_is_divided_evenly(lengths):
    """A spline through collinear points at their own arc lengths is the line: particle k of n-1 on an edge [a, b] is a + (b - a) k/n."""
    rope = cable(lengths)
    ends = np.concatenate([[0], np.cumsum(lengths)])
    direction = np.array([2.0, -1.0, 2.0]) / 3
    expected = np.concatenate([np.linspace(a, b, n + 1)[1:-1] for a, b, n in zip(ends, ends[1:], rope.segments, strict=False)])
    got = rope.between(ends[:, None] * direction)
    np.testing.assert_allclose(got, expected[:, None] * direction, atol=1e-12)
    # rounding to whole parts: an edge L has n parts with |L/SPACING - n| <= 1/2, so parts lie within a factor n/(n +- 1/2), n >= 2
    parts = np.asarray(lengths) / rope.segments
    assert parts.min() >= 0.75 * SPACING - 1e-12 and parts.max() <= 1.25 * SPACING + 1e-12


def test_particles_follow_a_circle():
    """Natural spline on an arc of curvature k and spacing h: error below 5/384 k h^2 away from the ends, where its curvature is right."""
    radius, h = 0.3, 0.1
    angle = np.arange(13) * h / radius
    markers = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    rope = cable(np.full(12, h))
    error = np.abs(np.linalg.norm(rope.between(markers), axis=1) - radius).reshape(12, 9)
    assert error[3:-3].max() < 5 / 384 * h**2 / radius / 4
    assert error.max() < 1 / 8 * h**2 / radius  # a straight chord's error: the spline is better even at its ends


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-2, 2))
def test_particles_are_the_same_material_in_every_shape(seed, weight):
    """At fixed parameters a spline is linear in its points: p(a + w b) = p(a) + w p(b). Parameters taken from the shape would not be."""
    a, b = np.random.default_rng(seed).uniform(-1, 1, (2, 5, 3))
    tee = cable([0.1, 0.03, 0.05, 0.07], paths=((0, 1, 2), (1, 3, 4)))
    np.testing.assert_allclose(tee.between(a + weight * b), tee.between(a) + weight * tee.between(b), atol=1e-12)


def test_branches_start_at_their_joint():
    """A T of straight cables: the branch's particles lie on the line from the joint, none of them at a marker."""
    markers = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.1, 0.05, 0], [0.1, 0.1, 0]])
    tee = cable([0.1, 0.1, 0.05, 0.05], paths=((0, 1, 2), (1, 3, 4)))
    got = tee.between(markers)
    assert tee.edges == ((0, 1), (1, 2), (1, 3), (3, 4))
    assert len(got) == 9 + 9 + 4 + 4
    np.testing.assert_allclose(got[18:, 0], 0.1, atol=1e-12)
    np.testing.assert_allclose(got[18:, 1], [0.01, 0.02, 0.03, 0.04, 0.06, 0.07, 0.08, 0.09], atol=1e-12)
    assert np.linalg.norm(got[:, None] - markers, axis=-1).min() > 0.009


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 6), st.integers(60, 100))
def test_swapped_neighbours_are_faulty(first, percent):
    """Exchanging two markers of unequal edges in a fraction of the frames is found; bending alone, which only shortens, is not."""
    lengths = [0.02, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.025]
    sound = rope(lengths, 100)
    assert not faulty(recording(sound), cable(lengths))
    swapped = sound.copy()
    part = slice(0, percent)
    swapped[part, [first, first + 1]] = sound[part, [first + 1, first]]
    assert faulty(recording(swapped), cable(lengths))


def test_single_glitches_are_no_fault():
    lengths = [0.02, 0.1, 0.1, 0.1]
    markers = rope(lengths, 100)
    markers[[3, 50, 90], 2] += 0.05
    assert not faulty(recording(markers), cable(lengths))


def take(rng, frames, markers=8):
    """(T, V, 3) smooth motion as in the recordings: a few centimetres at up to 2 Hz, never repeated, 0.2 mm jitter, 100 Hz."""
    time = np.arange(frames)[:, None, None] / 100
    phase = rng.uniform(0, 2 * np.pi, (3, 1, markers, 3))
    motion = sum(0.05 / f * np.sin(2 * np.pi * f * time + p) for f, p in zip((0.43, 1, 2.1), phase, strict=True))
    start = rng.uniform(-0.5, 0.5, (markers, 3))
    return start + motion + rng.normal(0, 2e-4, (frames, markers, 3))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 4), min_size=1, max_size=4))
def test_sessions_are_the_unbroken_stretches(seed, blocks):
    """Takes of 50-frame blocks, shuffled among each other: exactly the blocks of one take get its first block's name."""
    rng = np.random.default_rng(seed)
    cut = [(k, b, part) for k, n in enumerate(blocks) for b, part in enumerate(np.split(take(rng, 50 * n), n))]
    order = rng.permutation(len(cut))
    records = [recording(cut[i][2], f"train/take{cut[i][0]}_{cut[i][1]}") for i in order]
    assert sessions(records) == [f"take{cut[i][0]}_0" for i in order]


@pytest.mark.parametrize("lost", [2, 100])
def test_cut_out_frames_separate_blocks(lost):
    """A second, or 2 frames of 10 ms in which the markers move by about 16 mm: between two and three times the tolerance."""
    whole = take(np.random.default_rng(1), 100 + lost)
    moved = np.sqrt(np.square(whole[50 + lost] - whole[50]).sum(-1).mean())
    assert moved > 2 * JOIN and (lost == 100 or moved < 3 * JOIN)
    assert sessions([recording(whole[:50], "train/1"), recording(whole[50 + lost :], "train/2")]) == ["1", "2"]


def test_sessions_survive_lost_markers():
    whole = take(np.random.default_rng(2), 100)
    whole[49, 3] = np.nan
    assert sessions([recording(whole[:50], "train/1"), recording(whole[50:], "train/2")]) == ["1", "1"]


def test_tree_is_inferred_from_motion():
    """A main cable of 6 and branches at markers 2 and 4, every joint turning independently: neighbours keep their distance."""
    paths = ((0, 1, 2, 3, 4, 5), (2, 6, 7), (4, 8))
    rng = np.random.default_rng(3)
    records = []
    for _ in range(3):
        markers = np.zeros((100, 9, 3))
        for k, path in enumerate(paths):
            for a, b in pairwise(path):
                angle = k * np.pi / 2 + 0.5 * np.sin(np.linspace(0, 6, 100) * rng.uniform(0.5, 2) + rng.uniform(0, 6))
                markers[:, b] = markers[:, a] + 0.08 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
        records.append(recording(markers + rng.normal(0, 2e-4, markers.shape)))
    assert infer_paths(records) == paths


def sample(side, number, *, lengths=(0.02, 0.1, 0.1, 0.1, 0.02), change=None):
    rng = np.random.default_rng(number)
    markers = rope(lengths, 40) + rng.uniform(-1, 1, 3)
    return recording(markers if change is None else change(markers), f"{side}/{number}")


def opened(*recordings, split="published"):
    return collect(Path("/data/DLO9"), recordings, ((0, 1, 2, 3, 4, 5),), driven=(0, 1, 4, 5), down=DOWN, split=split)


def test_collection_of_one_cable():
    """Pairs share the sound training recordings; every scenario has the same particles; markers are points, driven ones are grips."""
    swap = sample("train", 3, change=lambda m: m[:, [1, 0, 2, 3, 4, 5]])
    records = [sample("train", 1), sample("train", 2), swap, sample("eval", 4), sample("eval", 5)]
    found = opened(*records)
    assert [p.target for p in found.pairs] == ["eval/4", "eval/5"]
    assert all(p.sources == ("train/1", "train/2") for p in found.pairs)
    assert found.in_domain == () and "train/3" in found.note
    loaded = {name: found.load(name) for name in found.scenarios}
    assert {s.counts for s in loaded.values()} == {(6, 0, 29)}
    one = loaded["eval/4"]
    np.testing.assert_array_equal(one.points, records[3].markers)
    np.testing.assert_array_equal(one.tracks, records[3].markers)
    np.testing.assert_array_equal(one.controllers, records[3].markers[:, [0, 1, 4, 5]])
    np.testing.assert_array_equal(one.grips, [0, 1, 4, 5])
    np.testing.assert_array_equal(one.gravity, [0, 0, -9.81])
    assert one.fps == 100 and one.ground is None and not one.self_collision and one.object == "DLO9"
    assert one.split.train_end == 28 and loaded["train/1"].split.train_end == 40
    # a protocol for all methods alike: the velocity with which a block begins is told by its second frame
    assert one.start_frames == 2 and one.initial().points.shape == (2, 6, 3)


def test_clean_split_keeps_a_stretch_on_one_side():
    whole = rope((0.02, 0.1, 0.1, 0.1, 0.02), 120)
    sides = ["train", "eval", "train"]
    blocks = [recording(part, f"{side}/{i}") for i, (side, part) in enumerate(zip(sides, np.split(whole, 3), strict=True))]
    other = sample("train", 7)
    assert opened(*blocks, other).pairs[0].sources == ("train/0", "train/2", "train/7")
    clean = opened(*blocks, other, split="clean")
    assert clean.pairs[0].sources == ("train/7",) and "2 dropped" in clean.note
    with pytest.raises(ValueError, match=r"DLO9: no training recording is left.*clean"):
        opened(*blocks, split="clean")


def test_lost_markers():
    """A marker that is lost on the way is invisible there; driven markers and frame 0 have no substitute."""

    def lost(frame, marker):
        def change(markers):
            markers[frame, marker, 1] = np.nan
            return markers

        return sample("eval", 2, change=change)

    one = opened(sample("train", 1), lost(7, 2)).load("eval/2")
    expected = np.ones((40, 6), bool)
    expected[7, 2] = False
    np.testing.assert_array_equal(one.visible, expected)
    np.testing.assert_array_equal(one.motion_valid[[5, 6, 7, 8, 39], 2], [True, False, False, True, False])
    assert np.isfinite(one.points).all() and np.isnan(one.tracks[7, 2]).any()
    with pytest.raises(ValueError, match=r"eval/2.pkl: all markers must be seen in frame 0, marker 2"):
        opened(sample("train", 1), lost(0, 2))
    with pytest.raises(ValueError, match=r"eval/2.pkl: the driven marker 4 must be seen in every frame, it is NaN in frame 9"):
        opened(sample("train", 1), lost(9, 4))


def test_millimetres_are_refused():
    with pytest.raises(ValueError, match="1 mm to 1 m apart"):
        opened(*(sample(side, 1, change=lambda m: 1000 * m) for side in ("train", "eval")))
