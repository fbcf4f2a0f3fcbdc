"""Springs between particles and to controllers, against a transcription of PhysTwin's construction that keeps a dense table as it does.

For i ascending, a search around i within the radius, nearest first, at most ``max_neighbours`` with i itself, whose first hit is dropped;
(i, j) is added where the pair is new and longer than 1e-4 m. Controller springs follow, one search each.
"""

import re
import tracemalloc

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from twinbench.physics.topology import Neighbours, controller_springs, object_springs, rope_hinges, sheet_hinges

NONE = np.zeros((0, 2), int)


def published_object_springs(points, radius, most):
    points = points.astype(np.float32).astype(float)
    seen, springs = np.zeros((len(points), len(points)), bool), []
    for i, p in enumerate(points):
        distance = np.linalg.norm(points - p, axis=1)
        hits = [j for j in np.argsort(distance, kind="stable") if distance[j] <= radius][:most]
        for j in hits[1:]:
            if not seen[i, j] and distance[j] > 1e-4:
                seen[i, j] = seen[j, i] = True
                springs.append((i, j))
    return np.array(springs, int).reshape(-1, 2)


def published_controller_springs(controllers, points, radius, most):
    springs = []
    points = points.astype(np.float32).astype(float)
    for c, p in enumerate(controllers.astype(np.float32).astype(float)):
        distance = np.linalg.norm(points - p, axis=1)
        springs += [(c, j) for j in np.argsort(distance, kind="stable") if distance[j] <= radius][:most]
    return np.array(springs, int).reshape(-1, 2)


def without_ties(queries, points, *limits):
    """The order of equal distances is nobody's business: leave out clouds that have some, and distances at the radius."""
    queries, points = (a.astype(np.float32).astype(float) for a in (queries, points))
    for p in queries:
        d = np.sort(np.concatenate([np.linalg.norm(points - p, axis=1), limits]))
        assume((np.diff(d)[d[1:] > 0] > 1e-9).all())


CLOUDS = dict(
    seed=st.integers(0, 10**6),
    count=st.integers(1, 40),
    radius=st.floats(0.02, 2.0),
    most=st.integers(0, 45),
    flat=st.booleans(),
)


def cloud(seed, count, flat):
    points = np.random.default_rng(seed).random((count, 3))
    return points * [1, 1, 0] if flat else points


@given(**CLOUDS)
@settings(deadline=None, max_examples=100)
def test_object_springs_as_published(seed, count, radius, most, flat):
    points = cloud(seed, count, flat)
    without_ties(points, points, radius, 1e-4)
    found = object_springs(points, radius=radius, max_neighbours=most)
    np.testing.assert_array_equal(found, published_object_springs(points, radius, most))


@given(hands=st.integers(0, 6), **CLOUDS)
@settings(deadline=None, max_examples=100)
def test_controller_springs_as_published(hands, seed, count, radius, most, flat):
    points, controllers = cloud(seed, count, flat), cloud(seed + 1, hands, False)
    without_ties(controllers, points, radius)
    found = controller_springs(controllers, points, radius=radius, max_neighbours=most)
    np.testing.assert_array_equal(found, published_controller_springs(controllers, points, radius, most))


@given(**CLOUDS)
@settings(deadline=None, max_examples=100)
def test_properties_of_object_springs(seed, count, radius, most, flat):
    points = cloud(seed, count, flat)
    springs = object_springs(points, radius=radius, max_neighbours=most)
    pairs = {frozenset(s) for s in springs.tolist()}
    assert len(pairs) == len(springs) and all(len(p) == 2 for p in pairs)  # each pair once, nobody with itself
    assert springs.dtype == np.int32
    assert (np.diff(springs[:, 0]) >= 0).all()  # by the particle that asked first
    assert np.bincount(springs[:, 0], minlength=count).max() <= max(0, most - 1)  # its own search counts itself
    lengths = np.linalg.norm(points[springs[:, 0]] - points[springs[:, 1]], axis=1)
    assert (lengths < radius + 1e-6).all() and (lengths > 1e-4 - 1e-6).all()  # float32 positions


BODIES = {
    "scattered": lambda random: random.uniform(0, 0.1, (300, 3)),
    "some alike": lambda random: np.concatenate([random.uniform(0, 0.1, (300, 3)), np.full((3, 3), 0.05), np.eye(3) * 0.01 + 0.02]),
    "lattice": lambda random: np.stack(np.meshgrid(*[np.arange(5) * 0.01] * 3), -1).reshape(-1, 3),
    "few": lambda random: random.uniform(0, 0.02, (4, 3)),
    "one": lambda random: np.zeros((1, 3)),
    "none": lambda random: np.zeros((0, 3)),
}


