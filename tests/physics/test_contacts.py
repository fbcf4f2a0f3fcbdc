"""Contact candidates against the definition: all pairs of one system with |x_j - x_i| < distance, in ascending order."""

from itertools import pairwise

import numpy as np
import pytest
import torch
import warp as wp
from hypothesis import example, given, settings
from hypothesis import strategies as st
from twinbench.physics.batch import Batch
from twinbench.physics.contacts import candidates
from twinbench.physics.system import System
from twinbench.physics.terms import SelfCollision

EDGE = 1e-5  # relative: a float32 distance of a few roundings; pairs closer than this to the limit may go either way


def system(points, distance, *, controllers=0, neighbours=1.0):
    return System(
        positions=points,
        springs=np.zeros((0, 2)),
        stiffness=np.zeros(0),
        controllers=np.zeros((2, controllers, 3)),
        terms=(SelfCollision({"collision_dist": distance, "collide_neighbours": neighbours}),),
    )


def find(systems, x=None, *, double=True):
    """Candidates as one list a node, with the batch they belong to; ``x`` are (sum of M, 3) positions other than the starts."""
    batch = Batch(systems, fps=30, substeps=1, double=double)
    nodes = batch.inputs.x.clone()
    if x is not None:
        for part, moved in zip(batch.split(nodes), np.split(np.asarray(x), np.cumsum(batch.sizes)[:-1]), strict=True):
            part[:] = torch.as_tensor(moved)
    row, near = candidates(batch, nodes, batch.inputs.table)
    assert row.dtype == near.dtype == torch.int32 and row.shape == (batch.node_count + 1,)
    assert row[0] == 0 and row[-1] == len(near) and (row.diff() >= 0).all()
    return batch, nodes.numpy(), [near[a:b].tolist() for a, b in pairwise(row)]


def check(batch, nodes, found, systems):
    """``found`` is ascending, symmetric, and brute force's answer wherever that is not a matter of rounding."""
    for start, size, one in zip(batch.starts[:-1], batch.sizes, systems, strict=True):
        limit, joined = one.values["collision_dist"], one.values["collide_neighbours"] > 0
        points = nodes[start : start + size].astype(float)
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        home = np.linalg.norm(one.positions[:, None] - one.positions, axis=2)
        allowed = ~np.eye(size, dtype=bool) & (joined | (home >= limit * (1 - EDGE)))
        must = allowed & (apart < limit * (1 - EDGE)) & (joined | (home >= limit * (1 + EDGE)))
        may = allowed & (apart < limit * (1 + EDGE))
        listed = np.zeros((size, size), bool)
        for i in range(size):
            assert found[start + i] == sorted(set(found[start + i]))
            listed[i, np.array(found[start + i], int) - start] = True  # raises IndexError for another system's particle
        assert (listed == listed.T).all()
        assert (must <= listed).all() and (listed <= may).all()
    inside = np.zeros(batch.node_count, bool)
    for start, size in zip(batch.starts[:-1], batch.sizes, strict=True):
        inside[start : start + size] = True
    assert not any(found[i] for i in np.flatnonzero(~inside))  # controllers


@st.composite
def clouds(draw):
    """Up to four systems on top of one another, with different distances, duplicated points, and cubes on either side of the origin."""
    made = []
    for _ in range(draw(st.integers(1, 4))):
        random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
        count = draw(st.integers(1, 40))
        points = random.normal(size=(count, 3)) * 0.02 + draw(st.sampled_from([0.0, -3.0, 40.0]))
        points = points[random.integers(0, count, count)] if draw(st.booleans()) else points
        distance = draw(st.sampled_from([1e-4, 0.005, 0.02, 0.1]))
        made.append(system(points, distance, controllers=draw(st.integers(0, 2)), neighbours=draw(st.sampled_from([0.0, 1.0]))))
    return made


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(clouds(), st.integers(0, 2**32 - 1), st.booleans())
def test_brute_force_finds_the_same(systems, seed, double):
    moved = np.concatenate([s.positions for s in systems])
    moved = moved + np.random.default_rng(seed).normal(size=moved.shape) * 0.01
    check(*find(systems, moved, double=double), systems)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-3, 3)] * 3), min_size=1, max_size=25), st.integers(1, 4))
