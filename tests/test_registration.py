"""Registration: the least-squares motion in closed form, closest points on partial noisy clouds, the lift onto the ground."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Plane
from twinbench.methods.registration import align, rigid_transform

SEEDS = st.integers(0, 2**32 - 1)


def shell(seed=0, count=300):
    """Directions (count, 3) and points on the surface of a bent, tapering bar of 20 x 6 x 3 cm: no turn maps it to itself."""
    u = np.random.default_rng(seed).normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    x = u[:, 0] * 0.1
    return u, np.stack([x, u[:, 1] * 0.03 * (1.3 + 5 * x), u[:, 2] * 0.015 + 4 * (x + 0.02) ** 2], 1)


def body(seed=0):
    """(400, 3) particles: the shell, and a smaller one inside it."""
    outer, inner = shell(seed)[1], shell(seed + 100, 100)[1]
    return np.concatenate([outer, (inner - inner.mean(0)) * 0.6 + inner.mean(0)])


def motion(seed, angle=None, reach=0.3):
    random = np.random.default_rng(seed)
    axis = random.normal(size=3)
    angle = random.uniform(-np.pi, np.pi) if angle is None else angle
    return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix(), random.uniform(-reach, reach, 3)


@settings(max_examples=50, deadline=None)
@given(SEEDS, st.integers(3, 30))
def test_a_rigid_motion_is_found_exactly(seed, count):
    source = np.random.default_rng(seed).normal(size=(count, 3))
    rotation, shift = motion(seed)
    found, moved = rigid_transform(source, source @ rotation.T + shift)
    # float64, and the turn of three nearly collinear points is ill-conditioned: what counts is where points go
    np.testing.assert_allclose(source @ found.T + moved, source @ rotation.T + shift, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(SEEDS, st.integers(4, 30), st.booleans())
def test_the_best_proper_rotation_and_never_a_reflection(seed, count, mirrored):
    # Independent source: scipy's Rotation.align_vectors minimises the same sum of squares over proper rotations.
    random = np.random.default_rng(seed)
    source = random.normal(size=(count, 3))
    target = source * [1, 1, -1] if mirrored else random.normal(size=(count, 3))
    rotation, shift = rigid_transform(source, target)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    _, error = Rotation.align_vectors(target - target.mean(0), source - source.mean(0))
    # the difference of two square roots of rounded sums
    assert np.linalg.norm(source @ rotation.T + shift - target) == pytest.approx(error, abs=1e-6)


def test_points_in_a_plane_turn_without_reflection():
    # a reflection in the plane itself explains flat points just as well
    source = np.random.default_rng(0).normal(size=(10, 3)) * [1, 1, 0]
    turn, shift = motion(3)
    rotation, moved = rigid_transform(source, source @ turn.T + shift)
    np.testing.assert_allclose(rotation, turn, atol=1e-12)
    np.testing.assert_allclose(moved, shift, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.5, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_closest_points_find_any_motion_of_a_whole_cloud(seed, angle):
    structure = body(seed)
    rotation, shift = motion(seed, angle)
    cloud = (structure @ rotation.T + shift)[np.random.default_rng(seed).permutation(len(structure))]
    np.testing.assert_allclose(align(structure, cloud), structure @ rotation.T + shift, atol=1e-9)


@pytest.mark.parametrize("angle", [0.25, 2.5])
@pytest.mark.parametrize("seed", range(4))
def test_closest_points_find_the_motion_of_a_partial_noisy_cloud(seed, angle):
    # what a camera above sees: two thirds of the surface, each point 1 mm off, and a few strays
    structure = body(seed)
    random = np.random.default_rng(seed)
    rotation, shift = motion(seed, angle)
    there = structure @ rotation.T + shift
    seen = there[:300][shell(seed)[0][:, 2] > -0.3]
    strays = there.mean(0) + random.normal(size=(len(seen) // 20, 3)) * 0.05
    cloud = np.concatenate([seen + random.normal(size=seen.shape) * 1e-3, strays])
    error = np.linalg.norm(align(structure, cloud) - there, axis=1)
    # the surface particles lie about 6 mm apart
    assert error.mean() < 1e-3 < np.linalg.norm(structure - there, axis=1).mean()


def test_the_body_stays_rigid():
    structure, cloud = body(0), body(1)[:150]
    np.testing.assert_allclose(pdist(align(structure, cloud)), pdist(structure), atol=1e-12)


def test_a_body_in_place_stays_there():
    structure = body()
    np.testing.assert_allclose(align(structure, structure), structure, atol=1e-12)


@pytest.mark.parametrize("normal", [(0, 0, -1), (0, 0.6, 0.8)])
def test_particles_below_the_ground_are_lifted_onto_it(normal):
    structure = body()
    ground = Plane(np.array(normal, float), 0.01)
    found = align(structure, structure, ground=ground)
    height, before = ground.height(found), ground.height(structure)
    below = before < 0
    assert below.any() and (~below).any()
    np.testing.assert_allclose(height[below], 0, atol=1e-12)
    np.testing.assert_allclose(found[~below], structure[~below], atol=1e-12)
    along = found[below] - structure[below]  # straight up
    np.testing.assert_allclose(along, -before[below, None] * ground.normal, atol=1e-12)


def test_registration_repeats():
    structure, cloud = body(0), body(1)[:150] + 0.1
    np.testing.assert_array_equal(align(structure, cloud), align(structure, cloud))