@pytest.mark.parametrize("body", BODIES)
def test_one_search_serves_every_radius_and_number(body):
    """Bit by bit what a search of its own gives, which the tests above hold to the published construction."""
    random = np.random.default_rng(0)
    points = BODIES[body](random)
    known = Neighbours(points, radius=0.05, max_neighbours=50)
    apart = np.linalg.norm(np.float32(points[:1]).astype(float) - np.float32(points[1:2]).astype(float))
    for radius in (0.01, *random.uniform(0.01, 0.05, 6), *([apart] if 0 < apart <= 0.05 else []), 0.05):
        for most in (0, 1, 2, 3, 10, 49, 50):
            found = known.springs(radius=radius, max_neighbours=most)
            expected = object_springs(points, radius=radius, max_neighbours=most)
            assert found.dtype == expected.dtype and np.array_equal(found, expected), (radius, most)


def test_more_than_was_searched_is_refused():
    known = Neighbours(np.eye(3), radius=0.05, max_neighbours=50)
    for asked in ({"radius": 0.06, "max_neighbours": 50}, {"radius": 0.05, "max_neighbours": 51}):
        with pytest.raises(ValueError, match=r"neighbours are known within 0.05 m, at most 50, got object_radius 0.0"):
            known.springs(**asked)


def test_order_of_a_line():
    # spaced 1, 2, 4, 5: each particle's own search finds at most two others, the nearest first; pairs found before are not repeated
    points = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [7, 0, 0], [12, 0, 0]])
    expected = [[0, 1], [0, 2], [1, 2], [3, 2], [3, 4], [4, 2]]
    np.testing.assert_array_equal(object_springs(points, radius=100, max_neighbours=3), expected)


def test_others_may_add_springs_beyond_a_particles_cap():
    # a star: every tip's nearest is the centre, so the centre has six springs although each search may return only one neighbour
    tips = np.concatenate([np.eye(3), -np.eye(3)]) * np.linspace(1, 1.1, 6)[:, None]
    springs = object_springs(np.concatenate([tips, [[0, 0, 0]]]), radius=2, max_neighbours=2)
    np.testing.assert_array_equal(springs, [[i, 6] for i in range(6)])


def test_the_cap_takes_the_nearest():
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0.3, 0], [0, 0, 0.4]])
    hand = [[0, 0, 0.01]]  # at 0.01, 0.5001, 0.3002 and 0.39
    np.testing.assert_array_equal(controller_springs(hand, points, radius=1, max_neighbours=3), [[0, 0], [0, 2], [0, 3]])
    np.testing.assert_array_equal(object_springs(points, radius=1, max_neighbours=2)[0], [0, 2])


@pytest.mark.parametrize("apart", [0.0, 5e-5])
def test_duplicates_are_not_tied_to_each_other(apart):
    # three particles in one place and one at 1 cm: springs of at most 1e-4 m are dropped whichever of the three a search finds first
    points = np.array([[0.0, 0, 0], [apart, 0, 0], [0, apart, 0], [0.01, 0, 0]])
    springs = object_springs(points, radius=0.02, max_neighbours=10)
    np.testing.assert_array_equal(springs, [[0, 3], [1, 3], [2, 3]])


def test_a_spring_must_be_longer_than_a_tenth_of_a_millimetre():
    at = np.array([[0.0, 0, 0], [1.01e-4, 0, 0]])
    np.testing.assert_array_equal(object_springs(at, radius=1, max_neighbours=10), [[0, 1]])
    np.testing.assert_array_equal(object_springs(at * 0.98, radius=1, max_neighbours=10), NONE)


def test_controllers_have_no_least_distance():
    # published: no check of the length, so a controller may sit on a particle (the system then asks for a rest length)
    np.testing.assert_array_equal(controller_springs(np.zeros((1, 3)), np.zeros((1, 3)), radius=1, max_neighbours=5), [[0, 0]])


def test_controllers_without_neighbours_have_no_springs():
    points = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    controllers = np.array([[5.0, 0, 0], [0.02, 0, 0], [-9, 0, 0]])
    np.testing.assert_array_equal(controller_springs(controllers, points, radius=0.05, max_neighbours=5), [[1, 0]])
    np.testing.assert_array_equal(controller_springs(controllers[[0, 2]], points, radius=0.05, max_neighbours=5), NONE)


def test_single_precision_positions_count():
    # 1 + 1e-8 is 1 in float32: both particles lie at the same distance from the origin's, at 1 exactly within the radius
    points = np.array([[0.0, 0, 0], [1 + 1e-8, 0, 0]])
    np.testing.assert_array_equal(object_springs(points, radius=1 + 1e-9, max_neighbours=5), [[0, 1]])
    np.testing.assert_array_equal(controller_springs(points[1:], points[:1], radius=1 + 1e-9, max_neighbours=5), [[0, 0]])


