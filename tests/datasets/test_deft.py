"""DEFT: synthetic files in the published layout, and the published recordings themselves."""

import pickle
import re
from functools import cache, partial
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from twinbench.datasets.collection import open_collection
from twinbench.datasets.deft import LAYOUT, TREES, read_deft
from twinbench.datasets.markers import infer_paths, read_splits

# branch: (joint, markers) after the main cable's markers; the published shapes
BDLO3 = (12, (4, 2), (7, 3))


def write(file, markers):
    """(T, V, 3) as the authors store it: a list with one tuple of 3 lists, each frame after frame."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(pickle.dumps([tuple(np.asarray(markers).transpose(2, 0, 1).reshape(3, -1).tolist())]))


def hanging(seed, main, *branches, frames=20):
    """(T, V, 3) a main cable along x at half a metre, markers 8 cm apart, from whose joints branches hang along -y; all swings."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 1, frames)

    def swing(count):
        angles = [0.6 * np.sin(2 * np.pi * rng.uniform(0.3, 1.5) * time + rng.uniform(0, 6)) for _ in range(count)]
        return np.stack(angles, 1)

    def grow(start, base, count):
        angle = base + swing(count)
        return start[:, None] + np.cumsum(0.08 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1), 1)

    cable = [grow(np.tile([0, 0.5, 0], (frames, 1)), 0.0, main)]
    for joint, count in branches:
        cable.append(grow(np.concatenate(cable, 1)[:, joint], -np.pi / 2, count))
    markers = np.concatenate(cable, 1)
    return markers + rng.normal(0, 2e-4, markers.shape)


def folder(root, name, shape, frames=20):
    for side, numbers in (("train", (1, 2, 3)), ("eval", (4,))):
        for i in numbers:
            stem = f"take_block{i}_frames{1000 * i}to{1000 * i + frames - 1}"
            write(root / "dataset" / name / side / f"{stem}.pkl", hanging(i, *shape, frames=frames))
    return root / "dataset" / name


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(5, 9), st.just(3)), elements=st.floats(allow_infinity=False)))
def test_what_is_written_is_read(tmp_path_factory, markers):
    """Every float64 comes back with the same value (NaN as NaN); the block's length follows from the markers or from its name."""
    file = tmp_path_factory.mktemp("deft") / f"a_frames100to{99 + len(markers)}.pkl"
    write(file, markers)
    np.testing.assert_array_equal(read_deft(file, markers.shape[1]), markers)
    np.testing.assert_array_equal(read_deft(file), markers)


def test_unnamed_blocks_have_500_frames(tmp_path):
    markers = hanging(1, 6, frames=500)
    write(tmp_path / "text.pkl", markers)
    np.testing.assert_array_equal(read_deft(tmp_path / "text.pkl"), markers)


@pytest.mark.parametrize(
    ("name", "count", "branches"),
    [
        # markers and joints of the published cables: main cable, joint and markers of each branch
        ("BDLO1", 20, [(4, 13, 16), (8, 17, 19)]),
        ("BDLO2", 20, [(4, 12, 15), (7, 16, 19)]),
        ("BDLO3", 17, [(4, 12, 13), (7, 14, 16)]),
        ("BDLO4", 16, [(4, 12, 13), (8, 14, 15)]),
        ("BDLO5", 18, [(5, 12, 14), (12, 15, 17)]),
        ("BDLO6", 21, [(2, 12, 15), (7, 16, 17), (7, 18, 20)]),
    ],
)
def test_trees(name, count, branches):
    """Every marker but the first is joined to exactly one other: a tree."""
    main, *rest = TREES[name]
    assert [(p[0], p[1], p[-1]) for p in rest] == branches
    ends = [b for path in TREES[name] for _, b in pairwise(path)]
    assert sorted(ends) == list(range(1, count)) and main == tuple(range(rest[0][1]))


def test_collection(tmp_path):
    found = open_collection(folder(tmp_path, "BDLO3", BDLO3))
    assert [p.target for p in found.pairs] == ["eval/take_block4_frames4000to4019"] and len(found.pairs[0].sources) == 3
    one = found.load(found.pairs[0].target)
    np.testing.assert_array_equal(one.points, hanging(4, *BDLO3))
    np.testing.assert_array_equal(one.grips, [0, 1, 10, 11])
    np.testing.assert_array_equal(one.gravity, [0, -9.81, 0])
    assert (one.object, one.fps, one.ground) == ("BDLO3", 100.0, None)
    assert {found.load(n).counts for n in found.scenarios} == {(17, 0, 16 * 7)}  # 16 edges of 8 cm in 8 parts
    assert "BDLO3" in found.note and "2502.15037" in found.citation


def test_grips_of_the_mid_clamp(tmp_path):
    found = open_collection(folder(tmp_path, "BDLO3_mid_clamp", BDLO3))
    np.testing.assert_array_equal(found.load(found.pairs[0].target).grips, [3, 10, 11])
    with pytest.raises(ValueError, match=r"BDLO2_mid_clamp: which marker is clamped"):
        open_collection(folder(tmp_path, "BDLO2_mid_clamp", (12, (4, 4), (7, 4))))


