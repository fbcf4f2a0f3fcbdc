"""Bending: as rigid as possible by its energy and an independent implementation, a bent body met, what is not bent left alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.methods.bending import bend, bend_once, deform, is_sheet
from twinbench.methods.registration import align, rigid_transform
from twinbench.physics.topology import object_springs

SIZE = np.array([0.2, 0.05, 0.02])  # m


def slab(seed, counts=(30, 8, 4)):
    """(M, 3) particles of a slab of ``SIZE``, those on its surface first, and how many these are; samples of other seeds lie elsewhere."""
    random = np.random.default_rng(seed)
    axes = [np.linspace(-0.5, 0.5, n) for n in counts]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    outside = np.abs(grid) == 0.5
    grid = (grid + np.where(outside, 0, random.uniform(-0.3, 0.3, grid.shape) / counts)) * SIZE  # what is on a face stays on it
    order = np.argsort(~outside.any(1), kind="stable")
    return grid[order], int(outside.any(1).sum())


def arc(points, angle):
    """The slab bent about y: its middle line becomes an arc of ``angle`` [rad] of the same length."""
    radius = SIZE[0] / angle
    turned, distance = points[:, 0] / radius, radius + points[:, 2]
    return np.stack([distance * np.sin(turned), points[:, 1], distance * np.cos(turned) - radius], 1)


def paint(points):
    """RGB that tells every place on the slab."""
    return 0.5 + points * [2, 6, 10]


def springs(points):
    return object_springs(points, radius=0.014, max_neighbours=30)


def energy(points, edges, now):
    """Sum over particles i of min over rotations R of sum over i's edges of |(x_i - x_j) - R (p_i - p_j)|^2: Kabsch by scipy."""
    total = 0.0
    for i in range(len(points)):
        mine = [e[1] if e[0] == i else e[0] for e in edges if i in e]
        total += Rotation.align_vectors(now[i] - now[mine], points[i] - points[mine])[1] ** 2
    return total


def error(found, truth):
    return np.linalg.norm(found - truth, axis=1).mean()


# ---------------------------------------------------------------- as rigid as possible


@pytest.mark.parametrize("rounds", [1, 2, 50])
def test_deforming_agrees_with_open3d(rounds):
    # Independent implementation. Its edges weigh as cotangents of the angles opposite, which are all alike on an icosahedron.
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    mesh = open3d.geometry.TriangleMesh.create_icosahedron()
    points, faces = np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    held, goals, weights = [0, 3, 7], points.copy(), np.zeros(len(points))
    goals[held] += np.random.default_rng(0).normal(size=(3, 3)) * 0.3
    weights[held] = 1e9
    ids, there = open3d.utility.IntVector(held), open3d.utility.Vector3dVector(goals[held])
    theirs = np.asarray(mesh.deform_as_rigid_as_possible(ids, there, max_iter=rounds).vertices)
    # ours keeps pieces without goals in place by a weight of 1e-6
    np.testing.assert_allclose(deform(points, edges, goals, weights, rounds=rounds), theirs, atol=1e-6)


def test_the_energy_falls_with_every_round():
    points, _ = slab(0, (10, 4, 3))
    edges = springs(points * [0.3, 0.5, 1])
    points = points * [0.3, 0.5, 1]
    ends = np.abs(points[:, 0]) > 0.028
    goals, weights = arc(points, 3.0), np.where(ends, 1e6, 0.0)
    now, energies = points, []
    for _ in range(6):
        now = deform(points, edges, goals, weights, now=now)
        energies.append(energy(points, edges, now))
    np.testing.assert_allclose(now[ends], goals[ends], atol=1e-6)
    assert (np.diff(energies) < 0).all()


def test_a_rigid_motion_of_all_goals_is_followed_exactly():
    points, _ = slab(0, (8, 4, 3))
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    there = points @ turn.T + [0.1, 0.2, -0.3]
    # the energy of the rigid motion is 0, the least that it can be; from there on nothing moves
    found = deform(points, object_springs(points, radius=0.04, max_neighbours=30), there, np.ones(len(points)), now=there, rounds=3)
    np.testing.assert_allclose(found, there, atol=1e-9)


def test_a_piece_without_goals_stays():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [9.0, 9, 9]])
    edges = [[0, 1], [1, 2], [0, 2], [3, 4]]
    goals, weights = points + [0, 0, 1], np.array([1.0, 1, 1, 0, 0, 0])
    found = deform(points, edges, goals, weights, rounds=20)
    np.testing.assert_allclose(found, [[0, 0, 1], [1, 0, 1], [0, 1, 1], *points[3:]], atol=1e-6)


# ---------------------------------------------------------------- a bent body


