"""Registration: the least-squares motion in closed form, closest points on partial noisy clouds, colours, the lift onto the ground."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Plane
from twinbench.methods.closest_points import colored, point_to_point
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
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
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


# ---------------------------------------------------------------- other samples, colours


def ellipsoid(seed, count=700):
    """(count, 3) points on an ellipsoid with half axes of 10, 5 and 2 cm, which four turns map to itself."""
    u = np.random.default_rng(seed).normal(size=(count, 3))
    return u / np.linalg.norm(u, axis=1)[:, None] * [0.1, 0.05, 0.02]


def paint(points, brighter=0.0):
    """RGB that tells every side of the ellipsoid."""
    return 0.4 + points * [4, 8, 15] + brighter


def apart(structure, found, truth):
    """Mean distance [m] to where particles belong, and degrees between the motions found and true."""
    turn = rigid_transform(structure, found)[0] @ rigid_transform(structure, truth)[0].T
    return np.linalg.norm(found - truth, axis=1).mean(), np.degrees(Rotation.from_matrix(turn).magnitude())


@pytest.mark.parametrize("turned", [0, 180])
@pytest.mark.parametrize("about", [0, 1, 2])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_colours_tell_how_a_symmetric_body_lies(turned, about, seed):
    structure, other = ellipsoid(seed), ellipsoid(seed + 10)  # another sample: no particle has its like, neighbours are 5 mm apart
    axis = np.eye(3)[about]
    turn, shift = Rotation.from_rotvec(np.radians(turned) * axis).as_matrix() @ motion(seed, 0.3)[0], np.array([0.2, -0.1, 0.3])
    cloud = other @ turn.T + shift
    hues = dict(colors=paint(structure), cloud_colors=paint(other, brighter=0.1))
    distance, angle = apart(structure, align(structure, cloud, **hues), structure @ turn.T + shift)
    assert distance < 1e-3 and angle < 0.5


def test_without_colours_a_symmetric_body_stays_as_it_lies():
    # the guard of the test above: its shape does not tell, and the first of equal starts is taken
    structure = ellipsoid(0)
    turn = Rotation.from_rotvec([0, 0, np.pi]).as_matrix()
    cloud = ellipsoid(10) @ turn.T
    assert apart(structure, align(structure, cloud), structure @ turn.T)[1] > 170


def test_unknown_colours_have_no_say():
    structure, other = ellipsoid(0), ellipsoid(10)
    turn = Rotation.from_rotvec([0, 0, np.pi]).as_matrix()
    colors, others = paint(structure), paint(other)
    colors[structure[:, 2] < 0] = np.nan  # never seen from above
    others[other[:, 2] < 0] = np.nan
    found = align(structure, other @ turn.T, colors=colors, cloud_colors=others)
    distance, angle = apart(structure, found, structure @ turn.T)
    assert distance < 1e-3 and angle < 0.5
    none = np.full_like(colors, np.nan)
    np.testing.assert_array_equal(align(structure, other, colors=none, cloud_colors=others), align(structure, other))


def test_particles_inside_are_carried_and_not_matched():
    structure, (turn, shift) = body(0), motion(0, 0.2)
    cloud = body(0)[:300] @ turn.T + shift
    np.testing.assert_allclose(align(structure, cloud, surface=300), structure @ turn.T + shift, atol=1e-9)
    # the same particles inside a body of which all can be seen would be matched with a cloud that is nearer to them
    sunk = structure[300:] @ turn.T + shift
    assert np.abs(align(structure, sunk, surface=300) - align(structure, sunk)).max() > 1e-3


# ---------------------------------------------------------------- as published


def test_published_closest_points_start_from_the_difference_of_centres_and_look_two_centimetres_far():
    structure = ellipsoid(0)
    turn = Rotation.from_rotvec([0.05, 0.02, 0.1]).as_matrix()
    truth = structure @ turn.T + [0.5, 0.3, -0.2]
    np.testing.assert_allclose(point_to_point(structure, truth), truth, atol=1e-4)  # ends where 30 rounds have led
    # two pairs of points whose centres agree and which are 3 cm apart from each other's: nobody is in reach
    ends = np.array([[-0.1, 0, 0], [0.1, 0, 0]])
    np.testing.assert_allclose(point_to_point(ends, ends * 0.7 + 0.05), ends + 0.05, atol=1e-15)


def plane(seed, half, count):
    """``count`` points of the plane z = 0 within ``half`` [m] of the origin along x and y, and RGB that tells where on it each is."""
    x, y = np.random.default_rng(seed).uniform(-half, half, (2, count))
    return np.stack([x, y, 0 * x], 1), 0.5 + 0.4 * np.stack([np.sin(30 * x), np.cos(25 * y + 1), np.sin(20 * (x + y))], 1)


def test_coloured_closest_points_slide_along_a_plane_whose_shape_tells_nothing():
    pytest.importorskip("open3d", exc_type=ImportError)
    (points, colors), (others, hues) = plane(0, 0.15, 10000), plane(1, 0.25, 28000)  # other samples, no common border
    shift = np.array([0.006, -0.004, 0.003])
    off = (colored(points, colors, others + shift, hues) - points - shift).mean(0)
    assert np.linalg.norm(off) < 1e-3  # a tenth of the finest voxel
    # in one colour it is only found across itself
    off = (colored(points, colors * 0 + 0.5, others + shift, hues * 0 + 0.5) - points - shift).mean(0)
    assert abs(off[2]) < 1e-3 < 3e-3 < np.linalg.norm(off[:2])


def test_what_is_too_far_for_its_colours_is_left_alone():
    pytest.importorskip("open3d", exc_type=ImportError)
    structure = ellipsoid(0)
    np.testing.assert_array_equal(colored(structure, paint(structure), structure + 1.0, paint(structure)), structure)


def test_a_missing_library_is_named_with_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    structure = ellipsoid(0)
    with pytest.raises(ImportError, match=r"coloured registration needs open3d.*pip install open3d.*apt-get install libusb-1.0-0"):
        colored(structure, paint(structure), structure, paint(structure))
    align(structure, structure, colors=paint(structure), cloud_colors=paint(structure))  # which does without