@pytest.mark.parametrize(("points", "most"), [(np.zeros((0, 3)), 5), (np.zeros((1, 3)), 5), (np.eye(3), 1), (np.eye(3), 0)])
def test_nobody_to_tie(points, most):
    springs = object_springs(points, radius=2, max_neighbours=most)
    assert springs.shape == (0, 2) and springs.dtype == np.int32


@pytest.mark.parametrize(("controllers", "points", "most"), [(0, 3, 5), (3, 0, 5), (3, 3, 0)])
def test_nobody_to_hold(controllers, points, most):
    springs = controller_springs(np.zeros((controllers, 3)), np.zeros((points, 3)), radius=2, max_neighbours=most)
    assert springs.shape == (0, 2) and springs.dtype == np.int32


@pytest.mark.parametrize("radius", [0.0, -0.01, np.nan, np.inf])
def test_bad_radius(radius):
    with pytest.raises(ValueError, match=re.escape(f"object_radius must be > 0 [m], got {radius}")):
        object_springs(np.eye(3), radius=radius, max_neighbours=5)
    with pytest.raises(ValueError, match=re.escape(f"controller_radius must be > 0 [m], got {radius}")):
        controller_springs(np.eye(3), np.eye(3), radius=radius, max_neighbours=5)


def test_memory_grows_with_springs_and_not_with_pairs():
    # 20,000 particles: a table of all pairs takes 400 MB as bytes, 3.2 GB as published (float64); what is found takes about 50 MB
    points = np.random.default_rng(0).random((20_000, 3))
    tracemalloc.start()
    springs = object_springs(points, radius=0.05, max_neighbours=20)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(springs) > 50_000
    assert peak < 100e6


# ---------------------------------------------------------------- hinges


def test_hinges_of_a_rope_and_of_a_ring():
    assert rope_hinges([4, 7, 8, 9]).tolist() == [[4, 7, 8], [7, 8, 9]]
    assert rope_hinges([4, 7]).shape == (0, 3)
    assert rope_hinges([0, 1, 2, 0]).tolist() == [[0, 1, 2], [1, 2, 0], [2, 0, 1]]
    with pytest.raises(ValueError, match=r"chain must have shape \(N,\) with N >= 2, got \(1,\)"):
        rope_hinges([3])


def lattice(shape, spacing=0.01):
    grid = np.stack(np.meshgrid(*(np.arange(n) * spacing for n in shape), indexing="ij"), -1)
    return np.concatenate([grid.reshape(-1, len(shape)), np.zeros((np.prod(shape), 3 - len(shape)))], 1)


@pytest.mark.parametrize("shape", [(7,), (5, 6), (4, 3, 5)])
def test_hinges_of_a_lattice_are_its_straight_triples(shape):
    # n - 2 along each line of each axis
    points = lattice(shape)
    hinges = sheet_hinges(points, object_springs(points, radius=0.0101, max_neighbours=30))
    assert len(hinges) == sum(np.prod(shape) // n * (n - 2) for n in shape)
    a, b, c = points[hinges].transpose(1, 0, 2)
    np.testing.assert_allclose(a + c, 2 * b, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 40), st.floats(5, 60), st.integers(1, 4))
def test_properties_of_sheet_hinges(seed, count, straight, most):
    rng = np.random.default_rng(seed)
    points = rng.random((count, 3)) * [0.1, 0.1, 0.02]
    springs = object_springs(points, radius=0.05, max_neighbours=12)
    hinges = sheet_hinges(points, np.concatenate([springs, [[count, 0]]]), straight=straight, most=most)  # one to a controller
    tied = {frozenset(s) for s in springs.tolist()}
    for a, b, c in hinges.tolist():
        assert {frozenset((a, b)), frozenset((b, c))} <= tied and a != c
        u, v = points[b] - points[a], points[c] - points[b]
        assert np.degrees(np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1))) < straight + 0.01  # float32 positions
    assert np.bincount(hinges[:, 1], minlength=1).max() <= most
    for b in set(hinges[:, 1].tolist()):
        others = hinges[hinges[:, 1] == b][:, [0, 2]].ravel()
        assert len(set(others.tolist())) == len(others)


@pytest.mark.parametrize("straight", [0, 90, np.nan])
def test_bad_straightness(straight):
    with pytest.raises(ValueError, match=r"straight must lie in \(0, 90\) degrees, got"):
        sheet_hinges(lattice((3, 3)), [[0, 1]], straight=straight)