@pytest.mark.parametrize(
    "angle, share, seed",
    [
        (0.6, 0.2, 0),
        (1.5, 0.2, 2),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in ((1.0, 0.2, 0), (1.5, 0.2, 0), (0.6, 0.2, 2), (1.0, 0.2, 2))),
    ],
)
def test_a_bent_body_is_met_better_than_any_rigid_one(angle, share, seed):
    (points, surface), (others, seen) = slab(seed), slab(seed + 1, (33, 9, 4))  # no particle has its like in the cloud
    turn = Rotation.random(random_state=seed).as_matrix()
    truth, cloud = (arc(p, angle) @ turn.T + [0.1, 0.2, 0.3] for p in (points, others))
    hues = dict(colors=paint(points[:surface]), cloud_colors=paint(others[:seen]))
    lying = align(points, cloud[:seen], surface=surface, **hues)
    found = bend(lying, springs(points), cloud[:seen], surface=surface, spacing=0.006, **hues)
    rotation, shift = rigid_transform(points, truth)  # the best that any rigid registration can do
    assert error(found, truth) < share * error(points @ rotation.T + shift, truth)


def test_a_bent_body_is_met_by_its_shape_alone():
    (points, surface), (others, seen) = slab(0), slab(1, (33, 9, 4))
    truth, cloud = arc(points, 0.8), arc(others, 0.8)[:seen]
    rotation, shift = rigid_transform(points, truth)
    lying = points @ rotation.T + shift
    found = bend(lying, springs(points), cloud, surface=surface, spacing=0.006)
    assert error(found, truth) < 0.25 * error(lying, truth)


def test_what_lies_there_already_is_not_bent():
    # another sample of the same slab, 1 mm of noise, and two strays beside it that are far from each other
    (points, surface), (others, seen) = slab(0), slab(1, (33, 9, 4))
    cloud = others[:seen] + np.random.default_rng(0).normal(size=(seen, 3)) * 1e-3
    cloud = np.concatenate([cloud, [[-0.08, 0, 0.03], [0.08, 0, 0.03]]])
    np.testing.assert_array_equal(bend(points, springs(points), cloud, surface=surface, spacing=0.006), points)


def test_published_bending_holds_what_is_near_and_places_what_is_far():
    """A row of 25 particles 1 cm apart, the first 3 cm before the others; in the cloud it is 2.5 cm higher, the last eight are 2.9 cm.

    1..16 are near: where they are in the cloud. 17 and 18 have no match: 16 is nearer (1.3 and 2.3 cm) than they themselves (2.9 cm).
    0 is far, and its three nearest matches 1, 2 and 3 are near: it is discarded as wrong. 19..24 are far; of 19, the nearest matches are
    20, 21 and 22 (3 cm away, while 16 is 3.3 cm away), all far: they are believed.
    """
    x = np.r_[-3, np.arange(16), 16.3 + np.arange(8)] * 0.01
    row = x[:, None] * [1, 0, 0]
    raised = row + np.r_[0.025, np.zeros(16), np.full(8, 0.029)][:, None] * [0, 0, 1]
    edges = np.array([[i, j] for i in range(25) for j in (i + 1, i + 2) if j < 25])
    found = bend_once(row, edges, raised, surface=25)
    kept = [*range(1, 17), *range(19, 25)]
    np.testing.assert_allclose(found[kept], raised[kept], atol=1e-6)
    assert abs(found[0, 2]) < 1e-3 and 1e-3 < found[17, 2] < found[18, 2] < 0.028


def test_published_bending_leaves_alone_what_is_within_two_centimetres():
    points, surface = slab(0)
    np.testing.assert_array_equal(bend_once(points, springs(points), arc(points, 0.5)[:surface], surface=surface), points)


# ---------------------------------------------------------------- sheets


def sheet(fold=0.0, noise=0.0):
    """A cloth of 30 x 20 particles, 7 mm apart, folded over along its length by ``fold`` [rad]."""
    grid = np.stack(np.meshgrid(np.arange(30), np.arange(20), indexing="ij"), -1).reshape(-1, 2) * 0.007
    x, y = grid.T
    flat = np.stack([x, y, 0 * x], 1)
    if fold:
        radius = x.max() / fold
        flat = np.stack([radius * np.sin(x / radius), y, radius * (1 - np.cos(x / radius))], 1)
    return flat + np.random.default_rng(0).normal(size=flat.shape) * noise


@pytest.mark.parametrize("fold, noise", [(0.0, 0.0), (0.0, 0.002), (2.0, 0.001), (4.0, 0.0)])
def test_a_sheet_is_one_however_it_is_folded(fold, noise):
    assert is_sheet(sheet(fold, noise))


def test_a_slab_a_rope_and_a_row_of_markers_are_no_sheets():
    tube = np.random.default_rng(0).uniform(-1, 1, (900, 3)) * [0.3, 0.012, 0.012]
    markers = np.arange(13)[:, None] * [0.04, 0.01, 0] + np.random.default_rng(0).normal(size=(13, 3)) * 1e-3
    assert not is_sheet(slab(0)[0]) and not is_sheet(tube) and not is_sheet(markers) and not is_sheet(markers[:3])