@example([(0, 0, 0), (2, 0, 0), (-2, 0, 0), (0, 0, 2)], 2)
def test_the_limit_itself_is_outside(lattice, steps):
    # spacings and distance are powers of two or small multiples of one: every distance that equals the limit is exact
    points = np.array(lattice) / 64
    limit = steps / 64
    _, _, found = find([system(points, limit)], double=False)
    apart = np.sqrt((((np.array(lattice)[:, None] - np.array(lattice)) ** 2).sum(2)).astype(float))
    for i, near in enumerate(found):
        assert near == [j for j in range(len(points)) if j != i and apart[i, j] < steps]


def test_nobody_is_near():
    points = np.arange(30.0).reshape(10, 3)
    _, _, found = find([system(points, 0.5), system(points[:1], 0.5, controllers=1)])
    assert found == [[]] * 12


def test_a_distance_of_zero_joins_nobody():
    _, _, found = find([system(np.zeros((4, 3)), 0.0), system(np.zeros((2, 3)), 0.1)])
    assert found == [[], [], [], [], [5], [4]]


def test_all_in_one_place_all_meet():
    count = 300
    _, _, found = find([system(np.zeros((count, 3)), 0.01)], double=False)
    assert found == [[j for j in range(count) if j != i] for i in range(count)]


def test_pairs_that_start_close_never_meet_where_neighbours_do_not_collide():
    # particle 2 starts far from 0 and 1, which start 0.01 m apart; all come together
    start = np.array([[0, 0, 0], [0.01, 0, 0], [1, 0, 0]])
    systems = [system(start, 0.02, neighbours=n) for n in (0.0, 1.0)]
    _, _, found = find(systems, np.tile([[0, 0, 0], [0, 0.001, 0], [0, 0, 0.001]], (2, 1)))
    assert found == [[2], [2], [0, 1], [4, 5], [3, 5], [3, 4]]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_a_system_that_blew_up_is_skipped_and_disturbs_nobody(bad):
    points = np.random.default_rng(0).normal(size=(50, 3)) * 0.01
    systems = [system(points, 0.01) for _ in range(3)]
    moved = np.tile(points, (3, 1))
    moved[60] = bad
    moved[70:80] = bad
    _, _, found = find(systems, moved, double=False)
    alone = find(systems[:1], points, double=False)[2]
    assert any(alone) and found[:50] == alone
    assert not any(found[50:100])
    assert [[j - 100 for j in near] for near in found[100:]] == alone


def test_the_same_bits_again():
    points = np.random.default_rng(1).normal(size=(400, 3)) * 0.02
    first, again = (find([system(points, 0.01)] * 2, double=False)[2] for _ in range(2))
    assert first == again and sum(map(len, first)) > 1000


def test_distances_come_from_the_table_not_from_the_systems():
    # the fit's table may differ from what the systems were made with
    batch = Batch([system(np.diag([0.0, 0.1, 0.2]), 0.01)], fps=30, substeps=1)
    table = batch.inputs.table.clone()
    table[0, batch.column("collision_dist")] = 0.15
    row, near = candidates(batch, batch.inputs.x, table)
    assert row.tolist() == [0, 1, 2, 2] and near.tolist() == [1, 0]


@pytest.mark.gpu
@pytest.mark.parametrize("double", [False, True])
def test_cuda_finds_what_the_cpu_finds(double):
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    if not wp.is_cpu_available():
        pytest.skip("this Warp comes without its compiler for the CPU")
    random = np.random.default_rng(2)
    systems = [system(random.random((n, 3)) * 0.1, d, controllers=1) for n, d in ((3000, 0.01), (1, 0.1), (500, 0.03), (2000, 0.004))]
    found = []
    for device in ("cpu", "cuda", "cuda"):
        batch = Batch(systems, fps=30, substeps=1, double=double, device=device)
        x = batch.inputs.x.clone()
        x[-1000] = np.nan  # in the last system
        found.append([t.cpu() for t in candidates(batch, x, batch.inputs.table)])
    # contracted multiply-adds may decide a pair at the very limit otherwise: none of these distances is that close
    for row, near in found[1:]:
        assert torch.equal(row, found[0][0]) and torch.equal(near, found[0][1])
    assert len(found[0][1]) > 50_000