def test_unknown_cable_is_inferred(tmp_path):
    """A cable with other marker counts than the published ones: main cable of 9, one branch of 3, a short one growing out of it."""
    found = open_collection(folder(tmp_path, "BDLO7", (9, (3, 3), (10, 2)), frames=100))
    one = found.load(found.pairs[0].target)
    np.testing.assert_array_equal(one.grips, [0, 1, 7, 8])
    assert one.counts == (14, 0, 13 * 7)
    # the branches' particles lie on their straight first edges' ends: halfway between joint and first marker, within the 8 cm edge
    gap = np.linalg.norm(one.interior[8 * 7 : 9 * 7] - one.points[0, 3], axis=1)
    assert np.all(np.diff(gap) > 0) and gap[-1] < 0.08


DAMAGE = {
    "truncated": (lambda f: f.write_bytes(f.read_bytes()[:-40]), "not a complete pickle"),
    "malicious": (lambda f: f.write_bytes(b"cposix\nsystem\n(S'true'\ntR."), "refused.*posix.system"),
    "two axes": (lambda f: f.write_bytes(pickle.dumps([([0.0] * 340,) * 2])), r"must hold 3 lists.*\(1, 2, 340\)"),
    "ragged": (lambda f: f.write_bytes(pickle.dumps([([0.0] * 340, [0.0] * 340, [0.0] * 323)])), "equally many numbers"),
    "text": (lambda f: f.write_bytes(pickle.dumps([(["1"] * 340,) * 3])), "must be an array of numbers or lists of them, got a str"),
    "empty": (lambda f: f.write_bytes(pickle.dumps([([], [], [])])), "must hold 3 lists"),
    "other cable": (lambda f: write(f, hanging(1, 12, (4, 2), (8, 2))), "whole frames of 17 markers in 20 frames, got 320 values"),
    "frame lost": (lambda f: write(f, hanging(1, *BDLO3, frames=19)), "whole frames of 17 markers in 20 frames, got 323 values"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_files_are_named(tmp_path, kind):
    damage, message = DAMAGE[kind]
    path = folder(tmp_path, "BDLO3", BDLO3)
    victim = path / "train" / "take_block2_frames2000to2019.pkl"
    damage(victim)
    with pytest.raises(ValueError, match=f"(?s){re.escape(str(victim))}: .*{message}"):
        open_collection(path)


@pytest.fixture(scope="module", params=["BDLO1", pytest.param("BDLO1_mid_clamp", marks=pytest.mark.slow)])
def published(request, recordings):
    return request.param, recordings / "dataset" / request.param


@cache
def opened(path):
    return open_collection(path)


@pytest.mark.long
def test_published_recordings(published):
    """Counts as published; the free markers hang below the grips, so up is +y; particles lie about a centimetre apart."""
    name, path = published
    found = opened(path)
    assert (len(found.scenarios), len(found.pairs)) == {"BDLO1": (101, 24), "BDLO1_mid_clamp": (89, 18)}[name]
    assert len(found.pairs[0].sources) == {"BDLO1": 77, "BDLO1_mid_clamp": 71}[name]  # no file is faulty
    scenarios = [found.load(n) for n in found.scenarios]
    assert {s.counts for s in scenarios} == {{"BDLO1": (20, 0, 120), "BDLO1_mid_clamp": (20, 0, 119)}[name]}
    height = np.mean([s.points[..., 1].mean(0) for s in scenarios], 0)
    assert height[13:].max() < height[scenarios[0].grips].min() - 0.05
    for s in scenarios:
        nearest = np.linalg.norm(s.structure[:, None] - s.structure, axis=-1) + np.eye(len(s.structure))
        assert nearest.min() > 0.005 and nearest.min(1).max() < 0.016


def test_sessions_agree_with_the_names(published):
    """Two blocks join exactly where their names say that one ends on the frame before the other begins: 38 and 76 such joints."""
    name, path = published
    found = opened(path)
    session, blocks = {}, []
    for key in found.scenarios:
        stem = key.split("/", 1)[1]
        session[stem] = found.load(key).session
        if block := re.fullmatch(r"(.*)_block\d+_frames(\d+)to(\d+)", stem):
            blocks.append((block[1], int(block[2]), int(block[3]), stem))
    expected = {}
    for take, begin, _, stem in sorted(blocks):
        before = [s for t, _, end, s in blocks if t == take and end == begin - 1]
        expected[stem] = expected[before[0]] if before else stem
    assert len(session) - len(set(session.values())) == {"BDLO1": 38, "BDLO1_mid_clamp": 76}[name]
    assert {stem: session[stem] for stem in expected} == expected


@pytest.mark.long
def test_clean_split_of_published_recordings(published):
    name, path = published
    found = open_collection(path, split="clean")
    seen = {found.load(key).session for key in found.pairs[0].sources}
    assert not seen & {found.load(p.target).session for p in found.pairs}
    assert len(found.pairs[0].sources) == {"BDLO1": 58, "BDLO1_mid_clamp": 10}[name]


@pytest.mark.long
def test_inference_agrees_with_the_table(published):
    """The published tree of BDLO1 is found from its motion alone."""
    _, path = published
    assert infer_paths(read_splits(path, partial(read_deft, markers=20))[:40]) == TREES["BDLO1"]


def test_matches_is_cheap_and_never_raises(tmp_path):
    path = folder(tmp_path, "BDLO3", BDLO3)
    assert LAYOUT.matches(path) and not LAYOUT.matches(path.parent) and not LAYOUT.matches(path / "train")
    assert not LAYOUT.matches(tmp_path / "nowhere")
